"""The formulas of the methods, which are one line of text for the command line, as LaTeX for the pages."""

import re

_TOKEN = re.compile(
    r"\s*(?P<function>[A-Za-z]+(?=\())|\s*(?P<word>[A-Za-z_]{2,})|\s*(?P<symbol>[A-Za-zα-ω]\d?[₀'²]*|\d+)|\s*(?P<sign>\S)"
)
_SIGNS = {"←": r"\leftarrow", "≤": r"\leq", "≥": r"\geq"}
_OPERATORS = "+-=←≤≥<>,;:"
_FUNCTIONS = ("exp", "min", "max")


def to_latex(formula: str, names: tuple[str, ...] = ()) -> str:
    """
    :param formula: one or several equations as the registry has them, such as ``μ = α₀ a / (a + n - 1)``
    :param names: the names of several letters that are numbers, not words
    :return: LaTeX for a displayed formula, one equation a line; ``x / y`` becomes a fraction
    """
    equations: list[str] = []
    for sentence in formula.split("; "):
        for i, part in enumerate(_split(sentence)):
            latex = _Reader(part, names).expression("")
            if i == 0 or re.search("[=←]", part):
                equations.append(latex)
            else:
                equations[-1] += rf",\ {latex}"
    return r"\begin{gathered}" + r" \\ ".join(equations) + r"\end{gathered}"


def _split(formula: str) -> list[str]:
    """The parts between the commas that stand outside of brackets."""
    parts, depth = [""], 0
    for letter in formula:
        depth += (letter == "(") - (letter == ")")
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return [part.strip() for part in parts]


class _Reader:
    """Reads an equation from left to right."""

    def __init__(self, text: str, names: tuple[str, ...]) -> None:
        self.tokens = [(match.lastgroup or "", match[match.lastgroup or 0]) for match in _TOKEN.finditer(text)]
        self.names = names

    def expression(self, end: str) -> str:
        """Everything up to a closing sign, which is taken too."""
        done: list[str] = []
        factors: list[str] = []
        while self.tokens:
            kind, text = self.tokens.pop(0)
            if text == end:
                break
            if text == "/":
                numerator = " ".join(_bare(factor, len(factors)) for factor in factors)
                factors = [rf"\frac{{{numerator}}}{{{_bare(self.factor(*self.tokens.pop(0)), 1)}}}"]
            elif text in _OPERATORS or (kind == "word" and self.is_text(text)):
                done += [*factors, self.operator(kind, text)]
                factors = []
            else:
                factors.append(self.factor(kind, text))
        return " ".join([*done, *factors])

    def is_text(self, word: str) -> bool:
        return word != "ln" and word not in self.names

    def operator(self, kind: str, text: str) -> str:
        if kind != "word":
            return _SIGNS.get(text, text)
        words = [text]
        while self.tokens and self.tokens[0][0] == "word" and self.is_text(self.tokens[0][1]):
            words.append(self.tokens.pop(0)[1])
        return rf"\text{{ {' '.join(words)} }}"

    def factor(self, kind: str, text: str) -> str:
        if text == "√":
            return rf"\sqrt{{{_bare(self.factor(*self.tokens.pop(0)), 1)}}}"
        if text == "|":
            return rf"|{self.expression('|')}|"
        if text == "(":
            latex = _in_brackets(self.expression(")"))
        elif kind == "function":
            self.tokens.pop(0)
            name = rf"\{text}" if text in _FUNCTIONS else text if len(text) == 1 else rf"\operatorname{{{text}}}"
            return name + _in_brackets(self.expression(")"))
        else:
            latex = self.symbol(text)
        if self.tokens and self.tokens[0][1] == "²":
            self.tokens.pop(0)
            latex += "^2"
        if self.tokens and self.tokens[0][1] == "^":
            self.tokens.pop(0)
            latex += rf"^{{{self.factor(*self.tokens.pop(0))}}}"
        return latex

    def symbol(self, text: str) -> str:
        if text == "ln":
            return r"\ln"
        if (len(text) > 1 and text.isalpha()) or "_" in text:
            return rf"\mathit{{{text}}}\,".replace("_", r"\_")
        return re.sub(r"(?<=[^\d])(\d)", r"_\1", text).replace("₀", "_0").replace("²", "^2")


def _in_brackets(latex: str) -> str:
    """In brackets, which grow around a fraction."""
    return rf"\left({latex}\right)" if r"\frac" in latex else f"({latex})"


def _bare(latex: str, n_factors: int) -> str:
    """A factor of a fraction without the brackets that the fraction makes needless."""
    return latex[1:-1] if n_factors == 1 and _is_bracketed(latex) else latex


def _is_bracketed(latex: str) -> bool:
    depth = 0
    for i, letter in enumerate(latex):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return letter == ")" and i == len(latex) - 1
    return False
