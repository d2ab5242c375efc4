"""The step sizes of the literature by name, and the parameters that a user gives them."""

import difflib
from collections.abc import Mapping
from typing import Any

from sb3_adaptive_q.step_sizes import adaptive, counts, gradient
from sb3_adaptive_q.step_sizes.step import StepSize

#: All step sizes by name. The order is that of their worth to a user: what is best known and most robust stands first
STEP_SIZES: dict[str, StepSize] = {
    each.name: each
    for each in (
        counts.CONSTANT,
        counts.POLYNOMIAL,
        counts.HARMONIC,
        counts.UNBIASED_CONSTANT,
        adaptive.BAKF,
        gradient.AUTOSTEP,
        adaptive.DELTA_BAR_DELTA,
        adaptive.TRIGG,
        adaptive.MCCLAIN,
        adaptive.KESTEN,
        counts.HORIZON,
        counts.RESCALED_LINEAR,
        gradient.IDBD,
        counts.SEARCH_THEN_CONVERGE,
        gradient.BENVENISTE,
        gradient.SWIFT_TD,
        gradient.K1,
        adaptive.OBGD,
        adaptive.RMSPROP,
        adaptive.ADAGRAD,
    )
}


def find_step_size(name: object) -> StepSize:
    """
    :param name: the name of a step size
    :return: the step size
    :raises ValueError: if there is none of this name. The message offers the nearest names
    """
    if isinstance(name, str) and name in STEP_SIZES:
        return STEP_SIZES[name]
    nearest = difflib.get_close_matches(name.lower(), STEP_SIZES, cutoff=0.5) if isinstance(name, str) else []
    advice = f"Did you mean {' or '.join(map(repr, nearest))}?" if nearest else f"The names are {', '.join(STEP_SIZES)}."
    raise ValueError(f"There is no step size {name!r}. {advice}")


def resolve_parameters(name: str, given: Mapping[str, Any]) -> dict[str, float]:
    """
    Fill in the defaults, and check what was given.

    :param name: the name of a step size
    :param given: values of some or all of its parameters, by name
    :return: the values of all its parameters by name, in the order of its function
    :raises ValueError: if there is no such step size, it has no such parameter, a value is not a number of the
        parameter's range, or ``lower`` is above ``upper``
    """
    parameters = find_step_size(name).parameters
    unknown = [key for key in given if key not in parameters]
    if unknown:
        known = f"has the parameters {', '.join(parameters)}" if parameters else "has no parameters"
        raise ValueError(f"Step size {name!r} {known}, but got {', '.join(map(repr, unknown))}.")
    try:
        resolved = {key: parameter.check(key, given.get(key, parameter.default)) for key, parameter in parameters.items()}
    except ValueError as error:
        raise ValueError(f"Step size {name!r}: {error}") from None
    if "lower" in resolved and resolved["lower"] > resolved["upper"]:
        bounds = f"lower={resolved['lower']} and upper={resolved['upper']}"
        raise ValueError(f"Step size {name!r}: `lower` must not be above `upper`, but got {bounds}.")
    return resolved
