"""The paper's experiment: every method in every system, many times, and what follows from it."""

from sb3_adaptive_q.study.errors import DesignError, StudyError
from sb3_adaptive_q.study.settings import StudySettings
from sb3_adaptive_q.study.study import run_study

__all__ = ["DesignError", "StudyError", "StudySettings", "run_study"]
