"""From a finished run to its `report.html`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from bayestissue import stopping
from bayestissue.errors import InputError, PartialResultError
from bayestissue.outline import short
from bayestissue.report.run_folder import read_about, wrong_in
from bayestissue.results import whole_file


def write_report(run_dir: Path) -> Path:
    """Write ``report.html`` into the folder of a finished run, from the files in it alone.

    Returns:
        The path of the page.

    Raises:
        InputError: the folder isn't that of a finished run; what lacks is named.
    """
    run_dir = Path(run_dir)
    record = read_about(run_dir)
    html = _page(run_dir, record)
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
            what = short(" ".join(f"{type(error).__name__}: {error}".split()), 300)
            raise PartialResultError(
                f"the results are in {folder}, but their page could not be drawn ({what}); {again}",
                code="page-not-drawn",
            ) from error


# Of each kind of run: the module with its page, and the function that makes it.
_PAGES = {
    "published": ("thesis.pages.published_page", "published_page"),
    "estimates": ("report.estimates_page", "estimates_page"),
    "fit": ("report.fit.page", "fit_page"),
    "comparison": ("report.comparison.page", "comparison_page"),
    "causes": ("thesis.pages.causes_page", "causes_page"),
}


def _page(run_dir: Path, record: dict[str, Any]) -> str:
    kind = record["kind"]
    if kind not in _PAGES:
        kinds = " or ".join(f'"{known}"' for known in _PAGES)
        remedy = "Make the run anew with this version of the program."
        raise InputError(
            wrong_in(run_dir / "run.json", kinds, remedy, code="not-a-run", column="kind", value=kind)
        )
    module, name = _PAGES[kind]
    page: str = getattr(import_module(f"bayestissue.{module}"), name)(run_dir, record)
    return page
