"""A call of ``learn`` that is refused before its first step leaves the model as it was."""

from typing import Any


class Before:
    """
    A model as it is when ``learn`` is called.

    :param model: a tabular algorithm
    """

    def __init__(self, model: Any) -> None:
        self.attributes = dict(vars(model))
        self.record = model.training.record.copy()
        # What a method replaces are whole arrays: so their names are enough, and nothing large is copied
        self.buffers = dict(model.policy._buffers)

    def put_back(self, model: Any) -> None:
        """
        Undo what setting up the training has changed.

        :param model: the same model, which has not made a step since
        """
        was_reset = model._last_obs is not self.attributes["_last_obs"]
        vars(model).clear()
        vars(model).update(self.attributes)
        model.training.record[:] = self.record
        model.policy._buffers.clear()
        model.policy._buffers.update(self.buffers)
        if was_reset:  # its environment begins a new episode, and so must what comes next
            model._last_obs = model._next_actions = model._unfinished = None
