"""A fit goes on while what follows from its draws is rough, and no longer than that."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bayestissue.inference import fit
from bayestissue.inference.chain.draws import ChainJob
from bayestissue.model.hierarchy.specification import ModelSpecification, Sampler

# R-hat passes at the third look, and effective sizes never.
LOOKS = ((False, False), (False, False), (True, False), (True, False))


@pytest.mark.parametrize(("draws", "effective", "looks"), [(100, 400, 3), (1000, 100, 3), (1000, 400, 4)])
def test_a_fit_ends_when_more_draws_would_not_mend_its_verdict(monkeypatch, draws, effective, looks):
    class Chains(SimpleNamespace):
        def thinned(self, draws: int) -> Any:
            return Chains(number=self.number, shape=(4, min(draws, self.shape[1])))

    runs = [Chains(number=number, shape=(4, 500)) for number in range(len(LOOKS))]
    seen = []

    def label(job: Any, specification: Any, drawn: Any, chains: Any) -> Any:
        seen.append(chains.number)
        passed = zip(("r-hat", "effective-sample-size"), LOOKS[chains.number], strict=True)
        checks = [{"code": code, "passed": each} for code, each in passed]
        return SimpleNamespace(diagnostics={"passed": False, "checks": checks}, number=chains.number)

    monkeypatch.setattr(fit, "samples", lambda *_, **__: iter(runs))
    monkeypatch.setattr(fit, "posterior_draws", lambda *_: None)
    monkeypatch.setattr(fit, "label", label)
    sampler = Sampler(draws=draws, effective=effective)
    specification = ModelSpecification(name="impact", likelihood="impact", sampler=sampler)
    job = ChainJob(None, sampler, 1)  # type: ignore[arg-type]
    analysis: Any = fit.fit_traces(job, specification)
    assert seen == list(range(looks))
    # What is told is of the last draws.
    assert analysis.number == looks - 1
