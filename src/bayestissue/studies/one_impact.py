"""One impact from two arrays: its K and C with intervals, flags and a picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from bayestissue.base.declarations import general, taking
from bayestissue.base.errors import InputError
from bayestissue.base.outline import Outlined, Rows
from bayestissue.inference.points.notes import said_once
from bayestissue.inference.points.point_estimates import Inspected
from bayestissue.inference.results.meanings import COLUMNS
from bayestissue.inference.single.impact_estimates import by_impact, outcomes_in
from bayestissue.recordings.dataset.arrays import dataset as dataset_of
from bayestissue.recordings.dataset.dataset_file import FILE as SETTINGS
from bayestissue.recordings.dataset.dataset_file import arguments
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.recordings.signal import displacements
from bayestissue.recordings.signal.quality import inspect
from bayestissue.reports.figures.impacts import end
from bayestissue.reports.figures.theme import Figure
from bayestissue.reports.figures.traces import recording
from bayestissue.reports.pages.wording import estimated

if TYPE_CHECKING:
    import pandas as pd

_STATED = ("gravity", "zero", "contact", "uncertainty", "recorder")
_NO_ESTIMATE = "no estimate"


@dataclass(frozen=True, eq=False, repr=False)
class Impact(Outlined):
    """What one recorded impact says of the tissue: the row that `bayestissue.estimate` has for it.

    Attributes:
        K: stiffness, posterior median, N/m.
        C: damping, posterior median, N s/m.
        K_interval: holds K with a probability of 90 %, N/m; no numbers where there is none. From 0 to an
            upper bound, which holds with 95 %, where the recording tells no more.
        C_interval: holds C with a probability of 90 %, N s/m; likewise.
        flags: what is wrong with the recording or its fit; K and C may then be wrong.
        notes: what is not wrong, but should be known.
        dataset: the impact as a dataset of one.
        row: its row of `estimates.csv`.
        time_s: of each sample up to the greatest depth, since contact, s.
        deceleration: there, the recorder's offset removed, m/s².
        fitted: of a spring and damper of this K and C, the errors of the measuring chain as the trace has
            them, m/s²; no number where the impact has too few samples.
    """

    K: float
    C: float
    K_interval: tuple[float, float]
    C_interval: tuple[float, float]
    flags: tuple[str, ...]
    notes: tuple[str, ...]
    dataset: Dataset
    row: pd.Series
    time_s: Float[np.ndarray, " sample"]
    deceleration: Float[np.ndarray, " sample"]
    fitted: Float[np.ndarray, " sample"]

    @property
    def outcomes(self) -> pd.DataFrame:
        """What the impact came to, an outcome a row: peak force, depth, restitution and others.

        ``median``, ``low`` and ``high``, the ends of the 90 % interval, and ``unit``; ``never`` is the
        probability that a time is infinite, the tissue never being left.
        """
        return outcomes_in(self.row)

    def _repr_html_(self) -> str:
        return f"{super()._repr_html_()}{self.plot().svg()}"

    def _outline(self) -> tuple[str, Rows]:
        rows = [*self._answers()]
        zeta = self.row["zeta"]
        rows.append(("damping ratio", f"{zeta:.3g}" if np.isfinite(zeta) else _NO_ESTIMATE))
        came_to = self.outcomes
        for name, words in (("peak_force", "peak force"), ("peak_depth", "peak depth")):
            median, low, high = (float(came_to[which][name]) for which in ("median", "low", "high"))
            rows.append((words, _in_words(median, (low, high), str(came_to["unit"][name]))))
        rows += [("flag", flag) for flag in self.flags] or [("flags", "none")]
        rows += [("note", note) for note in self.notes]
        rows.append(("more in", ".K_interval, .C_interval, .outcomes, .flags, .row, .plot()"))
        return "Impact", rows

    def _answers(self) -> Rows:
        return [
            ("K", _in_words(self.K, self.K_interval, "N/m")),
            ("C", _in_words(self.C, self.C_interval, "N s/m")),
        ]

    def plot(self) -> Figure:
        """The recording with the fitted impact, and what that leaves over, up to the greatest depth."""
        import pandas as pd

        rows = pd.DataFrame(
            {"time_ms": 1e3 * self.time_s, "recorded": self.deceleration, "median": self.fitted}
        )
        answers = "; ".join(f"{name} = {words}" for name, words in self._answers())
        words = f"The recorded deceleration and that of the fitted spring and damper. {answers}."
        return recording(rows, "deceleration", "m/s²", words, median="spring and damper")


@taking({name: declared for name, declared in arguments().items() if name in _STATED})
def impact(
    time_s: ArrayLike,
    deceleration: ArrayLike,
    *,
    mass_kg: float,
    velocity_m_s: float,
    unit: str = "m/s^2",
    **stated: Any,
) -> Impact:
    """K and C of one impact, each with an interval that holds it with a probability of 90 %.

    The posterior under the likelihood of its deceleration and weak priors, by `bayestissue.estimate` of a
    dataset of one. The first call compiles for some seconds; what is compiled serves later ones of about as
    many samples.

    Args:
        time_s: of each sample, s; contact may be anywhere in it.
        deceleration: positive while the impactor slows, until it has lost its speed or longer. What a masked
            array hides is left out at either end, and refused between.
        mass_kg: of the impactor.
        velocity_m_s: at contact.
        unit: of the decelerations, such as "m/s^2" or "g_0".
        **stated: keys of ``dataset.toml``, its tables as dictionaries.

    Raises:
        InputError: everything that is wrong with the arrays or the arguments.
    """
    impacts = {
        "impact": ["impact"],
        "subject": ["subject"],
        "trial": ["trial"],
        "mass_kg": [mass_kg],
        "velocity_m_s": [velocity_m_s],
    }
    data = dataset_of(
        impacts,
        [(np.asanyarray(time_s), np.asanyarray(deceleration))],
        quantity="deceleration",
        unit=unit,
        **stated,
        name="one impact",
    )
    return impact_of(data)


def impact_of(data: Dataset) -> Impact:
    """The same of a dataset of one impact.

    Raises:
        InputError: as of `bayestissue.estimate`; it is a displacement.
    """
    if data.quantity == "displacement":
        raise InputError.stated("unsuited-likelihood.one", SETTINGS, None, "signal.quantity", data.quantity)
    signal = displacements(data)
    table, posteriors = by_impact(Inspected(data, signal, inspect(data)))
    inside = np.arange(signal.n_samples[0])
    recorded = signal.deceleration[0, inside]
    left = np.full(len(inside), np.nan)
    # Too few samples have no posterior.
    if posteriors is not None and posteriors.residuals is not None:
        left = posteriors.residuals[0, inside]
    row = table.iloc[0]
    interval = {q: (float(row[end(q, "low")]), float(row[end(q, "high")])) for q in COLUMNS}
    return Impact(
        K=float(row[COLUMNS["K"]]),
        C=float(row[COLUMNS["C"]]),
        K_interval=interval["K"],
        C_interval=interval["C"],
        flags=tuple(flag for flag in row["flags"].split("; ") if flag),
        notes=tuple(said_once([row["notes"]])),
        dataset=data,
        row=row,
        time_s=signal.since_contact_s[0, inside],
        deceleration=recorded,
        fitted=recorded - left,
    )


def _in_words(value: float, interval: tuple[float, float], unit: str) -> str:
    if not np.isfinite(value):
        bound = f", below {general(interval[1])} {unit} (95 %)" if np.isfinite(interval[1]) else ""
        return _NO_ESTIMATE + bound
    if not np.isfinite(interval).all():
        return f"{general(value)} {unit}, no interval"
    median, low, high = estimated(value, *interval)
    return f"{median} {unit} (90 %: {low} to {high})"
