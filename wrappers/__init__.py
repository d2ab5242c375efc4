"""Gymnasium wrappers for tabular learners."""

from wrappers.discretize import DiscretizeObservation

__all__ = ["DiscretizeObservation"]
