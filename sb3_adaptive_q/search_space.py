"""What RL Zoo's ``--optimize`` searches: the arguments that all tabular algorithms take, and those of each algorithm."""

from collections.abc import Callable
from typing import Any

import optuna

from sb3_adaptive_q.algorithms.n_step import TARGETS
from sb3_adaptive_q.algorithms.q_lambda import VARIANTS
from sb3_adaptive_q.algorithms.traces import MARKS


def sample(
    trial: optuna.Trial, n_actions: int, n_envs: int, additional_args: dict[str, Any], *, algorithm: str
) -> dict[str, Any]:
    """
    Draw a candidate. All methods are described by the same four numbers, so that what is learned about one method helps with
    the others; Method 2 is Method 1 with another constant, and so is a plain learning rate. The arguments are also stored in
    the trial, by their own names, and RL Zoo prints those of the best trial.

    :param trial: the trial to draw for
    :param n_actions: unused, of RL Zoo's interface, as are the next two
    :param n_envs: unused
    :param additional_args: unused
    :param algorithm: the name of the algorithm
    :return: arguments of the algorithm
    """
    sampled: dict[str, Any] = {
        "method": trial.suggest_categorical("method", [1, 3, 4, 5, 6, 7, 8]),
        # The largest step size, the smallest one as a fraction of it, and how fast Methods 5 to 8 move, as a multiple
        "upper": trial.suggest_float("upper", 0.002, 1.0, log=True),
        "lower_fraction": trial.suggest_float("lower_fraction", 0.001, 1.0, log=True),
        "change": trial.suggest_float("change", 0.01, 10.0, log=True),
        "one_minus_gamma": trial.suggest_float("one_minus_gamma", 0.0001, 0.1, log=True),
        "exploration_fraction": trial.suggest_float("exploration_fraction", 0.1, 1.0),
        "exploration_final_eps": trial.suggest_float("exploration_final_eps", 0.0, 0.2),
    }
    if algorithm in OWN_ARGUMENTS:
        sampled |= OWN_ARGUMENTS[algorithm](trial)
    arguments = convert(sampled)
    for name, value in arguments.items():
        trial.set_user_attr(name, value)
    return arguments


def convert(sampled: dict[str, Any]) -> dict[str, Any]:
    """
    Turn what a trial stores into what a tabular algorithm takes.

    :param sampled: the values drawn by :func:`sample`, by their names in the trial
    :return: arguments of the algorithm
    """
    rest = dict(sampled)
    number, upper = rest.pop("method"), rest.pop("upper")
    lower, change = upper * rest.pop("lower_fraction"), upper * rest.pop("change")
    bounds = {"mu_0": upper, "lower": lower, "upper": upper}
    method_kwargs = {
        1: {"beta": upper},
        3: {"beta_1": lower, "beta_3": upper - lower},
        4: {"beta_1": lower, "beta_3": upper - lower},
        5: {"gain": -change, **bounds},
        6: {"gain": change, **bounds},
        7: {"step": change, **bounds},
        8: {"step": -change, **bounds},
    }
    return {
        "method": number,
        "method_kwargs": method_kwargs[number],
        "gamma": 1.0 - rest.pop("one_minus_gamma"),
        **rest,
    }


def _sample_double_q(trial: optuna.Trial) -> dict[str, Any]:
    return {"target": trial.suggest_categorical("target", ["max", "expected"])}


def _sample_traces(trial: optuna.Trial) -> dict[str, Any]:
    return {
        "trace_decay": trial.suggest_float("trace_decay", 0.0, 1.0),
        "trace": trial.suggest_categorical("trace", list(MARKS)),
    }


def _sample_sarsa_lambda(trial: optuna.Trial) -> dict[str, Any]:
    sampled = _sample_traces(trial)
    if sampled["trace"] == "dutch":
        sampled["true_online"] = trial.suggest_categorical("true_online", [False, True])
    return sampled


def _sample_q_lambda(trial: optuna.Trial) -> dict[str, Any]:
    return {"variant": trial.suggest_categorical("variant", list(VARIANTS)), **_sample_traces(trial)}


def _sample_n_step(trial: optuna.Trial) -> dict[str, Any]:
    return {
        "n": trial.suggest_int("n", 1, 32, log=True),
        "target": trial.suggest_categorical("target", list(TARGETS)),
    }


#: By the name of the algorithm, what draws the arguments that only it takes
OWN_ARGUMENTS: dict[str, Callable[[optuna.Trial], dict[str, Any]]] = {
    "double_q": _sample_double_q,
    "sarsa_lambda": _sample_sarsa_lambda,
    "q_lambda": _sample_q_lambda,
    "n_step": _sample_n_step,
}
