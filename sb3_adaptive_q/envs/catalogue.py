"""The environments in which step sizes are compared, by short names, with what belongs to each problem."""

from typing import Any, NamedTuple

import gymnasium as gym


class Problem(NamedTuple):
    """
    An environment and how it is meant to be learned.

    :param env_id: for ``gymnasium.make``; the limit of steps registered with it is the problem's horizon
    :param gamma: the discount factor
    :param arguments: for ``gymnasium.make``
    :param initial_q: of all entries of the Q table. It is not 0 in environments where a table of zeros with ``ties="first"``
        would leave it to exploration alone to find the first reward
    """

    env_id: str
    gamma: float
    arguments: dict[str, Any]
    initial_q: float = 0.0

    def make(self, **arguments: Any) -> gym.Env[Any, Any]:
        """
        Make the environment.

        :param arguments: further ones, ``instance`` of a random process for example
        :return: the environment with its limit of steps
        """
        return gym.make(self.env_id, **(self.arguments | arguments))


#: Control problems whose learned policies are judged exactly
CONTROL = {
    "lake4": Problem("FrozenLake-v1", 0.99, {}),
    "lake8": Problem("FrozenLake8x8-v1", 0.99, {}),
    "lake4_dry": Problem("FrozenLake-v1", 0.99, {"is_slippery": False}, initial_q=1.0),
    "taxi": Problem("Taxi-v4", 0.99, {}),
    "cliff_slippery": Problem("CliffWalkingSlipperyLimited-v1", 0.99, {}),
    "windy_king": Problem("WindyKing-v0", 0.99, {}),
    "riverswim": Problem("RiverSwim-v0", 0.99, {}, initial_q=100.0),  # the largest reward / (1 - gamma)
    "chain": Problem("Chain-v0", 0.99, {}),
    "double_loop": Problem("DoubleLoop-v0", 0.99, {}),
    "dyna_maze": Problem("DynaMaze-v0", 0.95, {}, initial_q=1.0),
    "hasselt_grid": Problem("HasseltGrid-v0", 0.95, {}),
    "roulette": Problem("Roulette-v0", 0.95, {}),
    "garnet": Problem("Garnet-v0", 0.95, {}),
    "moving_goal": Problem("MovingGoal-v0", 0.99, {}),
    "drifting_garnet": Problem("DriftingGarnet-v0", 0.95, {}),
    "cliff": Problem("CliffWalkingLimited-v1", 0.99, {}),
    "lake8_dry": Problem("FrozenLake8x8-v1", 0.99, {"is_slippery": False}),
    "windy": Problem("WindyGrid-v0", 0.99, {}),
    "max_bias": Problem("MaxBias-v0", 1.0, {}),
    "six_arms": Problem("SixArms-v0", 0.95, {}),
    "blocking_maze": Problem("BlockingMaze-v0", 0.95, {}),
    "shortcut_maze": Problem("ShortcutMaze-v0", 0.95, {}),
    "riverswim_osband": Problem("RiverSwimOsband-v0", 0.99, {}),
}
#: Prediction problems, with one action, whose values are known
PREDICTION = {
    "one_state": Problem("OneState-v0", 0.9, {}),
    "one_state_99": Problem("OneState-v0", 0.99, {}),
    "drift_0001": Problem("DriftingMean-v0", 0.0, {"variance": 0.0001}),
    "drift_01": Problem("DriftingMean-v0", 0.0, {"variance": 0.01}),
    "drift_1": Problem("DriftingMean-v0", 0.0, {"variance": 1.0}),
    "random_walk_19": Problem("RandomWalk-v0", 1.0, {}),
    "hl_21": Problem("RingWalk-v0", 0.9, {"n_states": 21}),
    "hl_51": Problem("RingWalk-v0", 0.99, {"n_states": 51}),
    "hl_21_switch": Problem("SwitchingRingWalk-v0", 0.9, {}),
    "boyan": Problem("BoyanChain-v0", 1.0, {}),
}
PROBLEMS = CONTROL | PREDICTION
