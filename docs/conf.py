"""How Sphinx builds the documentation: ``make docs``."""

import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]

import catalogue  # noqa: E402
import environment_list  # noqa: E402

import sb3_adaptive_q  # noqa: E402

project = "sb3_adaptive_q"
author = "The sb3_adaptive_q contributors"
copyright = author
release = sb3_adaptive_q.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx_copybutton"]
exclude_patterns = ["generated/*", "algorithms/_*"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = f"{project} {release}"
html_show_sphinx = False

# The class's notebook is stored without outputs: they are made here, and kept for the next build
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_cache_path = str(DOCS.parent / "build" / "notebooks")

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
# References into other projects' documentation are not followed: building needs no network
nitpick_ignore_regex = [
    (r"py:.*", r"(?!sb3_adaptive_q|wrappers).*"),
    (r"py:class", r"sb3_adaptive_q\..*\.(Self\w+|\w+T)"),  # type variables
]


def setup(app: Any) -> None:
    """
    Let the lists of step sizes and environments be written before the pages are read.

    :param app: Sphinx
    """
    for each in (catalogue, environment_list):
        app.connect("builder-inited", lambda _app, each=each: each.write(DOCS / "generated"))
