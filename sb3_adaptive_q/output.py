"""Text for terminals and files: errors with their place, and signs that not every terminal can show."""

import codecs
import sys
import traceback

#: What is written where a terminal cannot show a sign
_SPELLED = {
    "α": "alpha",
    "β": "beta",
    "γ": "gamma",
    "δ": "delta",
    "ε": "epsilon",
    "η": "eta",
    "θ": "theta",
    "κ": "kappa",
    "λ": "lambda",
    "μ": "mu",
    "ν": "nu",
    "σ": "sigma",
    "τ": "tau",
    "φ": "phi",
    "ψ": "psi",
    "ω": "omega",
    "₀": "_0",
    "²": "^2",
    "√": "sqrt ",
    "←": "<-",
    "≤": "<=",
    "≥": ">=",
    "é": "e",
}

#: The name of the way in which signs are written that an encoding does not have
_SPELL_OUT = "sb3_adaptive_q.spell_out"


def spell(text: str, encoding: str) -> str:
    """
    :param text: a text
    :param encoding: of the file that it is for
    :return: the text, with the signs spelled out that the encoding does not have
    """
    return text.encode(encoding, errors=_SPELL_OUT).decode(encoding)


def spell_out_what_cannot_be_written() -> None:
    """Let output that is redirected to a file of another encoding go on at a sign such as μ, instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=_SPELL_OUT)


def locate(error: BaseException) -> str:
    """
    :param error: that was raised by code outside of this package's control
    :return: what it is, and the line that it comes from
    """
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({place.filename}, line {place.lineno})"


def _spell_out(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    signs = error.object[error.start : error.end]
    return "".join(_SPELLED.get(sign, "?") for sign in signs), error.end


codecs.register_error(_SPELL_OUT, _spell_out)
