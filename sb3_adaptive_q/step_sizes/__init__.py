"""
The step sizes of the literature, and the rules of the paper: plain functions of numbers, and plain data about them.

To add one, write its function and its :class:`StepSize` in one of the modules here, and name it in ``registry.py``.
"""

from sb3_adaptive_q.step_sizes.listing import Description, describe
from sb3_adaptive_q.step_sizes.registry import STEP_SIZES, find_step_size, resolve_parameters
from sb3_adaptive_q.step_sizes.step import Memory, Parameter, Step, StepSize, clip_size

__all__ = [
    "STEP_SIZES",
    "Description",
    "Memory",
    "Parameter",
    "Step",
    "StepSize",
    "clip_size",
    "describe",
    "find_step_size",
    "resolve_parameters",
]
