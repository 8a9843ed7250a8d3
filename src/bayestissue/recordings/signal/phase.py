"""Where contact falls within a sampling interval: one question to all recordings of a recorder.

A free-running recorder samples at a phase of its own, so that contact is anywhere between two samples. A
triggered recorder and a simulation whose time begins at contact have contact at a sample: at the first one in
contact, which holds the jump C V / M, or, where that one was written as 0, at the sample before. Which of
the three it is hardly shows in one trace, but is common to all.

Each trace by itself has contact at t_i before its first sample in contact, by least squares with a standard
error s_i. A velocity e (as a fraction) above the stated one moves t_i by -e m_i. It may be common to all
traces, or each impact's own, which s_i has beside the noise. With D the sampling interval and n(.) a standard
normal's density, the evidence of each account is

    p = int prod_i p_i(t_i + e m_i) dP(e),   p_i(t) = n((t - c) / s_i) / s_i,   c = 0 or D,

and between samples p_i(t) = (Phi(t / s_i) - Phi((t - D) / s_i)) / D. Where a tissue is no spring and damper
t_i may lie beyond the interval; then neither account is as good as one by which it is anywhere about, and
nothing is said.

Where no account has 95 % contact is estimated, with t_i = (1/2 + f_i) D and f_i normal with unknown mean and
spread over the impacts. A mean of 0 and a spread of 0.29 are anywhere in the interval, a small spread is one
place in all impacts, and a mean of -1/2 or 1/2 is a sample. A fit samples f_i with its mean and spread, also
where noise hides a jump of the force, and contact may be in any of several intervals, at the same f_i in each
of them: contact at a sample is at the end of what noise leaves, and with all moments as likely 90 % intervals
of C held half of the time. For an impact by itself both are as the least squares of all impacts have them,
and f_i is normal about that mean.
To take the likeliest account alone would be as if it were certain: of single recordings with contact at a
sample and 1 % of noise on it, 90 % intervals of C then held 47 %. To let each impact have its own odds would
forget that they share a recorder.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr, logsumexp, softmax
from scipy.stats import norm

from bayestissue.recordings.dataset.dataset_file import Contact
from bayestissue.recordings.signal.padded_traces import Column, Mask
from bayestissue.recordings.signal.signal_settings import PHASE

if TYPE_CHECKING:
    from bayestissue.recordings.signal.displacement import Displacements

Kind = Literal["between", "first", "before", "undecided"]


class ContactEvidence(NamedTuple):
    """What every trace that tells says of contact by itself, each [impact], in sampling intervals.

    Attributes:
        before, sd: from contact to the first sample in contact, by least squares, and its error.
        by_velocity: by how much that grows where the velocity is a standard deviation greater than stated.
    """

    before: Column
    sd: Column
    by_velocity: Column

    def by_common_error(self, nodes: int) -> tuple[Float[np.ndarray, "node impact"], Column]:
        """t_i by quantiles of a velocity's error of all, and s_i."""
        common = norm.ppf(_even(nodes))[:, None] * self.by_velocity
        return self.before + common, np.sqrt(self.sd**2 + self.by_velocity**2 + PHASE.least_sd**2)


class Phase(NamedTuple):
    """Where contact falls within a sampling interval.

    Attributes:
        kind: anywhere between samples; at the first sample in contact, which then holds the jump C V / M; at
            the one before it, which holds 0; or at a place that is to be estimated.
        judged: the recordings told, as nothing was declared.
        contradicted: contact is declared to be at a sample, and the recordings spread it over the interval.
        mean, sd: where it is to be estimated, of f in an impact whose own trace was not asked: contact was
            (1/2 + f) intervals before the first sample in contact.
    """

    kind: Kind = "between"
    judged: bool = False
    mean: float = 0.0
    sd: float = 12**-0.5
    contradicted: bool = False

    @property
    def fraction(self) -> float:
        """The part of the interval from contact to the first sample in contact; nan where it is not known."""
        return {"first": 0.0, "before": 1.0}.get(self.kind, np.nan)

    @property
    def known(self) -> bool:
        """Whether contact is known to be at a sample."""
        return self.kind in ("first", "before")

    @property
    def words(self) -> str:
        """What is taken of contact, in a sentence's part."""
        words = {
            "between": "between two samples",
            "first": "at a sample, the first one with a force",
            "before": "at a sample, the last one before the force",
            "undecided": "between two samples or at one of them: where is estimated",
        }[self.kind]
        words += ", as declared: the recordings contradict it" if self.contradicted else ""
        return f"{words}, as all recordings together tell" if self.judged else words


BETWEEN = Phase()


def phase_of(signal: Displacements, tells: Mask, velocity_sd: Column, declared: Contact | None) -> Phase:
    """Where contact falls in all recordings.

    Args:
        signal: of the recordings, contact anywhere in its interval.
        tells: [impact], of which contact was in the one interval before the first sample in contact, and the
            samples tell where.
        velocity_sd: of the velocity and gain together, as a fraction of it.
        declared: what ``dataset.toml`` says, if it does.
    """
    if declared == "between":
        return BETWEEN
    dt = signal.dt[:, None]
    # The clock's 0 is at the first sample in contact, or at the one before.
    at_zero = np.abs(signal.start[:, None] - np.array([0.0, 1.0]) * dt) < 1e-6 * dt
    if not (tells.any() or declared):
        # Where the clock begins at contact, as whoever cut the recordings had it, no trace has to tell; where
        # noise hides contact none can by itself.
        untold = at_zero.all(axis=0).any() or signal.before.blurred.any()
        return Phase("undecided", sd=float(np.hypot(PHASE.mean_sd, PHASE.spread))) if untold else BETWEEN
    prior = np.where(at_zero[tells].all(axis=0), PHASE.on_sample, 0.0)
    if not prior.any():
        prior[:] = PHASE.on_sample / 2
    contact = signal.contact
    t, s, moved = (
        part[tells] / signal.dt[tells] for part in (contact.free, contact.free_sd, contact.by_velocity)
    )
    evidence = ContactEvidence(t, s, moved * velocity_sd[tells])
    *accounts, anywhere = _log_evidence(evidence)
    if declared:
        needed = -PHASE.clear if prior[1] > prior[0] else PHASE.clear
        kind: Kind = "before" if accounts[1] > accounts[0] + needed else "first"
        return Phase(kind, contradicted=_spread(evidence, accounts, anywhere))
    if max(accounts) < anywhere:
        return BETWEEN
    with np.errstate(divide="ignore"):
        posterior = np.log([*prior, 1 - prior.sum()]) + accounts
    shares = softmax(posterior)
    kinds: tuple[Kind, ...] = ("first", "before", "between")
    if np.max(shares) > PHASE.sure:
        return Phase(kinds[np.argmax(shares)], judged=True)
    return Phase("undecided", False, *_of_another(evidence))


def _spread(evidence: ContactEvidence, accounts: list[float], anywhere: float) -> bool:
    """Whether contact is clearly between samples, and not by errors of velocity, common or own."""
    (t,), s = evidence.by_common_error(1)
    apart = t.size > 1 and np.var(t, ddof=1) - np.mean(s**2) > PHASE.apart**2
    return bool(apart and accounts[2] > max(anywhere, PHASE.contradicts + max(accounts[:2])))


def _of_another(evidence: ContactEvidence) -> tuple[float, float]:
    """Mean and standard deviation of f in a further impact, by the least squares of all."""
    means, spreads = PHASE.mean_sd * norm.ppf(_even(41)), PHASE.spread * norm.ppf(0.5 + _even(24) / 2)
    mean, spread = (axis.ravel() for axis in np.meshgrid(means, spreads))
    shifted, s = evidence.by_common_error(17)
    off = (shifted[:, None] - 0.5 - mean[:, None]) / (wide := np.hypot(spread[:, None], s))
    log_density = -(np.square(off) / 2 + np.log(wide))
    share = softmax(logsumexp(np.sum(log_density, axis=2), axis=0))
    middle = float(share @ mean)
    return middle, float(np.sqrt(share @ (spread**2 + (mean - middle) ** 2)))


def _even(number: int) -> np.ndarray:
    """Probabilities in the middle of so many equal parts."""
    return (np.arange(number) + 0.5) / number


def _log_evidence(evidence: ContactEvidence, width: float = 5.0, nodes: int = 65) -> list[float]:
    """Log evidence of contact at the first sample, at the one before, between, and of anywhere about them.

    Args:
        evidence: by each trace.
        width: sampling intervals in which the least squares look for contact.
        nodes: of the integral over the velocity's error.
    """
    shifted, s = evidence.by_common_error(nodes)
    at = [norm.logpdf(shifted, centre, s) for centre in (0.0, 1.0)]
    within = [_log_within(shifted - 0.5, interval, s) for interval in (1.0, width)]
    return [float(logsumexp(np.sum(part, axis=1)) - np.log(nodes)) for part in (*at, *within)]


def _log_within(t: np.ndarray, width: float, sd: Column) -> np.ndarray:
    """Log density of what is uniform over an interval of ``width`` about 0, with a normal error."""
    # By the smaller tail: far out the difference of two probabilities next to 1 is rounding.
    near = -np.abs(t)
    low, high = log_ndtr((near - width / 2) / sd), log_ndtr((near + width / 2) / sd)
    return high + np.log1p(-np.exp(low - high)) - np.log(width)
