"""Gymnasium wrappers for tabular learners; ``wrappers`` is their public name."""

from sb3_adaptive_q.wrappers.discretize import DiscretizeObservation, edges_of

__all__ = ["DiscretizeObservation", "edges_of"]
