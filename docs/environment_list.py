"""Writes the table of this package's environments: what gymnasium's registry and their docstrings say of them."""

import inspect
from importlib import import_module
from pathlib import Path

import gymnasium as gym
from catalogue import table, write_if_new
from gymnasium.envs.registration import EnvSpec

from sb3_adaptive_q.envs import PROBLEMS
from sb3_adaptive_q.envs.tables import TABLES
from sb3_adaptive_q.state_index import make_state_index


def write(folder: Path) -> None:
    """
    Write ``environments.md``. If it has not changed, it is not written again.

    :param folder: where to
    """
    # The cliffs with a limit of steps are gymnasium's class under an id of this package
    own = [each for each in gym.registry.values() if str(each.entry_point).startswith("sb3_") or "Limited" in each.id]
    head = ("id", "in the league", "states", "actions", "limit of steps", "what it is")
    write_if_new(folder / "environments.md", "\n".join(table(head, [row(each) for each in own])))


def row(spec: EnvSpec) -> tuple[str, ...]:
    """
    :param spec: an environment of gymnasium's registry
    :return: its row of the table
    """
    env = gym.make(spec.id)
    short = ", ".join(f"`{name}`" for name, problem in PROBLEMS.items() if problem.env_id == spec.id)
    finite = not isinstance(env.observation_space, gym.spaces.Box)
    states = str(make_state_index(env.observation_space).n_states) if finite else "continuous"
    actions = str(getattr(env.action_space, "n", ""))
    return f"`{spec.id}`", short, states, actions, str(spec.max_episode_steps or "none"), summary(spec)


def summary(spec: EnvSpec) -> str:
    """
    :param spec: an environment of gymnasium's registry
    :return: the first sentence of its docstring, without the verb
    """
    module, _, name = str(spec.entry_point).partition(":")
    if module.startswith("gymnasium."):
        return f"gymnasium's {name.removesuffix('Env')}{', slippery' if spec.kwargs.get('is_slippery') else ''}"
    function = TABLES[spec.kwargs["table"]] if "table" in spec.kwargs else getattr(import_module(module), name)
    text = " ".join((inspect.getdoc(function) or "").split("\n\n")[0].split()).rstrip(".")
    for verb in ("Build ", "Make "):
        text = text.removeprefix(verb)
    return text[0].upper() + text[1:].replace(":func:`sb3_adaptive_q.envs.tables.garnet`", "`Garnet-v0`").replace("``", "`")
