"""Pictures of what was learned, and the table as a pandas DataFrame. The extra ``plots`` has what they need."""

from importlib.util import find_spec

_MISSING = [name for name in ("matplotlib", "pandas", "scipy") if find_spec(name) is None]
if _MISSING:
    raise ModuleNotFoundError(
        f"sb3_adaptive_q.plots needs {' and '.join(_MISSING)}: please install them with pip install 'sb3-adaptive-q[plots]'.",
        name=_MISSING[0],
    )

from sb3_adaptive_q.plots.animation import animate  # noqa: E402
from sb3_adaptive_q.plots.frame import to_frame  # noqa: E402
from sb3_adaptive_q.plots.learning_curves import plot_learning_curves  # noqa: E402
from sb3_adaptive_q.plots.policy import plot_policy  # noqa: E402
from sb3_adaptive_q.plots.style import STYLE  # noqa: E402

__all__ = ["STYLE", "animate", "plot_learning_curves", "plot_policy", "to_frame"]
