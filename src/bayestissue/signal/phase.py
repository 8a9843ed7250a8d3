"""Where contact falls within a sampling interval: one question to all recordings of a recorder.

A free-running recorder samples at a phase of its own, so that contact is anywhere between two samples. A
triggered recorder and a simulation whose time begins at contact have contact at a sample: at the first one in
contact, which holds the jump C V / M, or, where that one was written as 0, at the sample before. Which of
the three it is hardly shows in one trace, but is common to all.

Each trace by itself has contact at t_i before its first sample in contact, by least squares with a standard
error s_i. A velocity e (as a fraction) above the stated one moves t_i by -e m_i, and may be common to all
traces. With D the sampling interval and n(.) a standard normal's density, the evidence of each account is

    p = int prod_i p_i(t_i + e m_i) dP(e),   p_i(t) = n((t - c) / s_i) / s_i,   c = 0 or D,

and between samples p_i(t) = (Phi(t / s_i) - Phi((t - D) / s_i)) / D. Where a tissue is no spring and damper
t_i may lie beyond the interval; then neither account is as good as one by which it is anywhere about, and
nothing is said.

Where no account has 95 %, and the recordings tell the two samples apart, contact of each impact has all three
beforehand, each by its probability given all recordings. To take the likeliest alone would be as if it were
certain: where contact was at a sample and the recordings hardly told so, 90 % intervals of C then held it too
seldom.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr, logsumexp
from scipy.stats import norm

from bayestissue.dataset.chain import Contact
from bayestissue.signal.settings import PHASE
from bayestissue.signal.traces import Column, Mask


class ContactEvidence(NamedTuple):
    """What each trace by itself says of contact, each [impact].

    Attributes:
        before_s, sd: from contact to the first sample in contact, by least squares, and its error, s.
        by_velocity: by how much that grows where the velocity is greater than stated, s per fraction of it.
        dt: the sampling interval, s.
        bracketed: contact was in the one interval before the first sample in contact.
        at_zero: the clock's 0 is at the first sample in contact (column 0), or at the one before (column 1).
    """

    before_s: Column
    sd: Column
    by_velocity: Column
    dt: Column
    bracketed: Mask
    at_zero: Float[np.ndarray, "impact 2"]


class Phase(NamedTuple):
    """Probabilities of contact at the first sample in contact, and at the one before it; else between them.

    Attributes:
        first: at the first sample, which then holds the jump C V / M.
        before: at the one before, which holds 0.
        judged: the recordings told, as nothing was declared.
    """

    first: float = 0.0
    before: float = 0.0
    judged: bool = False

    @property
    def known(self) -> bool:
        """Whether contact is known to be at one of the two."""
        return max(self.first, self.before) == 1.0

    @property
    def kind(self) -> Literal["between", "on_sample", "undecided"]:
        """In the words of ``signal.contact``."""
        return "on_sample" if self.known else "undecided" if self.first + self.before else "between"

    @property
    def words(self) -> str:
        """What is taken of contact, in a sentence's part."""
        which = "the last one before the force" if self.before else "the first one with a force"
        words = {
            "between": "between two samples",
            "on_sample": f"at a sample, {which}",
            "undecided": "between two samples or at one of them",
        }[self.kind]
        return f"{words}, as all recordings together tell" if self.judged else words


BETWEEN, _FIRST, _BEFORE = Phase(), Phase(first=1.0), Phase(before=1.0)


def phase_of(evidence: ContactEvidence, velocity_sd: Column, declared: Contact | None) -> Phase:
    """Where contact falls in all recordings.

    Args:
        evidence: by each trace.
        velocity_sd: of the velocity and gain together, as a fraction of it.
        declared: what ``dataset.toml`` says, if it does.
    """
    if declared == "between" or not (evidence.bracketed.any() or declared):
        return BETWEEN
    prior = np.where(evidence.at_zero[evidence.bracketed].all(axis=0), PHASE.on_sample, 0.0)
    begins_there = prior.any()
    if not begins_there:
        prior[:] = PHASE.on_sample / 2
    *accounts, anywhere = _log_evidence(evidence, velocity_sd)
    if declared:
        needed = -PHASE.clear if prior[1] > prior[0] else PHASE.clear
        return _BEFORE if accounts[1] > accounts[0] + needed else _FIRST
    if max(accounts) < anywhere:
        return BETWEEN
    with np.errstate(divide="ignore"):
        posterior = np.log([*prior, 1 - prior.sum()]) + accounts
    first, before, between = np.exp(posterior - logsumexp(posterior))
    for phase, share in ((BETWEEN, between), (_FIRST, first), (_BEFORE, before)):
        if share > PHASE.sure:
            return phase._replace(judged=True)
    # Recordings that do not tell the two samples apart say little that was not known, and anywhere between
    # is as good. Where one of the two is excluded, the other moves contact, and C, to its side.
    apart = abs(accounts[0] - accounts[1]) > PHASE.clear
    return Phase(float(first), float(before), judged=True) if begins_there or apart else BETWEEN


def _log_evidence(
    evidence: ContactEvidence, velocity_sd: Column, width: float = 5.0, nodes: int = 65
) -> list[float]:
    """Log evidence of contact at the first sample, at the one before, between, and of anywhere about them.

    Args:
        evidence: by each trace.
        velocity_sd: of the velocity and gain together, as a fraction of it.
        width: sampling intervals in which the least squares look for contact.
        nodes: of the integral over the velocity's error.
    """
    t, s, moved = (
        part[evidence.bracketed] / evidence.dt[evidence.bracketed]
        for part in (evidence.before_s, evidence.sd, evidence.by_velocity)
    )
    s = np.hypot(s, PHASE.least_sd)
    quantiles = norm.ppf((np.arange(nodes) + 0.5) / nodes)[:, None]
    shifted = t + quantiles * moved * velocity_sd[evidence.bracketed]
    at = [norm.logpdf(shifted, centre, s) for centre in (0.0, 1.0)]
    within = [_log_within(shifted - 0.5, interval, s) for interval in (1.0, width)]
    return [float(logsumexp(part.sum(axis=1)) - np.log(nodes)) for part in (*at, *within)]


def _log_within(t: np.ndarray, width: float, sd: Column) -> np.ndarray:
    """Log density of what is uniform over an interval of ``width`` about 0, with a normal error."""
    # By the smaller tail: far out the difference of two probabilities next to 1 is rounding.
    near = -np.abs(t)
    low, high = log_ndtr((near - width / 2) / sd), log_ndtr((near + width / 2) / sd)
    return high + np.log1p(-np.exp(low - high)) - np.log(width)
