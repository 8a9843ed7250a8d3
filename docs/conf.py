"""How Sphinx builds the manual: `make docs`. Nothing is fetched, neither to build it nor to read it."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "_extensions"), str(HERE.parent / "src"), str(HERE.parent / "benchmarks")]

project = "bayestissue"
author = "the bayestissue developers"
release = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]

extensions = ["myst_nb", "mathml", "from_program", "long_lines"]
exclude_patterns = ["_build", "_extensions"]
# A word in single backquotes is code where the program's own docstrings have it.
default_role = "code"
# Two hyphens are an option's.
smartquotes = False

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
# Notebooks are shown with the outputs that they were kept with.
nb_execution_mode = "off"
nb_ipywidgets_js = {}

python_maximum_signature_line_length = 80
# An error that is raised under a name that is not public.
nitpick_ignore = [("py:exc", "PartialResultError")]

html_theme = "furo"
html_title = "bayestissue"
html_static_path = ["_static"]
html_css_files = ["manual.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_copyright = False
html_last_updated_fmt = None
pygments_style = "tango"
highlight_language = "text"
