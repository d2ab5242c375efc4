"""Makes tutorial.ipynb from tutorial.py, whose cells begin with ``# %%``. Needs nbformat."""

import re
from pathlib import Path

import nbformat
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

_HERE = Path(__file__).parent
_TEXT = " [markdown]"


def make_notebook(source: str) -> nbformat.NotebookNode:
    """
    :param source: Python in which ``# %%`` begins a cell of code, and ``# %% [markdown]`` one of text in comments
    :return: the notebook, without outputs
    """
    cells = []
    for i, part in enumerate(re.split(r"^# %%", source, flags=re.MULTILINE)[1:]):
        kind, _, body = part.partition("\n")
        if kind == _TEXT:
            body = re.sub(r"^# ?", "", body, flags=re.MULTILINE)
        make_cell = new_markdown_cell if kind == _TEXT else new_code_cell
        # A number of its own for each cell, always the same, so that a change shows as what it is
        cells.append(make_cell(body.strip("\n"), id=f"cell-{i}"))
    metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return new_notebook(cells=cells, metadata=metadata)


if __name__ == "__main__":
    notebook = make_notebook((_HERE / "tutorial.py").read_text(encoding="utf-8"))
    nbformat.validate(notebook)
    nbformat.write(notebook, _HERE / "tutorial.ipynb")
