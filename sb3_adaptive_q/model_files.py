"""Models as files of plain data: SB3's ``save``, ``load`` and ``set_parameters``."""

import difflib
import inspect
import warnings
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, TypeVar

import numpy as np
import torch as th
from stable_baselines3.common.type_aliases import GymEnv, TensorDict
from stable_baselines3.common.utils import FloatSchedule, check_for_correct_spaces, get_system_info

from sb3_adaptive_q.action_masks import ALLOWED
from sb3_adaptive_q.callbacks import LearningRateCallback, iterate_callbacks
from sb3_adaptive_q.checks import ATTRIBUTES, CONSTRUCTOR, check
from sb3_adaptive_q.installed_method import InstalledMethod, MethodData
from sb3_adaptive_q.model_archive import HoldsPickles, read_archive, refusing, write_archive
from sb3_adaptive_q.old_files import read_pickled
from sb3_adaptive_q.policies import MEMORY, count_actions
from sb3_adaptive_q.running import check_actions
from sb3_adaptive_q.saved_model import SavedModel, buffers_of, collect, decode_model
from sb3_adaptive_q.saved_values import MissingFunction, find_class
from sb3_adaptive_q.state_index import make_state_index
from sb3_adaptive_q.step_sizes import STEP_SIZES, resolve_parameters
from sb3_adaptive_q.training_state import TrainingState

#: The largest number of environments that a file may have
MOST_ENVS = 1_000_000
#: The arguments that replace the method of a file
_METHOD = frozenset(("method", "method_kwargs"))

SelfSavedAsData = TypeVar("SelfSavedAsData", bound="SavedAsData")


class SavedAsData:
    """Mixin of :class:`sb3_adaptive_q.TabularAlgorithm`: its files, which :mod:`sb3_adaptive_q.model_archive` describes."""

    #: Attributes that a model builds anew when it is loaded, or that the file stores in another way
    built_anew: ClassVar[frozenset[str]] = frozenset(
        (
            "policy", "device", "env", "replay_buffer", "rollout_buffer", "_vec_normalize_env", "_logger", "_custom_logger",
            "choices", "considered", "episode_series", "training", "_known_learning_rate", "_learning",
            "_method", "_missing_method", "_next_actions", "_predict_generator", "_rollout", "_schedule_parameters",
            "_unfinished", "_update_parameters", "_working",
        )
    )  # fmt: skip

    _missing_method: MethodData | None

    def save(self, path: Any, exclude: Iterable[str] | None = None, include: Iterable[str] | None = None) -> None:
        """
        Save the model. The file is replaced as a whole: if the process is killed or the power fails, there is either the
        complete new file or the unchanged old one.

        In a callback, everything that the training needs to continue exactly is saved too; see :meth:`resume`.

        :param path: where to save it, a path or a binary file; a path without suffix gets ``.zip``
        :param exclude: attributes that are not saved
        :param include: attributes that are saved although they are excluded by default or by ``exclude``
        :raises OSError: if the file cannot be written; an older file of that name is unchanged
        """
        left_out = {*(exclude or ()), *self._excluded_save_params()} - set(include or ())  # type: ignore[attr-defined]
        data, arrays = collect(self, left_out | self.built_anew)
        try:
            _check_values({name: tensor.numpy() for name, tensor in self.policy.named_buffers()})  # type: ignore[attr-defined]
        except ValueError as error:
            warnings.warn(f"`load` will refuse the file {path}: {error}. Did the training diverge?", stacklevel=2)
        write_archive(path, data, arrays)

    @classmethod
    def load(
        cls: type[SelfSavedAsData],
        path: Any,
        env: GymEnv | str | None = None,
        device: th.device | str = "auto",
        custom_objects: dict[str, Any] | None = None,
        print_system_info: bool = False,
        force_reset: bool = True,
        allow_pickle: bool = False,
        **kwargs: Any,
    ) -> SelfSavedAsData:
        """
        Load a model, as :meth:`stable_baselines3.common.base_class.BaseAlgorithm.load` does. Nothing in the file is executed.

        A ``method`` or a ``learning_rate`` among the keyword arguments replaces the saved method. A learning rate in
        ``custom_objects`` has an effect only if the model was saved without a method. The agent's random numbers continue
        where they were. The environment is seeded anew, so that the agent does not learn twice from the same random numbers.

        :param path: the file, a path with or without ``.zip`` or a binary file
        :param env: the environment to learn from, or its id; ``None`` for a model that only predicts
        :param device: as in the constructor
        :param custom_objects: values to use instead of those in the file, by the name of the attribute
        :param print_system_info: whether to print the system that the model was saved on, and this one
        :param force_reset: whether learning begins with a reset of the environment
        :param allow_pickle: whether to read a file of this package's first version, which may execute what is in it
        :param kwargs: attributes of the model that differ from the file
        :return: the model
        :raises ValueError: if the file is damaged or of another kind, the environment has other spaces, or an argument lies
            outside its range. Nothing has changed then
        :raises FileNotFoundError: if there is no such file
        """
        force_reset = check("force_reset", force_reset)
        saved = cls._read(path, custom_objects, print_system_info, allow_pickle)
        given = custom_objects or {}
        chosen = {name: value for name, value in given.items() if name in _METHOD or _can_be_set(cls, name)}
        model = cls._build(saved, env, device, force_reset, chosen | kwargs)
        if "lr_schedule" in given and saved.method is None:
            model._set_schedule(given["lr_schedule"])
        if "seed" not in kwargs and saved.training.get("num_timesteps", 0) > 0:
            model._seed_environments_anew()
        return model

    @classmethod
    def _read(
        cls, path: Any, custom_objects: dict[str, Any] | None, print_system_info: bool, allow_pickle: bool = False
    ) -> SavedModel:
        allow_pickle, custom = check("allow_pickle", allow_pickle), dict(check("custom_objects", custom_objects) or {})
        print_system_info = check("print_system_info", print_system_info)
        if print_system_info:
            print("== CURRENT SYSTEM INFO ==")
            get_system_info()
        try:
            archive = read_archive(path)
        except HoldsPickles:
            if not allow_pickle:
                raise
            return read_pickled(path, custom)
        if print_system_info:
            print(f"== SAVED MODEL SYSTEM INFO ==\n{archive.system_info}")
        if archive.data.get("method") is not None:  # RL Zoo's enjoy passes a learning rate of 0 for every model
            custom.pop("learning_rate", None)
        return decode_model(archive, cls, custom)

    @classmethod
    def _build(
        cls: type[SelfSavedAsData],
        saved: SavedModel,
        env: Any,
        device: th.device | str,
        force_reset: bool,
        kwargs: dict[str, Any],
    ) -> SelfSavedAsData:
        """Build a model from the contents of a file, without the training that was running."""
        attributes, changes = dict(saved.attributes), _changes_of_method(kwargs)
        known_method = attributes.pop("_known_method", None)
        properties = {name for name in changes if _is_property(cls, name)}
        changes = _checked(cls, changes, {*properties, *attributes})
        with refusing(saved.name, "cannot be loaded"):
            _check_numbers(attributes, saved)
            method = _find_method(saved.method)
            if env is not None:
                env = cls._wrap_env(env, attributes.get("verbose", 0))  # type: ignore[attr-defined]
                check_for_correct_spaces(env, attributes["observation_space"], attributes["action_space"])
                if force_reset or env.num_envs != attributes.get("n_envs"):
                    attributes["_last_obs"] = None
                attributes["n_envs"] = env.num_envs
        if kwargs.get("policy_kwargs", attributes.get("policy_kwargs")) != attributes.get("policy_kwargs"):
            raise ValueError(
                f"`policy_kwargs` must be as in the file, {attributes.get('policy_kwargs')}, but got "
                f"{kwargs['policy_kwargs']}: please leave them out."
            )
        with refusing(saved.name, "cannot be loaded"):
            model = cls(policy=attributes["policy_class"], env=env, device=device, _init_setup_model=False)  # type: ignore[call-arg]
            model.__dict__.update(attributes)
            model.__dict__.update({name: value for name, value in changes.items() if name not in properties})
            schedule = None if "learning_rate" in changes else attributes.get("learning_rate")
            is_unused = callable(schedule) and _METHOD.isdisjoint(changes)
            if is_unused:  # a function that the file names is called by `learn`, not here: μ is in the file
                model.learning_rate = 0.0  # type: ignore[attr-defined]
            model._setup_model()  # type: ignore[attr-defined]
            if is_unused:
                model.learning_rate = model._known_learning_rate = schedule  # type: ignore[attr-defined]
                model._setup_lr_schedule()  # type: ignore[attr-defined]
            model._restore(saved, method, changes)
            if known_method is not None and _METHOD.isdisjoint(changes):  # another one may have been assigned since
                model._known_method = known_method  # type: ignore[attr-defined]
            schedule = changes.get("lr_schedule", None if "learning_rate" in changes else attributes.get("lr_schedule"))
            if schedule is not None:
                model._set_schedule(schedule)
        for name in properties:
            setattr(model, name, changes[name])
        return model

    def _restore(self, saved: SavedModel, method: InstalledMethod | None, changes: dict[str, Any]) -> None:
        model: Any = self
        buffers, training = saved.buffers, dict(saved.training)
        is_method_replaced = not _METHOD.isdisjoint(changes)
        if is_method_replaced:  # the file's μ and memory belong to the old method
            buffers = {name: array for name, array in buffers.items() if not name.startswith(MEMORY) and name != "mu"}
            training.pop("mu", None)
        else:
            self._put_in_force(method, saved.method, buffers)
        if "seed" in changes:
            training.pop("counter", None)
        elif saved.generator is not None:
            model._predict_generator.bit_generator.state = saved.generator
        _check_names_and_shapes(model.policy.state_dict(), buffers, is_complete=not is_method_replaced, is_file=True)
        model.policy.load_state_dict({name: th.from_numpy(array) for name, array in buffers.items()}, strict=False)
        model.check_masks()
        model.training.restore(training)
        if model._last_obs is not None:
            self._restore_next_step(saved, is_changed=bool(changes))
        model._choose_functions()

    def _put_in_force(
        self, method: InstalledMethod | None, data: MethodData | None, buffers: Mapping[str, np.ndarray]
    ) -> None:
        model: Any = self
        model._use_method(method)
        model.policy.forget_memory()
        if method is not None:
            model._declare_memory(method)
        elif data is not None:
            warnings.warn(
                f"The class of the saved method, {data.owner}, is not imported: the model learns with its `learning_rate` "
                "until the callback of that method, or of another one, is passed to `learn`.",
                stacklevel=5,
            )
            model._missing_method = data
            # The memory of the method is kept for its callback, and for the next file
            model.policy.declare({name: array.shape for name, array in buffers.items() if name.startswith(MEMORY)}, 0.0)

    def _restore_next_step(self, saved: SavedModel, is_changed: bool) -> None:
        """Restore the working arrays and the next actions, with which the running episode continues."""
        model: Any = self
        expected = model.new_working_arrays()
        fits = {name: (array.shape, array.dtype) for name, array in saved.working.items()} == {
            name: (array.shape, array.dtype) for name, array in expected.items()
        }
        if not fits and is_changed:  # of another size, because of another γ or λ: they begin anew
            return
        if not fits or any(np.isnan(array).any() for array in saved.working.values()):
            raise ValueError(f"the working arrays of {type(self).__name__} do not fit this table and these environments")
        model.check_working_arrays(saved.working)
        model._working = saved.working
        actions = (saved.running or {}).get("next_actions")
        model._next_actions = check_actions(actions, model.n_envs, model.q_table.shape[1])

    def _set_schedule(self, schedule: Any) -> None:
        model: Any = self
        model.lr_schedule = FloatSchedule(schedule)
        model._choose_functions()

    def _seed_environments_anew(self) -> None:
        """Seed the environments: their numbers differ from those at the start, and from those after another saved file."""
        model: Any = self
        if model.env is not None and model.seed is not None:
            entropy = [int(model.seed), int(model.training.record["counter"][0])]
            model.env.seed(int(np.random.SeedSequence(entropy).generate_state(1)[0]))

    def set_parameters(
        self, load_path_or_dict: str | TensorDict, exact_match: bool = True, device: th.device | str = "auto"
    ) -> None:
        """
        Replace tables, memory and μ: all of them, or none after an error.

        :param load_path_or_dict: a saved file, or what ``get_parameters`` returned
        :param exact_match: whether all of them must be there
        :param device: unused: the table stays where it is
        :raises ValueError: if a file or a number in it is refused. Nothing has changed then
        :raises RuntimeError: if the names or shapes of the parameters are not the model's
        """
        given: Any = load_path_or_dict
        if not isinstance(given, dict):
            archive = read_archive(given)
            with refusing(archive.name, "does not fit"):
                self._take_parameters({"policy": buffers_of(archive)}, exact_match)
        else:
            self._take_parameters(given, exact_match)

    def _take_parameters(self, given: Mapping[str, Any], is_complete: bool) -> None:
        policy = self.policy  # type: ignore[attr-defined]
        unknown = sorted(set(given) - {"policy"})
        if unknown or (is_complete and not given):
            raise ValueError(f"Parameters must be a dict with the key 'policy', but got {unknown or 'an empty one'}.")
        policy_given = given.get("policy", {})
        if not isinstance(policy_given, Mapping):
            raise ValueError(f"Parameters must be a dict of tensors under the key 'policy', but got {policy_given!r} there.")
        values = {name: th.as_tensor(value) for name, value in policy_given.items()}
        arrays = {name: value.cpu().numpy() for name, value in values.items()}
        _check_names_and_shapes(policy.state_dict(), arrays, is_complete)
        _check_values(arrays)
        tables = {"q_table", *self.extra_tables(policy.n_states, policy.n_actions)}  # type: ignore[attr-defined]
        if 0 < len(tables & set(arrays)) < len(tables):
            raise ValueError(f"{', '.join(sorted(tables))} belong together: please give all of them, but got {list(arrays)}.")
        policy.load_state_dict(values, strict=is_complete)

    def check_functions_found(self, callback: Any) -> None:
        """
        :param callback: what ``learn`` is given
        :raises ValueError: if the training needs a function that was not found when the model was loaded
        """
        model: Any = self
        changed = model.learning_rate is not model._known_learning_rate
        schedule = model.learning_rate if changed else getattr(model.lr_schedule, "value_schedule", None)
        brings_method = any(isinstance(each, LearningRateCallback) for each in iterate_callbacks(callback))
        needed = {"exploration_schedule": model.exploration_schedule}
        if model._method is None and not brings_method:
            needed["learning_rate"] = schedule
        for name, function in needed.items():
            if isinstance(function, MissingFunction):
                nameless = "<" in function.path  # such as module:<lambda>
                remedy = "no program can import: please" if nameless else "is not imported here: import it and load again, or"
                raise ValueError(
                    f"The saved model has the function {function.path} as its `{name}`, which {remedy} set `model.{name}`."
                )


def _is_property(kind: type, name: str) -> bool:
    return isinstance(inspect.getattr_static(kind, name, None), property)


def _can_be_set(kind: type, name: str) -> bool:
    return _is_property(kind, name) and getattr(kind, name).fset is not None


def _changes_of_method(kwargs: dict[str, Any]) -> dict[str, Any]:
    """What the keyword arguments of ``load`` change. A learning rate, or another method, replaces the saved method."""
    if "method" in kwargs:
        return {"method_kwargs": None, **kwargs}
    if "learning_rate" in kwargs and "method_kwargs" not in kwargs:
        return {"method": None, "method_kwargs": None, **kwargs}
    return dict(kwargs)


def _checked(kind: type, changes: Mapping[str, Any], attributes: set[str]) -> dict[str, Any]:
    """Check what ``load`` is to change, before the file is blamed for it. The result has the names of the attributes."""
    known = {*CONSTRUCTOR, "method", "lr_schedule", *attributes}
    for name in sorted(set(changes) - known):  # a misspelt name would have no effect
        nearest = difflib.get_close_matches(name, known, n=1)
        advice = f": did you mean `{nearest[0]}`?" if nearest else "."
        raise ValueError(f"`load` got `{name}`, but a {kind.__name__} has no such argument{advice}")
    at_once = set(CONSTRUCTOR) - {"exploration_initial_eps", "exploration_final_eps"}  # their ranges depend on other arguments
    return {ATTRIBUTES.get(name, name): check(name, value) if name in at_once else value for name, value in changes.items()}


def _find_method(data: MethodData | None) -> InstalledMethod | None:
    """
    :param data: the method as data
    :return: the method; ``None`` where there is none, or its class is not imported
    :raises ValueError: if the data do not describe a method
    """
    if data is None:
        return None
    if not data.label.isidentifier():  # it becomes the name of a folder
        raise ValueError(f"its method has the name {data.label!r}, which is not an identifier")
    if data.owner in STEP_SIZES:
        resolve_parameters(data.owner, data.parameters)
        return InstalledMethod(data, (STEP_SIZES[data.owner].step_size, None))
    try:
        owner = find_class(data.owner, LearningRateCallback)
    except LookupError:
        return None
    return InstalledMethod(data, (owner.step_size, owner.rule))


def _check_numbers(attributes: dict[str, Any], saved: SavedModel) -> None:
    """Check, before anything is made or seeded, the shape of the table and the ranges of all numbers."""
    shape = make_state_index(attributes["observation_space"]).n_states, count_actions(attributes["action_space"])
    if saved.buffers["q_table"].shape != shape:
        raise ValueError(f"`q_table` has the shape {saved.buffers['q_table'].shape}, but the spaces need {shape}")
    n_envs = attributes.get("n_envs", 1)
    if not (type(n_envs) is int and 1 <= n_envs <= MOST_ENVS):
        raise ValueError(f"`n_envs` must be from 1 to {MOST_ENVS}, but got {n_envs!r}")
    _check_values(saved.buffers)
    TrainingState().restore(saved.training)


def _check_values(arrays: Mapping[str, np.ndarray]) -> None:
    for name, array in arrays.items():
        if array.dtype.kind not in ("biuf" if name == ALLOWED else "iuf"):
            raise ValueError(f"`{name}` must hold real numbers, but holds {array.dtype}")
        sound = ~np.isnan(array) if name.startswith(MEMORY) else np.isfinite(array)
        if not sound.all():
            raise ValueError(f"`{name}` must hold finite numbers, but has NaN or infinities: {int((~sound).sum())} of them")
    if "mu" in arrays:
        check("mu", float(arrays["mu"].ravel()[0]))


def _check_names_and_shapes(
    own: Mapping[str, th.Tensor], given: Mapping[str, np.ndarray], is_complete: bool, is_file: bool = False
) -> None:
    """Check arrays, before the first of them replaces one of the model's."""
    missing, unknown = sorted(set(own) - set(given)), sorted(set(given) - set(own))
    if is_complete and (missing or unknown):
        raise RuntimeError(
            f"the parameters must be those of the model, but missing are {missing or 'none'}, and unknown {unknown or 'none'}"
        )
    for name in set(own) & set(given):
        array, shape = given[name], tuple(own[name].shape)
        if array.shape != shape:
            raise RuntimeError(f"size mismatch: `{name}` has the shape {shape}, but got {array.shape}")
        if is_file and array.dtype != own[name].numpy().dtype:
            raise ValueError(f"`{name}` is of {own[name].numpy().dtype}, but got {array.dtype}")
