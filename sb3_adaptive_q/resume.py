"""Continue a training exactly where it was saved."""

import warnings
from math import inf
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
import torch as th
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback

from sb3_adaptive_q.environment_state import check_environments, write_environments
from sb3_adaptive_q.model_archive import refusing
from sb3_adaptive_q.model_files import SavedAsData
from sb3_adaptive_q.rollouts.step_rollout import RolloutState, StepRollout
from sb3_adaptive_q.running import check_rollout
from sb3_adaptive_q.saved_model import SavedModel

SelfResumable = TypeVar("SelfResumable", bound="Resumable")


class Unfinished(NamedTuple):
    """
    A training that the next call of ``learn`` continues.

    :param training: the scalars of the training state
    :param rollout: the state of its rollout between two steps; ``None`` if a new episode begins
    """

    training: dict[str, Any]
    rollout: RolloutState | None


class Resumable(SavedAsData):
    """Mixin of :class:`sb3_adaptive_q.TabularAlgorithm`: trainings that continue as if they had not been interrupted."""

    #: Arguments that must not change, because that would make it another training
    _not_changed: ClassVar[frozenset[str]] = frozenset(("method", "method_kwargs", "learning_rate", "seed"))

    num_timesteps: int
    _total_timesteps: int
    _log_interval: int | None
    _unfinished: Unfinished | None

    @classmethod
    def resume(
        cls: type[SelfResumable],
        path: Any,
        env: GymEnv | str,
        device: th.device | str = "auto",
        custom_objects: dict[str, Any] | None = None,
        print_system_info: bool = False,
        **kwargs: Any,
    ) -> SelfResumable:
        """
        Load a model to continue the training in which it was saved. Then call :meth:`finish`, or
        ``learn(model.remaining_timesteps, reset_num_timesteps=False)``. The result is bit-identical to that of a training
        without an interruption.

        The state of the environments must be in the file. It is for gymnasium's toy-text and classic control, for environments
        with compiled dynamics, and for all with the methods ``get_state()`` and ``set_state(data)``, in a LeanVecEnv, a
        CompiledVecEnv or a DummyVecEnv. With other environments the training continues with a new episode, after a warning.
        Callbacks start anew: their best scores and counts of calls are not in the file.

        :param path: the file, as in :meth:`load`
        :param env: environments like those of the training, or an id; they are put into the state that was saved
        :param device: as in the constructor
        :param custom_objects: values to use instead of those in the file, such as a schedule that was a lambda
        :param print_system_info: whether to print the system that the model was saved on, and this one
        :param kwargs: attributes of the model that differ from the file, such as ``tensorboard_log``
        :return: the model
        :raises ValueError: if the file is refused, as in :meth:`load`, the environments are others, or an argument would make
            it another training
        """
        changed = sorted(cls._not_changed & set(kwargs))
        if changed:
            raise ValueError(
                f"`resume` continues the same training, so `{changed[0]}` must stay as it was: use `load` to change it."
            )
        saved = cls._read(path, custom_objects, print_system_info)
        if saved.algorithm != cls.__name__:
            raise ValueError(
                f"The file {saved.name} holds a model of {saved.algorithm}, not of {cls.__name__}: call "
                f"`{saved.algorithm}.resume`, or give train.py its name as `--algo`."
            )
        model = cls._build(saved, env, device, False, kwargs)
        model._go_back_to(saved)
        return model

    def _go_back_to(self, saved: SavedModel) -> None:
        model: Any = self
        running, rollout = saved.running, None
        if running is not None and "reason" not in running:
            with refusing(saved.name, "cannot be resumed with these environments"):
                check_environments(model.env, running["environments"])
                rollout = check_rollout(running["rollout"], model.n_envs, *model.q_table.shape)
                write_environments(model.env, running["environments"])
            if rollout is not None and rollout.transitions:
                # These actions were taken already. The next ones are not drawn yet
                model._next_actions = np.array([transition[1] for transition in rollout.transitions], dtype=np.int64)
        else:
            model._last_obs = model._next_actions = None
            if model.num_timesteps > 0:
                self._seed_environments_anew()
        if running is not None and "reason" in running:
            warnings.warn(f"The training continues with a new episode, because {running['reason']}.", stacklevel=3)
        self._unfinished = None if rollout is None else Unfinished(saved.training, rollout)

    @property
    def remaining_timesteps(self) -> int:
        """The environment steps that the latest training still has to take; 0 if it is finished."""
        return max(self._total_timesteps - self.num_timesteps, 0)

    def finish(
        self: SelfResumable, callback: MaybeCallback = None, tb_log_name: str | None = None, progress_bar: bool = False
    ) -> SelfResumable:
        """
        Continue the latest training to its end, after :meth:`resume`, an interrupt or an error.

        Progress, and all that depends on it, continues where it was. ``log_interval`` is that of the training.

        :param callback: as in ``learn``
        :param tb_log_name: as in ``learn``
        :param progress_bar: as in ``learn``
        :return: the model
        :raises ValueError: as in ``learn``
        :raises RuntimeError: as in ``learn``
        """
        model: Any = self
        begins_anew = self._unfinished is None
        if begins_anew:
            self._unfinished = Unfinished(model.training.as_data(), None)
        try:
            model.learn(self.remaining_timesteps, callback, self._log_interval, tb_log_name, False, progress_bar)
        finally:
            if begins_anew:
                self._unfinished = None
        return self

    def _go_on(self, reset_num_timesteps: bool) -> None:
        """Restore the counts of a training that continues. ``learn`` calls this first."""
        model: Any = self
        if self._unfinished is not None and reset_num_timesteps:
            warnings.warn(
                "A new training begins here, because of `reset_num_timesteps=True`: to continue the one that was resumed, "
                "call `finish()`.",
                stacklevel=4,
            )
            self._unfinished = None
        if self._unfinished is not None:
            training = self._unfinished.training
            model.training.restore({name: value for name, value in training.items() if name != "total_timesteps"})
            model._total_episodes = training["total_episodes"] or inf

    def _take_up(self, rollout: StepRollout) -> bool:
        """
        :param rollout: the rollout of a training that continues, or of a new one
        :return: whether it has transitions that are still to be learned from
        """
        unfinished, self._unfinished = self._unfinished, None
        if unfinished is None or unfinished.rollout is None:
            return False
        rollout.restore(unfinished.rollout)
        return bool(unfinished.rollout.transitions)
