"""
Transition tables of environments from the literature. Each is a function that returns the table and the start distribution.

``table[state][action]`` is a list of (probability, next state, reward, terminated), as in gymnasium's toy-text environments;
a state in which an episode has ended leads to itself, terminated, with a reward of 0.
"""

from collections.abc import Callable

from sb3_adaptive_q.envs.tables.grids import blocking_mazes, dyna_maze, hasselt_grid, moving_goals, shortcut_mazes, windy_grid
from sb3_adaptive_q.envs.tables.prediction import boyan_chain, one_state, random_walk, ring_walk
from sb3_adaptive_q.envs.tables.random_processes import Garnet, garnet
from sb3_adaptive_q.envs.tables.small import chain, double_loop, max_bias, river_swim, river_swim_osband, roulette, six_arms
from sb3_adaptive_q.envs.tables.types import Outcome, Start, Table

#: The functions by their names, for gymnasium's registry
TABLES: dict[str, Callable[..., tuple[Table, Start]]] = {
    function.__name__: function
    for function in (
        boyan_chain,
        chain,
        double_loop,
        dyna_maze,
        garnet,
        hasselt_grid,
        max_bias,
        one_state,
        random_walk,
        ring_walk,
        river_swim,
        river_swim_osband,
        roulette,
        six_arms,
        windy_grid,
    )
}

__all__ = [
    "TABLES",
    "Garnet",
    "Outcome",
    "Start",
    "Table",
    "blocking_mazes",
    "boyan_chain",
    "chain",
    "double_loop",
    "dyna_maze",
    "garnet",
    "hasselt_grid",
    "max_bias",
    "moving_goals",
    "one_state",
    "random_walk",
    "ring_walk",
    "river_swim",
    "river_swim_osband",
    "roulette",
    "shortcut_mazes",
    "six_arms",
    "windy_grid",
]
