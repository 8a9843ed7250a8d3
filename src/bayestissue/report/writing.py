"""From a finished run to its `report.html`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bayestissue import stopping
from bayestissue.errors import InputError, PartialResultError, Problem
from bayestissue.report.run_folder import read_about
from bayestissue.results import whole_file


def write_report(run_dir: Path) -> Path:
    """Write ``report.html`` into the folder of a finished run, from the files in it alone.

    Returns:
        The path of the page.

    Raises:
        InputError: the folder isn't that of a finished run; what lacks is named.
    """
    run_dir = Path(run_dir)
    about = read_about(run_dir)
    html = _page(run_dir, about)
    path = run_dir / "report.html"
    with whole_file(path) as staging:
        staging.write_text(html, encoding="utf-8")
    return path


def draw_page(run_dir: Path) -> Path:
    """`write_report` of results that stand already, and that a page that fails must not put in doubt.

    Raises:
        PartialResultError: the page could not be drawn; the results are written.
    """
    with after_results(run_dir, f"`bayestissue report {run_dir}` draws the page"):
        return write_report(run_dir)


@contextmanager
def after_results(folder: Path, again: str) -> Iterator[None]:
    """A block that adds to results that stand; ``again`` says how it is repeated if it fails or is stopped.

    Raises:
        PartialResultError: whatever failed in the block, in one line.
    """
    with stopping.explained(lambda: f"the results are in {folder}; {again}"):
        try:
            yield
        except Exception as error:
            what = " ".join(f"{type(error).__name__}: {error}".split())
            raise PartialResultError(
                f"the results are in {folder}, but their page could not be drawn ({_short(what)}); {again}",
                code="page-not-drawn",
            ) from error


def _short(text: str, width: int = 300) -> str:
    return text if len(text) <= width else f"{text[: width - 1]}…"


def _page(run_dir: Path, about: dict) -> str:
    if about["kind"] == "published":
        from bayestissue.report.published.page import published_page

        return published_page(run_dir, about)
    if about["kind"] == "estimates":
        from bayestissue.report.estimates_page import estimates_page

        return estimates_page(run_dir, about)
    if about["kind"] == "fit":
        from bayestissue.report.fit.page import fit_page

        return fit_page(run_dir, about)
    if about["kind"] == "comparison":
        from bayestissue.report.comparison_page import comparison_page

        return comparison_page(run_dir, about)
    if about["kind"] == "causes":
        from bayestissue.report.causes.page import causes_page

        return causes_page(run_dir, about)
    raise InputError(
        Problem(
            str(run_dir / "run.json"),
            column="kind",
            value=about["kind"],
            expected='"published", "estimates", "fit", "comparison" or "causes"',
            remedy="Make the run anew with this version of the program.",
            code="not-a-run",
        )
    )
