"""Numbers that others published, and the same numbers by the program.

    .venv/bin/python benchmarks/published_numbers.py

Those of the self-test need no data file. The three series of the method's own book are read where they lie
beside the project (`shared/series`), and left out where they do not. A row has a number, the program's, and
how far apart they may be: half a unit of the last digit printed, or rounding errors.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from evidence import measure

from bayestissue.model.likelihood.arma21 import arma21_log_likelihood
from bayestissue.studies.selftest.published_numbers import PUBLISHED

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests" / "likelihood"))
from test_published_series import PRINTED, SERIES, path_of, series  # noqa: E402

BOOK = "Pandit and Wu's series: "


def rows_of(unit: str) -> Iterator[Mapping[str, object]]:
    """Every number of a source."""
    if unit.startswith(BOOK):
        name = unit.removeprefix(BOOK)
        published = SERIES[name]
        *coefficients, variance = published.parameters
        found = arma21_log_likelihood(series(name), *coefficients, variance**0.5, start="stationary")
        yield row("log likelihood", published.log_likelihood, float(found), PRINTED)
        return
    source = PUBLISHED[unit]
    computed = source.computed()
    for name, value in source.numbers.items():
        yield row(name, value, computed[name], source.tolerance_of(name))


def row(number: str, published: float, computed: float, allowed: float) -> Mapping[str, object]:
    """A number beside the program's."""
    return {
        "number": number,
        "published": published,
        "difference": computed - published,
        "allowed": allowed,
    }


def main() -> None:
    here = [f"{BOOK}{name}" for name in SERIES if path_of(name).is_file()]
    measure("published", [*PUBLISHED, *here], rows_of)


if __name__ == "__main__":
    main()
