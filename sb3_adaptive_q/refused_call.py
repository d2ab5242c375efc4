"""A call of ``learn`` that is refused before its first step leaves the model as it was."""

import warnings
from typing import Any

import psutil

from sb3_adaptive_q.policies import MEMORY, SURELY_FREE


class Before:
    """
    A model as it is when ``learn`` is called.

    :param model: a tabular algorithm
    """

    def __init__(self, model: Any) -> None:
        #: Whether callbacks have begun, which may have moved the environment
        self.callbacks_began = False
        self.attributes = dict(vars(model))
        self.record = model.training.record.copy()
        # What a method replaces are whole arrays, so nothing is copied. But there must be room for the new ones beside them
        size = sum(buffer.nbytes for name, buffer in model.policy.named_buffers() if name.startswith(MEMORY))
        has_room = size < SURELY_FREE or size < psutil.virtual_memory().available / 4
        self.buffers = dict(model.policy._buffers) if has_room else None

    def forget(self) -> None:
        """Let the training begin: what it learns is not taken back."""
        self.attributes, self.buffers = {}, None

    def put_back(self, model: Any) -> None:
        """
        After an error, undo what setting up the training has changed: counts, μ, method and memory. Memory of which there is
        no room for two starts anew. If the training had begun, all of that stays. Where the environment was reset, or may have
        moved on without the agent, a new episode comes next.

        :param model: the same model
        """
        if not self.attributes:
            model._last_obs = None
            return
        begins_anew = self.callbacks_began or model._last_obs is not self.attributes["_last_obs"]
        vars(model).update(self.attributes)
        for name in vars(model).keys() - self.attributes.keys():
            delattr(model, name)
        model.training.record[:] = self.record
        if self.buffers is not None:
            model.policy._buffers.update(self.buffers)
            for name in model.policy._buffers.keys() - self.buffers.keys():
                del model.policy._buffers[name]
        if begins_anew:
            if model._unfinished is not None and model._unfinished.rollout is not None:
                warnings.warn(
                    "The training that was resumed would now continue with a new episode: `resume` the file again for the "
                    "exact one.",
                    stacklevel=3,
                )
            model._last_obs = model._next_actions = model._unfinished = None
