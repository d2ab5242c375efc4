"""Many runs: one runner and one storage, of which the paper's study and the league are two designs."""

from sb3_adaptive_q.experiments.design import Choice, Design
from sb3_adaptive_q.experiments.errors import DesignError, ExperimentError
from sb3_adaptive_q.experiments.runner import Execution, run_missing
from sb3_adaptive_q.experiments.storage import ResultFolder

__all__ = ["Choice", "Design", "DesignError", "Execution", "ExperimentError", "ResultFolder", "run_missing"]
