"""What the page of a fit and its text for a paper say: macros of ``words/fit.jinja``."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from bayestissue.reports.pages import answers_page, posterior
from bayestissue.reports.pages.page import written

_MODULES = (
    *("answers", "checks", "figures", "groups", "level_outcomes"),
    *("method_agreement", "study_answers", "trace_predictions", "usual"),
)


@cache
def modules() -> dict[str, Any]:
    """What templates ask for numbers, tables and figures, by the modules' names."""
    of_fits = {name: import_module(f"{__package__}.{name}") for name in _MODULES}
    return {**of_fits, "answers_page": answers_page, "posterior": posterior}


def sentences(macro: str, *values: Any) -> list[str]:
    """The paragraphs that a macro writes of a run."""
    return written("fit", macro, *values, **modules())


def sentence(macro: str, *values: Any) -> str:
    """The same in one."""
    return " ".join(sentences(macro, *values))
