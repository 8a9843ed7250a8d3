from __future__ import annotations

import pytest

from bayestissue.reports.pages import posterior
from bayestissue.reports.pages.run_folder import read_about
from bayestissue.thesis.published_run import PublishedRun


@pytest.fixture(scope="module")
def run(published_run_folder):
    return PublishedRun.read(published_run_folder, read_about(published_run_folder))


def test_the_best_explanation_and_its_rivals_are_named(run):
    impact, trial = posterior.best_explanations(run.comparison)
    assert "“log mass” predicts best; within two standard errors or four nats of it: mass and none." in impact
    assert trial.startswith("Leave one trial out: “log mass” predicts best; no other comes within")
    assert trial.endswith("Warned: 9 trials only: the standard errors are rough (4 of 4 models).")
    unsure = run.comparison.assign(se_difference=1e3)
    assert "four nats of it: mass, energy and none." in posterior.best_explanations(unsure)[1]
    # However certain, a small difference tells nothing.
    little = run.comparison.assign(se_difference=0.1, elpd_difference=-3.0)
    assert "or four nats of it: mass" in posterior.best_explanations(little)[1]
