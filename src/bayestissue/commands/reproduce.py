"""``reproduce``: recompute, audit and re-analyse the published estimates, and write the report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayestissue import resources, results, runtime
from bayestissue.commands.delivery import Call, Seed, delivers
from bayestissue.errors import more
from bayestissue.result import Result

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.commands.console import Shown
    from bayestissue.thesis.reanalysis.analysis import PublishedAnalysis


@dataclass(frozen=True, eq=False, repr=False)
class Reproduction(Result):
    """The published estimates recomputed, audited and analysed anew.

    Attributes:
        about: the content of ``run.json``.
        recomputed: the table ``reproduction.csv``.
        audit: the table ``audit.csv``.
        analysis: all else.
    """

    about: dict[str, Any]
    recomputed: pd.DataFrame
    audit: pd.DataFrame
    analysis: PublishedAnalysis

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """Those of the folder, truth and falsehood as a spreadsheet of any language has them."""
        names = ("summary", "hypotheses", "comparison", "sensitivity", "predictive_checks")
        tables = {"reproduction": self.recomputed, "audit": self.audit}
        tables |= {name: getattr(self.analysis, name) for name in names}
        return {name: _in_words(table) for name, table in tables.items()}

    @property
    def passed(self) -> bool:
        """Whether the sampler did its work."""
        return bool(self.about["verdict"]["passed"])

    def write(self, folder: Path) -> None:
        """Write every file but the page."""
        super().write(folder)
        results.write_tree(self.analysis.tree, folder / "posterior.nc")
        results.write_json(self.analysis.diagnostics, folder / "diagnostics.json")

    def page_in(self, folder: Path) -> str:
        """The HTML of the page, made of the files."""
        from bayestissue.thesis.pages.published_page import published_page

        return published_page(folder, self.about)


def _in_words(table: pd.DataFrame) -> pd.DataFrame:
    booleans = table.select_dtypes(["bool", "boolean"]).astype("string")
    return table.assign(**{str(name): column.str.lower() for name, column in booleans.items()})


def _of_reproduction(made: Reproduction) -> Iterator[Shown]:
    from bayestissue.inference.samplers.diagnostics import warned_codes

    yield from made.about["verdict"]["words"].splitlines()
    yield more(warned_codes(made.analysis.diagnostics))


@delivers(inputs=("model",), shown=_of_reproduction)
def reproduce(
    model: Annotated[str | None, typer.Option(metavar="NAME|FILE")] = None,
    seed: Seed = 0,
    *,
    call: Call,
) -> Reproduction:
    """Recompute, audit and re-analyse the thesis's published estimates, and write the report.

    Args:
        model: Model of the re-analysis; published unless given.
    """
    from bayestissue.dataset.published import read_published
    from bayestissue.hierarchy.specification import read_specification
    from bayestissue.inference.samplers.diagnostics import verdict_in_words
    from bayestissue.thesis.audit import audit_published
    from bayestissue.thesis.reanalysis.analysis import analyse, competing_designs
    from bayestissue.thesis.reanalysis.observations import published_design, published_observations
    from bayestissue.thesis.reproduction import reproduce_published

    start, say = runtime.Start(), call.say
    file = resources.model_file(
        "published" if model is None else model,
        lambda content: content.get("likelihood") == "published-estimates",
    )
    specification = read_specification(file)
    tables = read_published()
    observations = published_observations(tables)
    design = published_design(observations, specification, source=str(file))
    competing = competing_designs(observations, specification, str(file))
    say("recomputing what was published", 0, 1)
    recomputed = reproduce_published(tables)
    say("auditing the publication", 0, 1)
    audit = audit_published(tables)
    analysis = analyse(observations, design, competing, specification, seed, say)
    words = verdict_in_words(analysis.diagnostics)
    about = start.record(
        "reproduce",
        "published",
        model=specification.model_dump(mode="json") | design.resolved(),
        terms_left_out=design.terms_left_out(),
        seed=seed,
        input_hash=runtime.content_hash([*tables.paths, file]),
        verdict={"passed": analysis.diagnostics["passed"], "words": words},
    )
    return Reproduction(about, recomputed, audit, analysis)
