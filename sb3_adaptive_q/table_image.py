"""A callback that shows in TensorBoard what the table looks like while it is learned."""

from collections.abc import Sequence
from typing import Any, ClassVar

from stable_baselines3.common.callbacks import EveryNTimesteps
from stable_baselines3.common.logger import Figure as LoggedFigure

from sb3_adaptive_q.checks import whole_number
from sb3_adaptive_q.hyperparameters import tensorboard_outputs

_DOTS_PER_INCH = 100


class TableImageCallback(EveryNTimesteps):
    """
    Puts pictures of the table into TensorBoard's Images, and the distribution of its entries into Histograms: when training
    starts, at every multiple of ``every`` timesteps, and when training ends. The tags are ``table/value`` and so on, and
    ``table/q_distribution``. Other outputs of the logger get nothing.

    It is one of SB3's ``EveryNTimesteps``, at whose timesteps a compiled rollout stops: it draws at the same timesteps on an
    ordinary and on a compiled environment.

    :param every: timesteps between two pictures
    :param what: what to draw, each as in :func:`sb3_adaptive_q.plots.plot_policy`
    :param histogram: whether to add the distribution of the table's entries
    :param choice: further arguments of :func:`sb3_adaptive_q.plots.plot_policy`: ``env``, ``passenger``, ``destination``,
        ``dimensions``, ``at`` and ``limits``
    :raises ValueError: if ``every`` is below 1; when training starts, if the logger does not write to TensorBoard, or there
        is nothing to draw
    :raises ModuleNotFoundError: if what the pictures need is not installed
    """

    #: The compiled path calls this callback at the end of a rollout, and it needs no more
    knows_rollouts: ClassVar[bool] = True

    def __init__(self, every: int = 100_000, what: Sequence[str] = ("value",), histogram: bool = True, **choice: Any) -> None:
        # Imported here, because pictures need packages that learning does without
        from sb3_adaptive_q import plots  # noqa: F401

        every = whole_number(1).apply("every", every)
        if isinstance(what, str):
            raise ValueError(f"`what` must be a tuple, such as ({what!r},), but got {what!r}.")
        super().__init__(every, callback=None)  # type: ignore[arg-type]
        self.what = what
        self.histogram = histogram
        self.choice = choice

    def _on_training_start(self) -> None:
        outputs = tensorboard_outputs(self.model)
        if not outputs:
            raise ValueError(
                "TableImageCallback writes to TensorBoard: please give the model a folder as `tensorboard_log`, or a logger "
                "with the format 'tensorboard'."
            )
        self.output = outputs[0]
        self.last_time_trigger = self.num_timesteps - self.num_timesteps % self.n_steps
        self._write()

    def _on_event(self) -> bool:
        self._write()
        return True

    def _on_training_end(self) -> None:
        if self.num_timesteps > self.last_written:
            self._write()

    def _write(self) -> None:
        values: dict[str, Any] = {f"table/{what.removeprefix('memory:')}": self._draw(what) for what in self.what}
        if self.histogram:
            values["table/q_distribution"] = self.model.q_table  # type: ignore[attr-defined]
        self.output.write(values, dict.fromkeys(values, ()), self.num_timesteps)
        self.last_written = self.num_timesteps

    def _draw(self, what: str) -> LoggedFigure:
        from sb3_adaptive_q.plots.policy import draw_figure

        return LoggedFigure(draw_figure(self.model, _DOTS_PER_INCH, what=what, **self.choice), close=True)
