"""To go on with a training exactly where a file has it."""

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
    A training that the next call of ``learn`` goes on with.

    :param training: the scalars of the training state
    :param rollout: where its rollout was between two steps; ``None`` where it begins anew
    """

    training: dict[str, Any]
    rollout: RolloutState | None


class Resumable(SavedAsData):
    """Mixin of :class:`sb3_adaptive_q.TabularAlgorithm`: trainings that go on as if nothing had happened."""

    #: What would make it another training
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
        Load a model to go on with the training that it was saved in, by :meth:`finish` or by
        ``learn(model.remaining_timesteps, reset_num_timesteps=False)``. All that is learned from then on is, bit for bit, what
        the training would have learned without an interruption.

        That takes environments whose state is in the file: gymnasium's toy-text and classic control, those with compiled
        dynamics, and all with the methods ``get_state()`` and ``set_state(data)``, in a LeanVecEnv, a CompiledVecEnv or a
        DummyVecEnv. With others training goes on from a new episode, after a warning. Callbacks begin anew: a best score or a
        count of calls is theirs.

        :param path: the file, as in :meth:`load`
        :param env: environments like those of the training, which are put where they were; or an id
        :param device: as in the constructor
        :param custom_objects: what to take in the place of attributes of the file, such as a schedule that was a lambda
        :param print_system_info: whether to print the system that the model was saved on, and this one
        :param kwargs: attributes of the model that shall differ from the file, such as ``tensorboard_log``
        :return: the model
        :raises ValueError: if the file is refused, as in :meth:`load`, the environments are others, or an argument would make
            it another training
        """
        changed = sorted(cls._not_changed & set(kwargs))
        if changed:
            raise ValueError(f"A training is resumed as it was, without another `{changed[0]}`: use `load` to change that.")
        saved = cls._read(path, custom_objects, print_system_info)
        if saved.algorithm != cls.__name__:
            raise ValueError(
                f"The file {saved.name} is of a {saved.algorithm}, not of a {cls.__name__}: resume it with that class."
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
            if (
                rollout is not None and rollout.transitions
            ):  # the actions were taken, and those after them are still to be drawn
                model._next_actions = np.array([transition[1] for transition in rollout.transitions], dtype=np.int64)
        else:
            model._last_obs = model._next_actions = None
            if model.num_timesteps > 0:
                self._seed_environments_anew()
        if running is not None and "reason" in running:
            warnings.warn(f"Training goes on from a new episode, because {running['reason']}.", stacklevel=3)
        self._unfinished = None if rollout is None else Unfinished(saved.training, rollout)

    @property
    def remaining_timesteps(self) -> int:
        """The environment steps that the training begun last has still to take; 0 where it is over."""
        return max(self._total_timesteps - self.num_timesteps, 0)

    def finish(
        self: SelfResumable, callback: MaybeCallback = None, tb_log_name: str | None = None, progress_bar: bool = False
    ) -> SelfResumable:
        """
        Go on to the end of the training that was begun last: after :meth:`resume`, an interrupt or an error.

        Progress, and all that depends on it, goes on where it was; ``log_interval`` is that of the training.

        :param callback: as in ``learn``
        :param tb_log_name: as in ``learn``
        :param progress_bar: as in ``learn``
        :return: the model
        :raises ValueError: as in ``learn``
        """
        model: Any = self
        if self._unfinished is None:
            self._unfinished = Unfinished(model.training.as_data(), None)
        model.learn(self.remaining_timesteps, callback, self._log_interval, tb_log_name, False, progress_bar)
        return self

    def _go_on(self, reset_num_timesteps: bool) -> None:
        """At the beginning of ``learn``: let a training that goes on have the numbers that it had."""
        model: Any = self
        if self._unfinished is not None and reset_num_timesteps:
            warnings.warn(
                "A new training begins here, because of `reset_num_timesteps=True`: to go on with the one that was resumed, "
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
        :param rollout: the rollout of a training that goes on, or of a new one
        :return: whether it has transitions that are still to be learned from
        """
        unfinished, self._unfinished = self._unfinished, None
        if unfinished is None or unfinished.rollout is None:
            return False
        rollout.restore(unfinished.rollout)
        return bool(unfinished.rollout.transitions)
