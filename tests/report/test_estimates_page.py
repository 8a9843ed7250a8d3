from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from bayestissue.base.errors import InputError
from bayestissue.base.runtime import FORMAT
from bayestissue.reports.figures.browser import library
from bayestissue.reports.pages import write_report
from page_reader import figures


def make_estimates_run(folder, impacts=40):
    number = np.arange(impacts)
    pd.DataFrame(
        {
            "impact": [f"i{n}" for n in number],
            "subject": np.where(number % 2, "a", "<b>"),
            "trial": "t",
            "mass_kg": 0.5 + 0.01 * number,
            "velocity_m_s": 1.5,
            "omega_n_rad_s": 70.0,
            "zeta": 0.2,
            "K_N_per_m": 3000.0 + number,
            "C_N_s_per_m": 25.0,
            "flags": np.where(number % 10 == 3, "theta1 at the boundary; residuals not white", ""),
            "K_se_N_per_m": 12.5,
        }
    ).to_csv(folder / "estimates.csv", index=False)
    about = {
        "program": "bayestissue",
        "format": FORMAT,
        "command": "estimate",
        "kind": "estimates",
        "options": {"window": "peak", "filter": None},
    }
    (folder / "run.json").write_text(json.dumps(about))
    return folder


def page_of(folder):
    return write_report(folder).read_text(encoding="utf-8")


def test_flags_are_counted_and_come_first(tmp_path):
    html = page_of(make_estimates_run(tmp_path))
    assert "4 of 40 flagged" in html
    assert "theta1 at the boundary (4) and residuals not white (4)" in html
    table = html[html.index("Table of the estimates") :]
    assert table.index(">i33<") < table.index(">i0<")
    assert "&lt;b&gt;" in html


def test_of_many_impacts_the_worst_are_shown_and_the_figures_are_painted(tmp_path):
    html = page_of(make_estimates_run(tmp_path, impacts=2000))
    assert "The 300 impacts that need a look first" in html
    charts = [json.loads(text) for text in figures(html)]
    assert [chart["usermeta"]["embedOptions"]["renderer"] for chart in charts] == ["canvas"] * 2
    assert len(html) - len(library()) < 1_000_000


def test_impacts_without_an_estimate_are_counted(tmp_path):
    folder = make_estimates_run(tmp_path)
    table = pd.read_csv(folder / "estimates.csv")
    table.loc[[3, 13], "K_N_per_m"] = np.nan
    table.to_csv(folder / "estimates.csv", index=False)
    assert "2 impacts have no estimate" in page_of(folder)


def test_a_table_without_its_columns_is_refused(tmp_path):
    folder = make_estimates_run(tmp_path)
    pd.read_csv(folder / "estimates.csv").drop(columns=["zeta", "flags"]).to_csv(
        folder / "estimates.csv", index=False
    )
    with pytest.raises(InputError) as caught:
        write_report(folder)
    assert {problem.column for problem in caught.value.problems} == {"zeta", "flags"}


def test_the_trend_with_mass_is_that_of_the_logs(tmp_path):
    folder = make_estimates_run(tmp_path)
    table = pd.read_csv(folder / "estimates.csv")
    table["C_N_s_per_m"] = 30 * table["mass_kg"] ** 0.5
    table.to_csv(folder / "estimates.csv", index=False)
    assert "damping C goes with mass to the power 0.50" in page_of(folder)
    table.assign(mass_kg=0.5).to_csv(folder / "estimates.csv", index=False)
    assert "to the power" not in page_of(folder)
