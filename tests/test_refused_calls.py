"""A call of ``learn`` or ``finish`` that is refused before its first step changes nothing."""

import copy
import pickle
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.both_paths import make_model
from stable_baselines3.common.callbacks import BaseCallback, CheckpointCallback

from sb3_adaptive_q import LearningRateCallback, TabularQ, method, refused_call

LAKE = "slippery lake"
PATHS = pytest.mark.parametrize("compiled", [False, True], ids=["ordinary", "compiled"])


class Refuses(BaseCallback):
    """Raises before the first step."""

    def _on_training_start(self):
        raise RuntimeError("not today")

    def _on_step(self):
        return True


class Text(LearningRateCallback):
    """A rule that no compiler takes."""

    @staticmethod
    def rule(mu, step):
        return float(str(0.1))


REFUSED = {
    "an argument": {"tb_log_name": 3},
    "two methods": {"callback": [method(1), method(2)]},
    "an error in a callback": {"callback": Refuses()},
    "another method and an error": {"callback": [method("bakf"), Refuses()]},
}


BEFORE_CALLBACKS = [REFUSED["an argument"], REFUSED["two methods"]]


def state_of(model):
    """What a training has reached, as plain data."""
    memory = {name: array.tolist() for name, array in model.memory.items()}
    counts = model.num_timesteps, model._episode_num, model.remaining_timesteps, len(model.ep_info_buffer)
    return repr(model), model.q_table.tolist(), memory, model.mu, model.exploration_rate, counts


def refuse(model, reset=False, **arguments):
    with pytest.raises((RuntimeError, ValueError)):
        model.learn(100, reset_num_timesteps=reset, **arguments)


@PATHS
@pytest.mark.parametrize("arguments", REFUSED.values(), ids=REFUSED)
def test_a_training_goes_on_as_if_nothing_had_been_asked(compiled, arguments):
    model = make_model(LAKE, compiled, 3, method="polynomial", seed=1).learn(600)
    other = copy.deepcopy(model)
    before = state_of(model)
    refuse(model, **arguments)
    assert state_of(model) == before
    for each in (model, other):
        each.learn(900, reset_num_timesteps=False)
    # Once callbacks have begun, they may have moved the environment: then a new episode comes next
    assert (state_of(model) == state_of(other)) == (arguments in BEFORE_CALLBACKS)


@PATHS
@pytest.mark.parametrize("arguments", REFUSED.values(), ids=REFUSED)
def test_a_new_training_that_is_refused_leaves_what_was_learned(compiled, arguments):
    model = make_model(LAKE, compiled, method="polynomial", seed=1).learn(600)
    before = state_of(model)
    refuse(model, reset=True, **arguments)
    assert state_of(model) == before
    model.learn(600, reset_num_timesteps=False)
    assert model.num_timesteps == 1200 and model.memory["visits"].sum() == 1200


def test_a_first_call_that_is_refused_leaves_no_attribute_behind():
    model = make_model(LAKE, False, seed=1)
    before = set(vars(model))
    refuse(model, reset=True, callback=Refuses())
    assert set(vars(model)) == before


@PATHS
def test_a_schedule_out_of_range(compiled):
    model = make_model(LAKE, compiled, method="polynomial", seed=1).learn(600)
    before = state_of(model)
    model.exploration_schedule = lambda progress: 3.0
    with pytest.raises(ValueError, match=r"`exploration_schedule\(0\)` must be a number from 0 to 1, but got 3.0"):
        model.learn(100)
    assert state_of(model) == before


def test_a_method_that_does_not_compile_leaves_the_other_in_force():
    model = make_model(LAKE, True, method="polynomial", seed=1).learn(600)
    before = state_of(model)
    with pytest.raises(ValueError, match="`rule` does not compile, because Numba fails with ValueError: could not convert"):
        model.learn(100, callback=Text())
    assert state_of(model) == before
    assert model.learn(100).num_timesteps == 100


def test_what_numba_stumbles_over_runs_as_python_elsewhere():
    model = make_model(LAKE, False, learning_rate=0.1, seed=1)
    with pytest.warns(UserWarning, match="Text runs as Python, which is slower: .* Numba fails with ValueError"):
        model.learn(300, callback=Text())
    assert np.array_equal(model.q_table, make_model(LAKE, False, learning_rate=0.1, seed=1).learn(300).q_table)


@PATHS
@pytest.mark.parametrize("arguments", REFUSED.values(), ids=REFUSED)
def test_a_resumed_training_stays_exact(compiled, arguments, tmp_path):
    whole = make_model(LAKE, compiled, 3, method="autostep", seed=1)
    whole.learn(3000, callback=CheckpointCallback(333, tmp_path, "lake"))
    resumed = TabularQ.resume(tmp_path / "lake_1998_steps", make_model(LAKE, compiled, 3).env)
    stays_exact = arguments in BEFORE_CALLBACKS
    with warnings.catch_warnings(record=True) as told, pytest.raises((RuntimeError, ValueError)):
        warnings.simplefilter("always")
        resumed.finish(**arguments)
    assert stays_exact != any("`resume` the file again" in str(each.message) for each in told)
    assert (state_of(resumed.finish()) == state_of(whole)) == stays_exact
    assert resumed.num_timesteps == whole.num_timesteps


def test_a_stopped_training_keeps_its_goal():
    class Stop(BaseCallback):
        def _on_step(self):
            if self.num_timesteps == 300:
                raise KeyboardInterrupt
            return True

    model = make_model(LAKE, False, seed=1)
    with pytest.raises(KeyboardInterrupt):
        model.learn(1000, callback=Stop())
    with pytest.raises(ValueError):
        model.learn(5000, reset_num_timesteps=False, callback=[method(1), method(2)])
    with pytest.raises(ValueError):
        model.finish(tb_log_name=3)
    assert model.remaining_timesteps == 700
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # that it gives a resumed training up would be wrong
        copy.deepcopy(model).learn(50)
    model.learn(50, reset_num_timesteps=False)  # a training of its own, not the rest of the other
    assert model.num_timesteps == 350 and model.remaining_timesteps == 0


def test_an_environment_that_a_callback_has_moved_begins_a_new_episode():
    class Moves(BaseCallback):
        def _on_training_start(self):
            self.training_env.step(np.array([0]))
            raise RuntimeError("not today")

        def _on_step(self):
            return True

    model = make_model("Taxi", False, seed=1).learn(203)
    refuse(model, callback=Moves())
    model.learn(1, reset_num_timesteps=False)
    assert model.env.envs[0].get_wrapper_attr("s") == model._last_obs[0]


def test_what_a_call_begins_with_is_not_kept():
    class Watch(BaseCallback):
        def _on_step(self):
            return True

    watch = Watch()
    make_model(LAKE, False, seed=1).learn(10, callback=watch)
    assert not {"before", "training"} & set(watch.locals)


def test_memory_of_which_there_is_no_room_for_two_starts_anew(monkeypatch):
    monkeypatch.setattr(refused_call, "SURELY_FREE", 0)
    monkeypatch.setattr(refused_call.psutil, "virtual_memory", lambda: SimpleNamespace(available=1000))
    model = make_model(LAKE, False, method="polynomial", seed=1).learn(600)
    refuse(model, reset=True, callback=Refuses())
    assert model.num_timesteps == 600 and model.memory["visits"].sum() == 0
    assert model.learn(100).memory["visits"].sum() == 100


@pytest.mark.parametrize("chosen", [None, 7, "polynomial", "bakf"])
def test_a_pickled_model_learns_on(chosen):
    model = make_model(LAKE, False, method=chosen, seed=1).learn(300)
    other = pickle.loads(pickle.dumps(model))
    for each in (model, other):
        each.learn(300, reset_num_timesteps=False)
    assert state_of(model) == state_of(other)
