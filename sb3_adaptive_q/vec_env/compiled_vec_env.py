"""Environments that learning loops can run as machine code."""

from collections.abc import Callable

import gymnasium as gym

from sb3_adaptive_q.vec_env.comparison import compare_with_environment
from sb3_adaptive_q.vec_env.compiled_env import CompiledEnv
from sb3_adaptive_q.vec_env.lean_vec_env import LeanVecEnv


class CompiledVecEnv(LeanVecEnv):
    """
    A VecEnv of gymnasium environments whose dynamics are compiled with Numba.

    ``step`` is one ordinary transition of the environments themselves. :class:`sb3_adaptive_q.TabularQ` learns on it in
    rollouts that never leave compiled code, and puts the environments where the rollout ended: with the same seed the
    result is that of ordinary environments, bit for bit.

    It compiles gymnasium's FrozenLake, Taxi and CliffWalking, and ``CartPole-v1`` and ``CartPoleFriction-v0`` under
    :class:`wrappers.DiscretizeObservation`. An environment of your own with a transition table ``P`` compiles where its class
    says ``compile_by_table = True``; for others see :func:`sb3_adaptive_q.vec_env.register_dynamics`.

    :param env_fns: functions that make the environments, each its own, all alike
    :raises ValueError: if an environment or a wrapper around it does not compile, or the environments differ
    """

    def __init__(self, env_fns: list[Callable[[], gym.Env]]) -> None:
        super().__init__(env_fns)
        self._compared: list[gym.Env] = []
        self.compile()

    def compile(self) -> list[CompiledEnv]:
        """
        Read the environments as they are now, and compare those that are new with the functions that stand for them.

        :return: what a learning loop needs of each
        :raises ValueError: if one does not compile, they differ, or one steps otherwise than its functions
        """
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
