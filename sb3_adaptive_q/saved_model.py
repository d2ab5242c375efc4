"""The contents of a model file: collected from a model, and decoded to build one."""

import inspect
import warnings
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.utils import FloatSchedule

from sb3_adaptive_q.installed_method import MethodData
from sb3_adaptive_q.model_archive import Archive, refusing
from sb3_adaptive_q.policies import TabularQPolicy
from sb3_adaptive_q.running import last_observations, read_running
from sb3_adaptive_q.saved_values import NotData, decode, decode_schedule, encode, encode_schedule, find_class, path_of

#: Attributes that may be functions
_SCHEDULES = ("learning_rate", "lr_schedule", "exploration_schedule")
#: Prefixes of the names of arrays: those of the policy, and the working arrays of the algorithm
_POLICY, _WORKING = "policy.", "working."


class SavedModel(NamedTuple):
    """
    The contents of a file.

    :param name: the name of the file in messages
    :param algorithm: the name of the model's class
    :param attributes: attributes of the model by name, the constructor's arguments among them
    :param method: the method in force
    :param training: the scalars of :class:`sb3_adaptive_q.training_state.TrainingState` by name
    :param buffers: the policy's arrays by name
    :param working: the working arrays of the algorithm by name
    :param generator: the state of the generator that ``predict`` draws from
    :param running: see :func:`sb3_adaptive_q.running.read_running`; a dict with the ``reason`` if it could not be
        read; ``None`` if no episode was running
    :param system_info: the system that wrote the file, as a text
    """

    name: str
    algorithm: str
    attributes: dict[str, Any]
    method: MethodData | None
    training: dict[str, Any]
    buffers: dict[str, np.ndarray]
    working: dict[str, np.ndarray]
    generator: dict[str, Any] | None
    running: dict[str, Any] | None
    system_info: str


def collect(model: Any, left_out: set[str]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """
    :param model: a model
    :param left_out: attributes that are not saved
    :return: the model as plain data, and its arrays by name
    """
    arrays = {_POLICY + name: tensor.cpu().numpy() for name, tensor in model.get_parameters()["policy"].items()}
    arrays |= {_WORKING + name: array for name, array in model._working.items()}
    method = model._missing_method if model._method is None else model._method.data
    data = {
        "algorithm": type(model).__name__,
        "attributes": _encode_attributes(model, left_out, arrays),
        "method": None if method is None else encode(method._asdict(), arrays),
        "training": encode(model.training.as_data(), arrays),
        "generator": encode(dict(model._predict_generator.bit_generator.state), arrays),
        "running": None if model._last_obs is None else _encode_running(model, arrays),
    }
    return data, arrays


def _encode_attributes(model: Any, left_out: set[str], arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    values = {name: value for name, value in vars(model).items() if name not in left_out}
    encoded, skipped = {}, []
    if "_last_obs" in values:
        values["_last_obs"] = last_observations(model)
    follows = encode_schedule(values.get("lr_schedule")) == encode_schedule(FloatSchedule(model.learning_rate))
    if follows or (model._learning is None and model.is_learning_rate_new):
        values.pop("lr_schedule", None)  # the learning rate decides it, now or in the next training
    if "policy_class" in values:
        names = [name for name, kind in model.policy_aliases.items() if kind is values["policy_class"]]
        values["policy_class"] = names[0] if names else path_of(values["policy_class"])
    for name, value in values.items():
        try:
            encoded[name] = encode_schedule(value) if name in _SCHEDULES else encode(value, arrays)
        except NotData as error:
            skipped.append(f"{name} ({error})")
    if skipped:
        warnings.warn(f"Not saved, because a file holds plain data only: {', '.join(skipped)}.", stacklevel=5)
    return encoded


def _encode_running(model: Any, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    try:
        return encode(read_running(model), arrays)
    except Exception as error:  # an environment's own `get_state` may raise anything, and the table must be saved even so
        return {"reason": str(error)}


def decode_model(archive: Archive, kind: Any, custom_objects: dict[str, Any]) -> SavedModel:
    """
    :param archive: the file
    :param kind: the class of the model that is to be built
    :param custom_objects: values to use instead of those in the file, by the name of the attribute
    :return: the contents
    :raises ValueError: if they are not what :func:`collect` returns. The message names the file
    """
    data, arrays = archive.data, archive.arrays
    with refusing(archive.name, "is not a saved model of this package"):
        for name in data["attributes"]:
            _check_name(kind, name)
        attributes = {
            name: custom_objects[name] if name in custom_objects else _decode_attribute(kind, name, value, arrays)
            for name, value in data["attributes"].items()
        }
        method = data["method"]
        return SavedModel(
            archive.name,
            str(data["algorithm"]),
            attributes,
            None if method is None else MethodData(**decode(method, arrays)),
            decode(dict(data["training"]), arrays),
            buffers_of(archive),
            {name[len(_WORKING) :]: array for name, array in arrays.items() if name.startswith(_WORKING)},
            decode(data["generator"], arrays),
            decode(data["running"], arrays),
            archive.system_info,
        )


def buffers_of(archive: Archive) -> dict[str, np.ndarray]:
    """
    :param archive: a file
    :return: the policy's arrays by name
    """
    return {name[len(_POLICY) :]: array for name, array in archive.arrays.items() if name.startswith(_POLICY)}


def _check_name(kind: Any, name: str) -> None:
    """Refuse an attribute that would replace a method, or something that the model builds anew."""
    known = inspect.getattr_static(kind, name, None)
    is_method = callable(known) or isinstance(known, staticmethod | classmethod)
    if is_method or inspect.isdatadescriptor(known) or name in kind.built_anew:
        raise ValueError(f"it has the attribute {name!r}, which a file must not set")


def _decode_attribute(kind: Any, name: str, value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if name in _SCHEDULES:
        return decode_schedule(value)
    if name != "policy_class":
        return decode(value, arrays)
    if value in kind.policy_aliases:
        return kind.policy_aliases[value]
    try:
        return find_class(value, TabularQPolicy)
    except LookupError:
        raise ValueError(
            f"its policy is of the class {value!r}, which is not imported here: import it first, or pass "
            "`custom_objects={'policy_class': ...}`"
        ) from None
