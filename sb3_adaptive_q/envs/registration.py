"""Environment ids that ``gymnasium.make`` knows once ``sb3_adaptive_q`` has been imported."""

from typing import Any

import gymnasium as gym

_CLIFF = "gymnasium.envs.toy_text.cliffwalking:CliffWalkingEnv"
_ENVS = "sb3_adaptive_q.envs."

#: Id, entry point, limit of steps and further arguments
_ENVIRONMENTS: list[tuple[str, str, int | None, dict[str, Any]]] = [
    ("CartPoleFriction-v0", _ENVS + "cartpole_friction:CartPoleFrictionEnv", 200, {}),
    # gymnasium's cliffs have no limit of steps: a greedy policy that runs into a wall would never end an episode.
    ("CliffWalkingLimited-v1", _CLIFF, 200, {}),
    ("CliffWalkingSlipperyLimited-v1", _CLIFF, 200, {"is_slippery": True}),
    ("MovingGoal-v0", _ENVS + "switching_tables:moving_goal", 200, {}),
    ("BlockingMaze-v0", _ENVS + "switching_tables:blocking_maze", 200, {}),
    ("ShortcutMaze-v0", _ENVS + "switching_tables:shortcut_maze", 200, {}),
    ("SwitchingRingWalk-v0", _ENVS + "switching_tables:switching_ring_walk", None, {}),
    ("DriftingGarnet-v0", _ENVS + "drifting_garnet:DriftingGarnetEnv", 1000, {}),
    ("DriftingMean-v0", _ENVS + "drifting_mean:DriftingMeanEnv", None, {}),
]
#: Of each table of our own: id, function in :mod:`sb3_adaptive_q.envs.tables`, limit of steps and arguments
_TABLES: list[tuple[str, str, int | None, dict[str, Any]]] = [
    ("WindyKing-v0", "windy_grid", 200, {"king": True}),
    ("WindyGrid-v0", "windy_grid", 200, {}),
    ("RiverSwim-v0", "river_swim", 5000, {}),
    ("RiverSwimOsband-v0", "river_swim_osband", 20, {}),
    ("Chain-v0", "chain", 1000, {}),
    ("DoubleLoop-v0", "double_loop", 1000, {}),
    ("SixArms-v0", "six_arms", 1000, {}),
    ("DynaMaze-v0", "dyna_maze", 200, {}),
    ("HasseltGrid-v0", "hasselt_grid", None, {}),
    ("Roulette-v0", "roulette", 1000, {}),
    ("MaxBias-v0", "max_bias", None, {}),
    ("Garnet-v0", "garnet", 1000, {}),
    ("OneState-v0", "one_state", None, {}),
    ("RandomWalk-v0", "random_walk", None, {}),
    ("RingWalk-v0", "ring_walk", None, {}),
    ("BoyanChain-v0", "boyan_chain", None, {}),
]
_REWARD_THRESHOLDS = {"CartPoleFriction-v0": 195.0}


def register_envs() -> None:
    """
    Register the environments of this package with gymnasium; ids that are already registered are left alone.

    ``gymnasium.make("sb3_adaptive_q:CartPoleFriction-v0")`` imports the package, and so registers them, by itself.
    """
    tables = [
        (env_id, _ENVS + "table_env:make_table_env", limit, {"table": table, **arguments})
        for env_id, table, limit, arguments in _TABLES
    ]
    for env_id, entry_point, limit, arguments in _ENVIRONMENTS + tables:
        if env_id not in gym.registry:
            gym.register(
                id=env_id,
                entry_point=entry_point,
                max_episode_steps=limit,
                reward_threshold=_REWARD_THRESHOLDS.get(env_id),
                kwargs=arguments,
            )
