"""What the page of a fit and its text for a paper say: macros of ``words/fit.jinja``."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from bayestissue.reports.pages.page import written

_ASKED = (
    *("answers_page", "posterior", "fit.answers", "fit.checks", "fit.explorer", "fit.figures", "fit.groups"),
    *(
        "fit.level_outcomes",
        "fit.method_agreement",
        "fit.study_answers",
        "fit.trace_predictions",
        "fit.usual",
    ),
)


@cache
def modules() -> dict[str, Any]:
    """What templates ask for numbers, tables and figures, by the modules' names."""
    return {name.rpartition(".")[2]: import_module(f"bayestissue.reports.pages.{name}") for name in _ASKED}


def sentences(macro: str, *values: Any) -> list[str]:
    """The paragraphs that a macro writes of a run."""
    return written("fit", macro, *values, **modules())


def sentence(macro: str, *values: Any) -> str:
    """The same in one."""
    return " ".join(sentences(macro, *values))
