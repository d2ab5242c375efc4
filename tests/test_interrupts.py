"""
Signals whose handler raises, at random moments of a training: the handler's own exception arrives, soon, and the model
learns on.

Machine code that handed Python objects over would crash here: Python may run a signal's handler while one is taken apart.
"""

import gc
import os
import random
import signal
import threading
import time

import gymnasium as gym
import numpy as np
import pytest
from helpers.both_paths import make_model

from sb3_adaptive_q import TabularQ


#: With the environment variable, many more than in the suite
N_INTERRUPTS = 400 if os.environ.get("EXHAUSTIVE") else 40


class Stop(Exception):
    """What the handler raises."""


def stop(number, frame):
    raise Stop


@pytest.fixture
def alarm():
    before = signal.signal(signal.SIGALRM, stop)
    # hypothesis leaves one, and Python ignores whatever is raised there: the alarm would be lost
    callbacks_of_garbage_collector, gc.callbacks[:] = gc.callbacks[:], []
    yield lambda seconds: signal.setitimer(signal.ITIMER_REAL, seconds)
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    gc.callbacks[:] = callbacks_of_garbage_collector
    signal.signal(signal.SIGALRM, before)


def interrupt(model, alarm, seconds):
    """Let it learn until the alarm; return the seconds from the alarm to its answer."""
    start = time.monotonic()
    with pytest.raises(Stop):
        alarm(seconds)
        model.learn(10**10, log_interval=None, reset_num_timesteps=False)
    return time.monotonic() - start - seconds


CASES = [
    (name, n_envs, interval) for name in ("slippery lake", "CartPole") for n_envs in (1, 2) for interval in (1, 100, None)
]


class TestInterrupts:
    @pytest.mark.parametrize("name, n_envs, interval", CASES)
    def test_the_model_learns_on(self, name, n_envs, interval, alarm, tmp_path):
        model = make_model(name, True, n_envs, callback_interval=interval, method=7)
        model.learn(1000)
        random.seed(0)
        answers = []
        for _ in range(-(-N_INTERRUPTS // len(CASES))):
            answers.append(interrupt(model, alarm, random.uniform(0.001, 0.05)))
            assert np.isfinite(model.q_table).all()
            assert 0.001 <= model.mu <= 0.01
        before = model._n_updates
        model.learn(1000, reset_num_timesteps=False)
        assert model._n_updates == before + 1000
        model.save(tmp_path / "model")
        assert min(answers) < 0.2

    def test_a_method_with_memory_and_the_ordinary_path(self, alarm):
        model = make_model("slippery lake", False, method="autostep")
        model.learn(1000)
        random.seed(0)
        for _ in range(5):
            interrupt(model, alarm, random.uniform(0.001, 0.03))
        model.learn(1000, reset_num_timesteps=False)
        assert np.isfinite(model.q_table).all()

    def test_dynamics_that_draw_from_a_generator(self, alarm):
        import helpers.mountain_car  # registers them  # noqa: F401
        from stable_baselines3.common.env_util import make_vec_env

        from sb3_adaptive_q import CompiledVecEnv, TabularQ
        from wrappers import DiscretizeObservation

        env = make_vec_env("MountainCar-v0", vec_env_cls=CompiledVecEnv, wrapper_class=DiscretizeObservation)
        model = TabularQ("MlpPolicy", env, seed=0).learn(1000)
        random.seed(0)
        for _ in range(5):
            interrupt(model, alarm, random.uniform(0.001, 0.05))
        model.learn(1000, reset_num_timesteps=False)
        assert np.isfinite(model.q_table).all()


class TestWholeTransitions:
    @pytest.mark.parametrize("compiled", [False, True])
    def test_an_interrupt_leaves_what_so_many_transitions_leave(self, compiled, alarm, tmp_path):
        """Found by a twin that a callback ends after as many updates."""
        make_model("slippery lake", compiled, method="polynomial").learn(1000)
        signal.signal(signal.SIGALRM, signal.default_int_handler)
        random.seed(0)
        for seed in range(N_INTERRUPTS // 8):
            model = make_model("slippery lake", compiled, method="polynomial", seed=seed)
            with pytest.raises(KeyboardInterrupt):
                alarm(random.uniform(0.005, 0.03))
                model.learn(10**9)
            learned = model._n_updates
            twin = make_model("slippery lake", True, method="polynomial", seed=seed, callback_interval=learned + 1)
            twin.learn(10**9, callback=lambda _locals, _globals: False)
            assert twin._n_updates == learned
            for name, array in model.policy.state_dict().items():
                assert array.numpy().tobytes() == twin.policy.state_dict()[name].numpy().tobytes(), name
            model.save(tmp_path / "model")
            model.learn(100, reset_num_timesteps=False)


class TestOneTrainingAtATime:
    @pytest.mark.parametrize("compiled", [False, True])
    def test_another_model_may_learn_in_a_callback(self, compiled):
        """Both end as they would alone."""

        def learn(model, callback=None):
            return model.learn(1000, callback=callback, reset_num_timesteps=False)

        def make(seed):
            return make_model("slippery lake", compiled, method=7, seed=seed, callback_interval=500)

        outer, inner = make(1), make(2)
        learn(outer, lambda found, _: outer.num_timesteps % 500 > 0 or learn(inner) is inner)
        alone = learn(learn(make(2)))
        assert inner.num_timesteps == 2000
        for ours, theirs in ((outer, learn(make(1))), (inner, alone)):
            assert ours.q_table.tobytes() == theirs.q_table.tobytes()
            assert ours.training.as_data() == theirs.training.as_data()

    @pytest.mark.parametrize("compiled", [False, True])
    def test_learn_in_a_callback_is_refused(self, compiled):
        model = make_model("slippery lake", compiled, callback_interval=100)
        with pytest.raises(RuntimeError, match="learning already"):
            model.learn(1000, callback=lambda _locals, _globals: model.learn(10) is not None)
        model.learn(1000)

    def test_an_environment_whose_reset_lets_another_model_learn(self):
        """As in self-play. With a lock that one thread cannot take twice, this would wait for ever."""
        opponent = make_model("slippery lake", False)

        class SelfPlay(gym.Wrapper):
            def reset(self, **kwargs):
                opponent.learn(10)
                return super().reset(**kwargs)

        TabularQ("MlpPolicy", SelfPlay(gym.make("FrozenLake-v1")), seed=0).learn(100)
        assert opponent.num_timesteps == 10

    @pytest.mark.parametrize("compiled", [False, True])
    def test_learn_in_another_thread_is_refused(self, compiled):
        model = make_model("slippery lake", compiled, callback_interval=1000)
        seen = []

        def learn_elsewhere():
            try:
                model.learn(10)
            except RuntimeError as error:
                seen.append(str(error))

        def callback(_locals, _globals):
            if not seen:
                thread = threading.Thread(target=learn_elsewhere)
                thread.start()
                thread.join()
            return True

        model.learn(3000, callback=callback)
        assert "learning already" in seen[0]
