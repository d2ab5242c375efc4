"""How a training appears in TensorBoard: the name of its run, and what the HPARAMS page shows of it."""

import inspect
from typing import Any

import numpy as np
from stable_baselines3.common.logger import HParam, TensorBoardOutputFormat

from sb3_adaptive_q.callbacks import LearningRateCallback, iterate_callbacks

#: The metrics of the HPARAMS page: it shows the last value that was logged under each of these tags
METRICS = ("rollout/ep_rew_mean", "eval/mean_reward", "train/learning_rate")
#: How the page names arguments that all algorithms have, by the arguments' own names. It sorts by name, and shows the first
#: five at once. These shall be algorithm, gamma, method, method_kwargs and seed, so the others begin with later letters
_COMMON = {
    "gamma": "gamma",
    "seed": "seed",
    "initial_q": "table/initial_q",
    "ties": "ties",
    "exploration": "ε/exploration",
    "exploration_schedule": "ε/exploration_schedule",
    "exploration_initial_eps": "ε/exploration_initial_eps",
    "exploration_final_eps": "ε/exploration_final_eps",
    "exploration_fraction": "ε/exploration_fraction",
}


def run_name(model: Any, callback: Any) -> str:
    """
    :param model: a tabular algorithm
    :param callback: what is handed to ``learn``
    :return: the name of the algorithm, and that of the method that will be in force, such as ``TabularQ_method7``
    """
    given = [each.method for each in iterate_callbacks(callback) if isinstance(each, LearningRateCallback)]
    method = given[0] if given else model._method
    name = type(model).__name__
    return name if method is None else f"{name}_{method.data.label}"


def tensorboard_outputs(model: Any) -> list[TensorBoardOutputFormat]:
    """
    :param model: any algorithm, once it has a logger
    :return: those of the logger's outputs that write for TensorBoard
    """
    return [output for output in model.logger.output_formats if isinstance(output, TensorBoardOutputFormat)]


def record_hyperparameters(model: Any) -> None:
    """
    Write the hyperparameters to the TensorBoard outputs of the model's logger, where it has any.

    :param model: a tabular algorithm whose training starts
    """
    for output in tensorboard_outputs(model):
        write_hyperparameters(output, hyperparameters(model))


def write_hyperparameters(output: TensorBoardOutputFormat, values: dict[str, Any]) -> None:
    """
    :param output: where to write
    :param values: the hyperparameters by name
    """
    # The values of the metrics come from the log itself
    output.write({"hparams": HParam(values, dict.fromkeys(METRICS, 0.0))}, {"hparams": ()})


def hyperparameters(model: Any) -> dict[str, bool | str | float]:
    """
    The algorithm, the method with its parameters, and the arguments that decide what is learned. TensorBoard takes the columns
    of its table from one run alone, so what every run has comes under the same names: ``method_kwargs`` is a text.

    :param model: a tabular algorithm
    :return: the hyperparameters by name
    """
    method = model._method
    parameters = _parameters(method.data) if method is not None else {}
    shown: dict[str, Any] = {
        "algorithm": type(model).__name__,
        "method": "learning_rate" if method is None else method.data.label,
        "method_kwargs": ", ".join(f"{name}={_as_text(value)}" for name, value in parameters.items()),
        "μ/first": model.mu,
    }
    shown |= {name: getattr(model, argument) for argument, name in _COMMON.items()}
    shown |= {name: getattr(model, name, None) for name in _own_arguments(type(model))}
    shown |= {f"μ/{name}": value for name, value in parameters.items()}
    values = {name: _plain(value) for name, value in shown.items()}
    return {name: value for name, value in values.items() if value is not None}


def _parameters(data: Any) -> dict[str, Any]:
    """The parameters of a method, and what else of it differs from the defaults of all methods."""
    further = {name: getattr(data, name) for name in ("mu_0", "next_action", "scope", "reset_each_episode")}
    defaults = type(data)._field_defaults
    return {**data.parameters, **{name: value for name, value in further.items() if value != defaults[name]}}


def _own_arguments(kind: type[Any]) -> list[str]:
    """The named arguments that an algorithm adds to those that all have."""
    parameters = inspect.signature(kind).parameters.values()
    return [parameter.name for parameter in parameters if parameter.kind is inspect.Parameter.KEYWORD_ONLY]


def _plain(value: Any) -> bool | str | float | None:
    """A value as TensorBoard takes it; ``None``, which it leaves out, for what is no single value."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | str | int | float):
        return value
    return "a function" if callable(value) else None


def _as_text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
