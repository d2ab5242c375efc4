"""A model learns once at a time."""

import threading
import weakref
from typing import Any, ClassVar


class Training:
    """One call of ``learn``."""


class OneAtATime:
    """Mixin of :class:`sb3_adaptive_q.TabularAlgorithm`: it refuses to learn while it learns."""

    #: Held while SB3 looks for a free folder for the log and makes it, as models in other threads may do. SB3 also resets the
    #: environment then, which may let another model learn in the same thread
    setting_up: ClassVar[Any] = threading.RLock()
    _learning: "weakref.ref[Training] | None"

    def _claim(self) -> Training:
        """
        Mark the model as learning, by a weak reference to what the caller holds: even where an interrupt keeps the caller from
        taking the mark off, it ends with the call.
        """
        training = Training()
        with self.setting_up:
            if self._learning is not None and self._learning() is not None:
                raise RuntimeError(
                    "This model is learning already: a callback or another thread cannot let it learn once more."
                )
            self._learning = weakref.ref(training)
        return training
