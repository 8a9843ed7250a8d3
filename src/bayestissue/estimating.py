"""K and C of every impact by itself, as `bayestissue estimate` has them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from bayestissue.dataset import as_dataset
from bayestissue.inference.single import estimates
from bayestissue.inference.single.estimates import Method, Say
from bayestissue.report.estimates_page import page_of
from bayestissue.result import Result
from bayestissue.results.tables import table_of_rows
from bayestissue.runtime import Start, in_float64, run_record
from bayestissue.signal import SignalOptions, displacements
from bayestissue.simulation.centring import centring_table

if TYPE_CHECKING:
    from bayestissue.dataset import Dataset


class Estimates(pd.DataFrame, Result):
    """The table of `estimate`, a row an impact, with the page and the folder that the command makes of it.

    What is made of it by pandas is a plain table.

    Attributes:
        dataset: whose impacts they are.
        method: "impact" or "dds".
        options: where contact is in the recordings, and which part of them was used.
        file: the model file that stated these, if there was one.
        clock: when the work began, and how many seconds it took.
    """

    command = "estimate"
    files = ("estimates.csv", "report.html")
    # As pandas has it: attributes that are no columns.
    _metadata = ["dataset", "method", "options", "file", "clock"]  # noqa: RUF012
    dataset: Dataset
    method: Method
    options: SignalOptions
    file: Path | None
    clock: tuple[datetime, float]

    @cached_property
    def about(self) -> dict[str, Any]:  # type: ignore[override]
        """The content of ``run.json``."""
        data, options = self.dataset, self.options
        return run_record(
            "estimate",
            "estimates",
            *self.clock,
            dataset=data.name,
            method=self.method,
            words=dict(data.words),
            model={"file": self.file.name if self.file else None, "signal": options.model_dump()},
            contact=in_float64(displacements)(data, options).phase.words,
            input_hash=data.input_hash,
        )

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The estimates; by "dds" also what centring does to one tissue; what was left out, if any was."""
        tables: dict[str, pd.DataFrame] = {"estimates": self}
        if self.method == "dds":
            # What this fit makes of one tissue under several masses, so that readers can judge their own.
            tables["centring"] = in_float64(centring_table)()
        if left_out := [problem.as_dict() for problem in self.dataset.left_out]:
            tables["left_out"] = table_of_rows("left_out", left_out).astype({"row": "Int64"})
        return tables

    def page(self) -> str:
        """The HTML of the page."""
        return page_of(self.tables, self.about)

    def as_json(self) -> Any:
        """The rows."""
        return json.loads(self.to_json(orient="records"))


def estimate(
    dataset: Dataset | str | Path,
    *,
    method: Method = "impact",
    options: SignalOptions | None = None,
    say: Say | None = None,
) -> Estimates:
    """K and C of every impact by itself, with intervals and flags.

    Args:
        dataset: as `bayestissue.read_dataset` or `bayestissue.dataset` returns it, or its folder.
        method: "impact" for the posterior of each impact under the likelihood of its own trace, the errors of
            its measuring chain integrated out, and weak priors (those of ``models/impact.toml``, of
            displacements ``models/arma.toml``, on the intercepts and the noise, and one of the damping
            ratio). "dds" for points by the thesis's conditional least squares about the sample mean.
        options: where contact is in the recordings, and which part of them is used.
        say: told the stage, how much of it is done, and its total.

    Returns:
        A table of pandas, which also has ``.page()`` and ``.report(folder)``: see `Estimates`. One row per
        impact with the columns of `estimates.csv`: the ARMA(2,1) coefficients, omega_n, zeta, K and C, and
        ``flags``, what is wrong with the impact, joined by "; "; last ``notes``, what is not
        wrong with the impact but a property of the method or of how it was recorded (see
        `bayestissue.inference.points.notes`). By "impact" K and C are posterior medians, with posterior
        standard deviations and 90 % intervals; omega_n, zeta, phi1 and phi2 are those of an oscillator of
        this K and C; ``pareto_k`` is of the importance weights. Of decelerations theta1 is that oscillator's
        too, the noise is the recorder's, in ``noise_sd_m_s2``, and what the impact came to follows, see
        `OUTCOME_COLUMNS`, the chain's errors in its intervals; of displacements theta1 and ``sigma_a`` are
        posterior medians of the ARMA(2,1), which a position sensor's noise is not: intervals of C may miss.
        K, or C, is empty and flagged where its interval spans more than a factor of 10: the interval is then
        from 0 to an upper bound that holds with 95 %; and where nothing was found, which has no interval
        either. Where that befalls most impacts of a trial its others are flagged too. Of displacements, whose
        sound recordings often come to it, these are notes.

    Raises:
        InputError: the method or the recordings' times or limits ask for what can't be given, such as even
            times.
        ValueError: there is no such method.
    """
    start, data = Start(), as_dataset(dataset)
    table = Estimates(estimates.estimate(data, method=method, options=options, say=say))
    table.dataset, table.method, table.options, table.file = data, method, options or SignalOptions(), None
    table.clock = start.time, start.seconds
    return table
