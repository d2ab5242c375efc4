"""Gymnasium wrappers for tabular learners."""

from sb3_adaptive_q.wrappers import DiscretizeObservation

__all__ = ["DiscretizeObservation"]
