"""Environments that learning loops can run as machine code."""

from collections.abc import Callable

import gymnasium as gym

from sb3_adaptive_q.vec_env.comparison import compare_with_environment
from sb3_adaptive_q.vec_env.compiled_env import CompiledEnv
from sb3_adaptive_q.vec_env.lean_vec_env import LeanVecEnv


class CompiledVecEnv(LeanVecEnv):
    """
    A VecEnv of gymnasium environments whose dynamics are compiled with Numba.

    ``step`` makes one ordinary transition of each environment. An algorithm such as :class:`sb3_adaptive_q.TabularQ` trains
    here in rollouts of compiled code, each of many steps, and then puts the environments into the state in which the rollout
    ended. With the same seed the results are bit-identical to those of ordinary environments.

    It compiles gymnasium's FrozenLake, Taxi, CliffWalking and ``CartPole-v1``, and the environments of this package. Both Cart
    Poles need a :class:`sb3_adaptive_q.wrappers.DiscretizeObservation` around them. An environment of your own with a
    transition table ``P`` compiles if its class has the attribute ``compile_by_table = True``; for others see
    :func:`sb3_adaptive_q.vec_env.register_dynamics`.

    :param env_fns: functions that each make a new environment; all environments must be alike
    :raises ValueError: if an environment or a wrapper around it does not compile, or the environments differ
    """

    def __init__(self, env_fns: list[Callable[[], gym.Env]]) -> None:
        super().__init__(env_fns)
        self._compared: list[gym.Env] = []
        self.compile()

    def compile(self) -> list[CompiledEnv]:
        """
        Read the environments as they are now, and compare each new one with the functions that are compiled in its place.

        :return: the compiled form of each environment
        :raises ValueError: if an environment does not compile, differs from the others, or does not step as its
            functions do
        """
        if len(self.envs) != self.num_envs:
            raise ValueError(
                f"`envs` must hold {self.num_envs} environments, but holds {len(self.envs)}: make a new CompiledVecEnv."
            )
        compiled = [CompiledEnv(env) for env in self.envs]
        for i, each in enumerate(compiled[1:], 1):
            if not compiled[0].is_like(each):
                raise ValueError(
                    f"CompiledVecEnv needs environments that are alike, but environment {i} differs from the first: "
                    "use LeanVecEnv, which works with everything."
                )
        for each in compiled:
            if not any(each.unwrapped is env for env in self._compared):
                compare_with_environment(each)
        self._compared = [each.unwrapped for each in compiled]
        return compiled
