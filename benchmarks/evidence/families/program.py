"""What the program is held against from outside and by laws, and where it runs."""

from __future__ import annotations

import pandas as pd

from evidence.texts import Figure, Named, block, family, names, percent, power_of_ten, raw, table

# Of itself a number that is printed to ten digits or more may be off by less than this.
_EXACT = 1e-9
# No power of ten from here on.
_LARGE = 0.05


@family
def published() -> Named:
    rows = raw("published")
    size = rows["difference"].abs()
    share = size / rows["allowed"]
    groups = rows.assign(size=size, share=share).groupby("unit", sort=False)
    shown = pd.DataFrame(
        {
            "numbers": groups.size(),
            "largest difference": groups["size"].max().map(_or_none),
            "of what is allowed": groups["share"].max().map(lambda value: percent(value, 0)),
        }
    )
    yield "table", block(table(shown.rename_axis("published").reset_index()), "published")
    within, exact = int((share <= 1).sum()), rows["allowed"] < _EXACT * rows["published"].abs()
    apart = power_of_ten((size / rows["published"].abs())[exact].max())
    text = (
        f"{within} of {len(rows)} numbers of {rows['unit'].nunique()} sources are the published ones, to "
        f"half a unit of the last digit printed or to rounding; those printed to ten digits or more "
        f"differ by at most {apart} of themselves"
    )
    yield "sentence", Figure(text, names("published"))
    yield "short", Figure(f"{within} of {len(rows)} numbers are the published ones", names("published"))


@family
def laws() -> Named:
    rows = raw("laws")
    failed = int((rows["state"] != "passed").sum())
    # A test without drawn cases is one case.
    cases = int(rows["examples_passed"].fillna(1).sum() + rows["examples_failed"].fillna(0).sum())
    text = f"{len(rows)} tests of laws had {failed} failures in {cases} cases"
    yield "sentence", Figure(text, names("laws"))


@family
def selftest() -> Named:
    row = raw("selftest").iloc[0]
    passed = f"{row['checks'] - row['failed']:.0f} of {row['checks']:.0f} checks passed in {row['s']:.0f} s"
    text = f"{passed} with nothing compiled yet ({row['cpu_s']:.0f} s of the processor)"
    yield "sentence", Figure(text, names("selftest"))
    yield "short", Figure(passed, names("selftest"))


@family
def certificate() -> Named:
    rows = raw("certificate").set_index("quantity")
    held = " and ".join(
        f"{q} of {percent(rows.loc[name, 'held'])} ± {percent(rows.loc[name, 'held_se'])}"
        for q, name in ((q, f"{q} of drawn impacts") for q in "KC")
    )
    refits, minutes = rows["refits"].iloc[0], rows["seconds"].iloc[0] / 60
    text = (
        f"drawn anew from its own posterior and fitted {refits} times, in {minutes:.0f} min, 90 % intervals "
        f"held {held} of the drawn impacts; the ranks of {int((rows['passed'] == 0).sum())} of {len(rows)} "
        "quantities are not uniform"
    )
    yield "sentence", Figure(text, names("certificate"))


def _or_none(value: float) -> str:
    """A power of ten, 0, or a number of its own size."""
    return f"{value:.1f}" if value >= _LARGE else power_of_ten(value) if value else "0"
