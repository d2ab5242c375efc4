"""Files of format 1, which this package's first version wrote: SB3's own format, with pickled objects in it."""

from typing import Any

from stable_baselines3.common.save_util import load_from_zip_file

from sb3_adaptive_q.callbacks import METHODS, SignRateCallback
from sb3_adaptive_q.installed_method import MethodData
from sb3_adaptive_q.model_archive import name_of
from sb3_adaptive_q.saved_model import SavedModel
from sb3_adaptive_q.saved_values import path_of

#: Attributes of the first version that the training state holds now
_TRAINING = {
    "num_timesteps": "num_timesteps", "_episode_num": "n_episodes", "_n_updates": "n_updates", "exploration_rate": "epsilon"
}  # fmt: skip


def read_pickled(path: Any, custom_objects: dict[str, Any]) -> SavedModel:
    """
    Read a file of format 1. This unpickles its contents, which may execute any code.

    :param path: a path, with or without ``.zip``, or a binary file
    :param custom_objects: values to use instead of those in the file, by the name of the attribute
    :return: the contents
    :raises ValueError: if it is a file of another algorithm
    """
    name = name_of(path)
    if hasattr(path, "seek"):
        path.seek(0)
    data, parameters, _ = load_from_zip_file(path, custom_objects=custom_objects, device="cpu")
    buffers = {key: tensor.numpy() for key, tensor in dict(parameters.get("policy", {})).items()}
    if data is None or data.get("format_version") != 1 or "q_table" not in buffers:
        raise ValueError(
            f"The file {name} has Stable-Baselines3's own format, but no table: it holds a model of another algorithm."
        )
    method = data.pop("_rate_data", None)
    training = {ours: data.pop(theirs) for theirs, ours in _TRAINING.items() if theirs in data}
    training["mu"] = float(buffers["mu"][0])
    del data["format_version"]
    in_force = None if method is None else _method_of(method, data.get("method"))
    return SavedModel(name, "TabularQ", data, in_force, training, buffers, {}, None, None, "")


def _method_of(data: dict[str, Any], number: int | None) -> MethodData:
    if data["owner"] == path_of(SignRateCallback):  # its rule had another name for the change of μ
        data["parameters"]["change"] = data["parameters"].pop("step")
    make = METHODS[number].callback if number in METHODS else None
    is_by_number = make is not None and path_of(getattr(make, "func", make)) == data["owner"]
    return MethodData(label=f"method{number}" if is_by_number else data["owner"].rpartition(":")[2], **data)
