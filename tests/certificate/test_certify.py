"""A small campaign certified: calibrated as it is, not where the sampler is spoilt; parts are kept."""

from __future__ import annotations

import json
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bayestissue as bt
from bayestissue.base.results.tables import read_table
from bayestissue.studies.certificate import certificate as certifying
from bayestissue.studies.certificate.augmented import Truth, new_impacts, truths
from bayestissue.studies.selftest.fits import campaign
from command_line import bayestissue

pytestmark = pytest.mark.slow
REFITS = 10


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("certified")
    campaign(folder / "drops")
    fitted = bt.fit(
        folder / "drops", {"like": "impact", "sampler": {"chains": 2, "draws": 300, "effective": 100}}
    )
    fitted.report(folder / "run")
    return folder / "run"


@pytest.fixture(scope="module")
def certificate(run: Path) -> Path:
    ended = bayestissue("certify", run, "--refits", REFITS)
    assert ended.status in (0, 3), ended.err
    return run.with_name("run-certificate")


def test_the_folder_has_all_that_was_found(run: Path, certificate: Path) -> None:
    record = json.loads((certificate / "run.json").read_text(encoding="utf-8"))
    calibration = read_table(certificate, "calibration")
    assert record["refits"] == REFITS
    diagnosed = json.loads((run / "diagnostics.json").read_text(encoding="utf-8"))["passed"]
    assert record["verdict"]["passed"] == (diagnosed and bool(calibration["passed"].all()))
    impacts = calibration.set_index("quantity").loc[["K of drawn impacts", "C of drawn impacts"]]
    assert (impacts["elements"] == 12).all()
    # The chain is exact: five standard errors, of which a correct program has two in a million.
    assert (np.abs(impacts["held"] - 0.9) < 5 * impacts["held_se"]).all()
    assert (np.abs(impacts["shift"]) < 5 * impacts["shift_se"]).all()
    lists = read_table(certificate, "checklists")
    assert set(lists["guideline"]) == {"BARG", "GRRAS"}
    assert ((lists["answered"] == 1) | (lists["question"] != "")).all()
    page = (certificate / "report.html").read_text(encoding="utf-8")
    assert record["verdict"]["words"] in unescape(page)
    assert "Kottner" in (certificate / "certificate.md").read_text(encoding="utf-8")


def test_finished_refits_are_read_and_change_nothing(run: Path, certificate: Path, tmp_path: Path) -> None:
    job = certifying.CertificateJob.of_run(run, refits=3)
    ranks = read_table(certificate, "ranks")
    rows = ranks[ranks["refit"] <= 2]
    for number, of_refit in rows.groupby("refit"):
        by = {str(name): part["rank"].tolist() for name, part in of_refit.groupby("quantity", sort=False)}
        one = {"ranks": by, "passed": True}
        (tmp_path / f"refit-{int(number) - 1:04d}.json").write_text(json.dumps(one), encoding="utf-8")
    made = job.refitted(lambda *_: None, tmp_path)
    third = ranks[ranks["refit"] == 3]
    assert made[0]["ranks"] == {
        str(name): part["rank"].tolist()
        for name, part in rows[rows["refit"] == 1].groupby("quantity", sort=False)
    }
    # Not the same third: the posterior's draws are spread over as many refits as there are.
    assert set(made[2]["ranks"]) == set(third["quantity"])
    assert (tmp_path / "refit-0002.json").is_file()


def test_posteriors_that_are_too_narrow_are_found(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = certifying.sample

    def narrower(*arguments: Any) -> Any:
        chains = sample(*arguments)
        middle = chains.u.mean(axis=(0, 1))
        return replace(chains, u=middle + 0.5 * (chains.u - middle))

    monkeypatch.setattr(certifying, "sample", narrower)
    made = bt.certify(run, refits=REFITS)
    assert not made.passed
    assert "NOT CALIBRATED" in made.words
    wrong = made.calibration.set_index("quantity").loc[["K of drawn impacts", "C of drawn impacts"]]
    assert (wrong["held"] < 0.8).all()
    assert "NOT CALIBRATED" in repr(made)


def test_drawn_impacts_scatter_as_the_model_says(run: Path) -> None:
    study = certifying.CertificateJob.of_run(run)
    job = certifying.ChainJob(study.prepared, study.fit.specification.sampler, 1)
    chains = next(certifying.chain_draws(job, study.fit.chain_end()))
    truth: Truth = truths(chains, 1)[0]
    rng = np.random.default_rng(0)
    u = np.array([new_impacts(study.prepared, truth.population, rng) for _ in range(2000)])
    hyper = truth.population.hyperparameters
    sd = np.hypot([hyper["sd_impact_K"], hyper["sd_impact_C"]], study.prepared.model.log_mass_sd)
    # A standard deviation of 24,000 numbers is known to 0.5 %.
    assert u[..., :2].std(axis=0).mean(axis=0) == pytest.approx(sd, rel=0.02)


@pytest.mark.parametrize("refits", [9, 1001])
def test_too_few_or_many_refits_are_refused(run: Path, refits: int) -> None:
    with pytest.raises(bt.InputError, match="from 10 to 1000"):
        bt.certify(run, refits=refits)


def test_recordings_that_are_gone_or_others_are_named(run: Path, tmp_path: Path) -> None:
    ended = bayestissue("certify", run, "--dataset", tmp_path / "nowhere", "--out", tmp_path / "out")
    assert ended.status == 2
    assert "--dataset DATASET" in ended.err
    campaign(tmp_path / "others", seed=5)
    ended = bayestissue("certify", run, "--dataset", tmp_path / "others", "--out", tmp_path / "out")
    assert (ended.status, "another-run" in ended.err) == (2, True)


def test_the_paper_has_the_checklists(run: Path, certificate: Path, tmp_path: Path) -> None:
    assert bayestissue("export", run, "--out", tmp_path / "paper", "--certificate", certificate).status == 0
    lists = (tmp_path / "paper" / "checklists.md").read_text(encoding="utf-8")
    assert "Bayesian analysis reporting guidelines" in lists
    assert "drawn from this one's posterior" in lists
    ended = bayestissue("export", run, "--out", tmp_path / "other", "--certificate", run)
    assert ended.status == 2
    assert "certificate of this very fit" in ended.err
