"""Deliberate faults of the program, each of which the reference results must show."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from bayestissue.inference import fit as inference
from bayestissue.inference.chain import moves
from bayestissue.reports.pages import wording
from bayestissue.studies import fitting

sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))
from evidence import references

pytestmark = pytest.mark.long


@pytest.fixture
def differing(monkeypatch: pytest.MonkeyPatch) -> Callable[[], str]:
    """What the first campaign of the set "impact" has that is not as it was accepted."""
    first = references.accepted().query("`set` == 'impact'")
    first = first[first["quantity"].str.startswith(("1 ", "page"))]
    monkeypatch.setattr(references, "accepted", lambda: first)
    return lambda: references.differing("impact", references.fits("impact", campaigns=1))


def changed_by(monkeypatch: pytest.MonkeyPatch, module: object, name: str, change: Callable) -> None:
    """Let what a function of a module gives be changed."""
    function = getattr(module, name)
    monkeypatch.setattr(module, name, lambda *args, **named: change(function(*args, **named)))


def test_without_a_fault_nothing_differs(differing):
    assert not differing()


def test_K_off_by_1_percent(differing, monkeypatch):
    prepare = fitting.prepare

    def heavier(dataset, *args, **named):
        impacts = dataset.impacts.assign(mass_kg=1.01 * dataset.impacts["mass_kg"])
        return prepare(replace(dataset, impacts=impacts), *args, **named)

    monkeypatch.setattr(fitting, "prepare", heavier)
    assert "results differ" in differing()


def test_intervals_10_percent_too_narrow(differing, monkeypatch):
    def narrowed(summary):
        middle = summary[["median"]].to_numpy()
        ends = middle + 0.9 * (summary[["eti90_low", "eti90_high"]] - middle)
        return summary.assign(**ends.to_dict("series"))

    changed_by(monkeypatch, inference, "summary_table", narrowed)
    assert "results differ" in differing()


def test_an_impact_s_part_of_a_move_accepted_by_the_wrong_ratio(differing, monkeypatch):
    decided = moves.decided

    def without(target, state, proposal, uniform):
        # As if the site were the trace.
        return decided(target, state, proposal._replace(log_ratio=0 * proposal.log_ratio), uniform)

    monkeypatch.setattr(moves, "decided", without)
    assert "results differ" in differing()


def test_a_unit_wrong_in_one_page(differing, monkeypatch):
    monkeypatch.setitem(wording.UNITS, "K", "N/cm")
    assert "page" in differing()
