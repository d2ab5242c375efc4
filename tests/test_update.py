"""The update as machine code: the same numbers as Python's, from the counter in force, into the table in force."""

import copy
import os
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnvWrapper

from sb3_adaptive_q import CompiledVecEnv, LeanVecEnv, LearningRateCallback, TabularQ, method
from sb3_adaptive_q.algorithms.td_update import NEXT_ACTIONS
from sb3_adaptive_q.policies import TabularQPolicy

LAKE = "FrozenLake-v1"


class At(BaseCallback):
    """Calls a function of the model at one step."""

    def __init__(self, step, action):
        super().__init__()
        self.step, self.action = step, action

    def _on_step(self):
        if self.n_calls == self.step:
            self.action(self.model)
        return True


class TestWithoutCompiler:
    PROGRAM = """
from sb3_adaptive_q import TabularQ
for method in (*range(1, 9), "delta_bar_delta", "idbd"):
    model = TabularQ("MlpPolicy", "FrozenLake-v1", method=method, seed=0, initial_q=1.0).learn(2_000)
    print(model.q_table.tobytes().hex(), model.training.record.tobytes().hex())
"""

    def test_python_gives_the_same_in_every_bit(self):
        machine_code, python = (
            subprocess.run(
                [sys.executable, "-c", self.PROGRAM],
                env={**os.environ, "NUMBA_DISABLE_JIT": switch},
                capture_output=True,
                text=True,
                check=True,
            ).stdout
            for switch in ("0", "1")
        )
        assert machine_code == python and len(machine_code.splitlines()) == 10

    def test_a_compiled_environment_says_what_it_lacks(self):
        program = """
from stable_baselines3.common.env_util import make_vec_env
from sb3_adaptive_q import CompiledVecEnv, TabularQ
TabularQ("MlpPolicy", make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv)).learn(10)
"""
        environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
        result = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
        assert result.returncode == 1 and "please unset NUMBA_DISABLE_JIT" in result.stderr


class TestRules:
    def test_one_that_gives_no_number(self):
        class Forgetful(LearningRateCallback):
            @staticmethod
            def rule(mu, step):
                return None

        with pytest.raises(ValueError, match="Forgetful must return a number in every case, but returns none"):
            TabularQ("MlpPolicy", LAKE, seed=0).learn(50, callback=Forgetful(mu_0=0.1))
        with pytest.raises(ValueError, match=r"Forgetful must give step .* the Step are 0, it gave None"):
            Forgetful()

    def test_a_step_size_that_divides_by_a_count_that_it_does_not_ask_for(self):
        class Mean(LearningRateCallback):
            @staticmethod
            def step_size(mu, step):
                return 1.0 / step.count

        with pytest.raises(ValueError, match=r"Mean must give .* divides by zero: .*set the class attribute `counts = True`"):
            Mean()
        Mean.counts = True
        assert TabularQ("MlpPolicy", LAKE, seed=0).learn(50, callback=Mean()).memory["visits"].sum() == 50

    @pytest.mark.parametrize("kind", [LeanVecEnv, CompiledVecEnv])
    def test_one_that_has_bounds(self, kind):
        class Climbing(LearningRateCallback):
            lower, upper = 0.25, 0.75

            @staticmethod
            def rule(mu, step):
                return mu + 0.125

        class Forgetful(Climbing):
            @staticmethod
            def rule(mu, step):
                return None

        assert Climbing().method.start() == 0.25
        with pytest.raises(ValueError, match=r"Forgetful must give step sizes from 0 to 1.* gave None"):
            Forgetful()
        model = TabularQ("MlpPolicy", make_vec_env(LAKE, vec_env_cls=kind), seed=0)
        assert [model.learn(n, callback=Climbing()).mu for n in (1, 3, 10)] == [0.375, 0.625, 0.75]

    @pytest.mark.parametrize(("bounds", "message"), [
        ({"upper": 0.5}, "Bounded has the class attributes lower=None and upper=0.5: please set both, or neither"),
        ({"lower": 0.5, "upper": 0.1}, "`lower` must not be above `upper`"),
    ])  # fmt: skip
    def test_bounds_that_are_none(self, bounds, message):
        kind = type("Bounded", (LearningRateCallback,), {**bounds, "step_size": staticmethod(lambda mu, step: 0.3)})
        with pytest.raises(ValueError, match=message):
            kind()

    def test_one_that_is_a_method(self):
        class Bound(LearningRateCallback):
            def rule(self, mu, step):
                return 0.1

        with pytest.raises(ValueError, match="without `self`: please make it a `@staticmethod`"):
            Bound(mu_0=0.1)

    def test_a_parameter_that_is_no_number(self):
        class Listed(LearningRateCallback):
            @staticmethod
            def rule(mu, step, values):
                return 0.1

        with pytest.raises(ValueError, match=r"`values` must be a finite number, but got \[1\]"):
            Listed(mu_0=0.1, values=[1])

    @pytest.mark.parametrize("kind", [LeanVecEnv, CompiledVecEnv])
    def test_one_that_is_installed_in_the_middle_brings_its_constants(self, kind):
        """Which action's value it sees, and whether μ starts anew with every episode."""
        other = method(7, next_action="max", reset_each_episode=True).method
        callback = At(5, lambda model: model.install_method(other, restart=True))
        model = TabularQ("MlpPolicy", make_vec_env(LAKE, vec_env_cls=kind), seed=0, callback_interval=10)
        model.learn(100, callback=callback)
        record = model.training.record
        assert (record["next_action"][0], record["resets_mu"][0]) == (NEXT_ACTIONS["max"], 1)

    def test_more_steps_than_fit_into_64_bits(self):
        model = TabularQ("MlpPolicy", LAKE, seed=0, total_episodes=3).learn(10**19)
        assert model._episode_num == 3


class TestCounter:
    @pytest.mark.parametrize("kind", [LeanVecEnv, CompiledVecEnv])
    def test_one_that_is_set_in_the_middle_is_drawn_from(self, kind):
        """SplitMix64 adds the golden ratio to its counter at every draw, so that the difference counts the draws."""

        def replace(model):
            model.training.draws[0] = 5

        env = make_vec_env(LAKE, vec_env_cls=kind)
        model = TabularQ("MlpPolicy", env, seed=0, exploration_final_eps=1.0, callback_interval=100)
        model.learn(500, callback=At(100 if kind is LeanVecEnv else 1, replace))
        draws = (int(model.training.draws[0]) - 5) * pow(0x9E3779B97F4A7C15, -1, 2**64) % 2**64
        assert 400 <= draws <= 2 * 401 + 100


class TestPolicy:
    @pytest.mark.parametrize("compiled", [False, True])
    def test_another_one_is_learned_into(self, compiled):
        env = make_vec_env(LAKE, vec_env_cls=CompiledVecEnv if compiled else LeanVecEnv)
        model = TabularQ("MlpPolicy", env, seed=0, learning_rate=0.5)
        other = TabularQPolicy(model.observation_space, model.action_space, model.lr_schedule, initial_q=1.0)
        model.policy = other
        model.learn(500)
        assert (other.q_table.numpy() != 1.0).any()
        assert model.mu == other.mu.item() == 0.5

    @pytest.mark.parametrize("compiled", [False, True])
    def test_a_table_that_a_callback_assigns_is_learned_into(self, compiled):
        """As NumPy's view of it is: both are the table that learning goes on with."""

        def assign_tensor(model):
            model.policy.q_table = th.full((16, 4), 3.0)  # of float32, which PyTorch makes where nothing is said

        def assign_array(model):
            model.q_table = np.full((16, 4), 3.0)

        tables = []
        for assign in (assign_tensor, assign_array):

            def callback(variables, _, assign=assign):
                model = variables["self"]
                if model.num_timesteps == 400:
                    assign(model)
                return True

            env = make_vec_env(LAKE, vec_env_cls=CompiledVecEnv if compiled else LeanVecEnv)
            model = TabularQ("MlpPolicy", env, seed=0, learning_rate=0.5, callback_interval=100 if compiled else None)
            tables.append(model.learn(1000, callback).q_table.copy())
        np.testing.assert_array_equal(*tables)
        assert ((tables[0] < 3.0) & (tables[0] > 0.0)).sum() > 10  # γ < 1 shrinks what was assigned
        assert (tables[0] == 3.0).any()  # what was not visited again is as it was assigned

    def test_a_table_that_is_a_view_of_itself_or_has_a_gradient(self):
        model = TabularQ("MlpPolicy", LAKE)
        model.policy.q_table = th.arange(64.0, requires_grad=True).reshape(16, 4)
        model.policy.q_table = model.policy.q_table.flip(1)
        np.testing.assert_array_equal(model.q_table[0], [3.0, 2.0, 1.0, 0.0])
        model.policy.q_table = model.policy.q_table[:1].expand(16, 4)
        np.testing.assert_array_equal(copy.deepcopy(model).q_table, np.tile([3.0, 2.0, 1.0, 0.0], (16, 1)))
        transposed = model.policy.q_table.reshape(4, 16).t()
        expected = transposed.clone()
        model.policy.q_table = transposed
        assert th.equal(model.policy.q_table, expected)

    def test_a_table_of_float32_can_be_replaced(self):
        model = TabularQ("MlpPolicy", LAKE, seed=0)
        model.policy.float()
        with pytest.raises(ValueError, match="`q_table` must be a contiguous tensor of float64"):
            model.learn(10)
        model.policy.q_table, model.policy.mu = th.ones((16, 4), dtype=th.float64), th.zeros(1, dtype=th.float64)
        assert (model.learn(500).q_table < 1.0).any()

    @pytest.mark.parametrize("value", [th.zeros(16, 3), None, np.zeros((16, 4))])
    def test_what_is_no_tensor_of_the_tables_shape_cannot_be_assigned(self, value):
        model = TabularQ("MlpPolicy", LAKE, initial_q=1.0)
        with pytest.raises(ValueError, match=r"`q_table` must be given a tensor of shape \(16, 4\), but got "):
            model.policy.q_table = value
        assert (model.q_table == 1.0).all()

    @pytest.mark.parametrize(
        "change", [lambda table: table.float(), lambda table: table[:8], lambda table: table.t().contiguous().t()]
    )
    def test_a_table_of_another_kind_is_refused(self, change):
        model = TabularQ("MlpPolicy", LAKE, seed=0)
        model.policy.register_buffer("q_table", change(model.policy.q_table))
        with pytest.raises(ValueError, match=r"`q_table` must be a contiguous tensor of float64 and of shape \(16, 4\)"):
            model.learn(10)
        assert model.num_timesteps == 0

    def test_a_copy_of_a_model_that_is_not_set_up(self):
        model = copy.deepcopy(TabularQ("MlpPolicy", None, _init_setup_model=False))
        assert not hasattr(model, "policy")


class TestObservations:
    def test_fractions_are_refused(self):
        class Shifted(VecEnvWrapper):
            def reset(self):
                return self.venv.reset() + 0.5

            def step_wait(self):
                observations, rewards, dones, infos = self.venv.step_wait()
                return observations + 0.5, rewards, dones, infos

        model = TabularQ("MlpPolicy", Shifted(DummyVecEnv([lambda: gym.make(LAKE)])))
        with pytest.raises(ValueError, match=r"observation 0\.5 lies outside the observation space Discrete\(16\)"):
            model.learn(10)


class TestProtocol:
    def test_a_lean_vec_env_steps_in_two_halves(self):
        actions = []

        class Watched(LeanVecEnv):
            def step_async(self, given):
                actions.append(given.tolist())
                super().step_async(given)

        env = Watched([lambda: gym.make(LAKE)])
        env.reset()
        env.step(np.array([2]))
        assert actions == [[2]]

    def test_a_callback_that_keeps_no_variables_at_the_start_gets_them_at_every_step(self):
        class Careless(BaseCallback):
            def on_training_start(self, locals_, globals_):
                pass

            def _on_step(self):
                return {"self", "new_obs", "rewards", "dones", "infos", "actions"} <= set(self.locals)

        assert TabularQ("MlpPolicy", LAKE, seed=0).learn(20, callback=Careless()).num_timesteps == 20


def test_the_scalars_of_a_copy_are_those_of_the_model():
    model = TabularQ("MlpPolicy", LAKE, seed=0, method=7).learn(500, log_interval=None)
    twin = copy.deepcopy(model)
    assert twin.training.record.tobytes() == model.training.record.tobytes()
    model.learn(10)
    assert twin.training.record.tobytes() != model.training.record.tobytes()
