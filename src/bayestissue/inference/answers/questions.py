"""Questions about a finished fit: posterior and prior probability, Bayes factor, Monte Carlo error.

The probability of a claim is the share of the draws in which it is true, P, with Monte Carlo standard error
sd / ess^1/2 by the effective sample size of that indicator (as ArviZ has it). Its Bayes factor is posterior
over prior odds,

    BF = P / (1 - P) / (P_0 / (1 - P_0)),

above 1 where the data speak for it. It is left out, with the reason in ``note``, where fewer than `FEWEST`
effective draws are on either side of the claim: there it would be a ratio of accidents.

A choice compares levels. Each is best with the probability that its value is the lowest, or highest, of all;
levels that are equal in a draw share it. The expected loss of a level is the mean distance of its value from
the best one: what choosing it costs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base.declarations import general
from bayestissue.base.errors import Coded, InputError, Problem, all_of, printable
from bayestissue.base.outcome_table import OUTCOMES
from bayestissue.base.results.tables import table_of_rows
from bayestissue.inference.answers.evaluation import draws_of
from bayestissue.inference.answers.fixed import fixed_parts
from bayestissue.inference.answers.grammar import (
    ALLOWED,
    Choice,
    Critical,
    Node,
    QuestionError,
    parse,
)
from bayestissue.inference.answers.integration import SETTINGS
from bayestissue.inference.answers.law import DROP_HEIGHT, MOTION, fall_height, moving
from bayestissue.inference.answers.meaning import (
    alternatives,
    as_recorded,
    at_level,
    average_notes,
    beyond_notes,
    condition_of,
    conditions_of,
    is_response,
    mistakes,
    outcomes_in,
    require_motions,
    responses_of,
    searched,
    unit_of,
)
from bayestissue.inference.answers.study import Study
from bayestissue.inference.checking.findings import ELEMENT_ALONE, of_element_alone
from bayestissue.inference.results.meanings import MOSTLY
from bayestissue.inference.results.summary import prior_overlap
from bayestissue.inference.samplers.sampling import effective_size, interval

FEWEST = 10


@dataclass(frozen=True)
class Question:
    """A question as it was asked.

    Attributes:
        text: itself.
        place: what messages call it: "question 2", or a file and key.
        name: what its asker calls it; empty where nothing.
    """

    text: str
    location: str
    name: str = ""


def numbered(texts: Iterable[str]) -> list[Question]:
    """Questions that have no names."""
    return [Question(text, f"question {number}") for number, text in enumerate(texts, start=1)]


def of_model(questions: dict[str, str], source: str) -> list[Question]:
    """The questions of a model file, which messages call ``source``."""
    return [Question(text, f"{source}, questions.{name}", name) for name, text in questions.items()]


def ask(study: Study, questions: Sequence[Question]) -> pd.DataFrame:
    """The answer to each question: a row of ``questions.csv``.

    A claim has ``posterior`` and ``prior`` probability, ``bayes_factor`` and the Monte Carlo standard errors
    ``mcse`` and ``prior_mcse`` of the two. An expression has ``median`` and 90 % interval ``low`` to
    ``high``, with their ``unit`` if it is that of a quantity; its ``mcse`` is the median's. Everything else
    is empty; ``note`` says why where it could be expected. A choice has a row for each ``level``, whose
    ``posterior`` is the probability that it is the best, with its ``rank`` and ``expected_loss``.

    Raises:
        InputError: some can't be read, or ask for what this run does not have: all that is wrong at once.
    """
    answers = all_of(lambda question: _answer(study, question), questions)
    return table_of_rows("questions", [row for rows in answers for row in rows])


def ask_what_can_be(study: Study, questions: Sequence[Question]) -> pd.DataFrame:
    """The same, but a question that can't be answered has its reason in ``note`` and no answer."""
    rows = []
    for question in questions:
        try:
            rows += _answer(study, question)
        except InputError as error:
            reasons = "; ".join(f"no answer: found {p.value}, expected {p.expected}" for p in error.problems)
            labels = {"question": question.text, "name": question.name, "level": "", "unit": ""}
            rows.append(labels | {"note": reasons})
    return table_of_rows("questions", rows)


def require_parsed(questions: Sequence[Question]) -> None:
    """Raise an `InputError` of every slip of form in questions."""
    all_of(_parsed, questions)


def require_readable(questions: Sequence[Question], study: Study) -> None:
    """Raise an `InputError` of all that is wrong with questions, as far as it shows: see `mistakes`."""
    all_of(lambda question: _read(question, study), questions)


def require_outcomes(questions: Sequence[Question], study: Study) -> None:
    """Raise an `InputError` of the outcomes in readable questions that this study does not have."""

    def all_motions(question: Question) -> None:
        try:
            for quantity in outcomes_in(as_recorded(_parsed(question), study), study.recorded):
                require_motions(quantity, study, conditions_of(quantity, study.recorded))
        except QuestionError as slip:
            raise InputError(_problem(slip, question)) from None

    all_of(all_motions, questions)


def _parsed(question: Question) -> Node:
    try:
        return parse(question.text)
    except QuestionError as slip:
        raise InputError(problem_of(slip, question)) from None


def _read(question: Question, study: Study) -> Node:
    node = as_recorded(_parsed(question), study)
    errors = list(mistakes(node, study)) or list(fixed_parts(node, study))
    # A level that stands once may be part of several quantities.
    slips = {(slip.position, slip.actual, slip.expected): slip for slip in errors}
    if slips:
        raise InputError(_problem(slip, question) for slip in slips.values())
    return node


def problem_of(slip: QuestionError, question: Question) -> Problem:
    """A slip of form: what is allowed stands beside it."""
    return _problem(slip, question, f"Allowed: {ALLOWED}.")


def _problem(slip: QuestionError, question: Question, otherwise: str = "") -> Problem:
    """One line that says what is wrong, and under it the place."""
    begin = max(0, slip.position - SETTINGS.around_slip)
    text = printable(question.text[begin : slip.position + SETTINGS.around_slip])
    before = printable(question.text[begin : slip.position])
    remedy = f"{slip.remedy or otherwise}\n    {text}\n    {' ' * len(before)}^"
    return Problem(
        question.location,
        slip.expected,
        remedy,
        column=f"{slip.position + 1}",
        value=slip.actual,
        code="question",
    )


def _answer(study: Study, question: Question) -> list[dict[str, Any]]:
    """The row of a question, or one for each level of a choice."""
    node = _read(question, study)
    labels = {"question": question.text, "name": question.name, "level": ""}
    try:
        if isinstance(node, Choice):
            rows = _choice(study, node)
        else:
            posterior = draws_of(node, study)
            prior, note = _before(study, node, partial(draws_of, node))
            rows = [_claim(posterior, prior, note) if node.claims else _number(study, node, posterior, prior)]
    except QuestionError as slip:
        raise InputError(_problem(slip, question)) from None
    alone = study.element_alone and any(of_element_alone(q.name) for q in node.quantities())
    known = [*_of_levels(study, node), *[ELEMENT_ALONE] * alone]
    return [labels | row | {"note": "; ".join(filter(None, [row["note"], *known]))} for row in rows]


def _claim(posterior: xr.DataArray, prior: xr.DataArray | None, note: str) -> dict[str, Any]:
    p, error, size = _probability(posterior)
    row = {"posterior": p, "mcse": error, "unit": "", "draws": posterior.size}
    if prior is not None:
        p_0, error_0, size_0 = _probability(prior)
        factor, note = _bayes_factor(p, size, p_0, size_0)
        row |= {"prior": p_0, "prior_mcse": error_0, "prior_draws": prior.size, "bayes_factor": factor}
    return row | {"note": note}


def _number(study: Study, node: Node, posterior: xr.DataArray, prior: xr.DataArray | None) -> dict[str, Any]:
    notes: list[str] = []
    searched_up_to, overlap = "", np.nan
    if isinstance(node, Critical):
        searched_up_to = f" up to {SETTINGS.fastest:g} m/s"
        notes = [_beyond_fastest(study, node, posterior)]
    if prior is not None:
        overlap = prior_overlap(posterior.to_numpy(), prior.to_numpy())
    # Of what a question asks the time, or the motion, of.
    if never := float(np.isinf(posterior).mean()):
        notes.insert(0, f"never{searched_up_to} in {100 * never:.3g} % of the draws")
    elif overlap > MOSTLY:
        notes.insert(0, f"largely prior: the two overlap by {100 * overlap:.0f} %")
    unit, note = unit_of(node, study.draws), "; ".join(filter(None, notes))
    return _interval(posterior) | {"unit": unit, "draws": posterior.size, "note": note}


def _choice(study: Study, node: Choice) -> list[dict[str, Any]]:
    """A row for each level: its value, the probability that it is the best, its rank, and what it loses."""
    unit = unit_of(node, study.draws)
    levels, unlawful = _with_a_law(study, alternatives(node, study))

    def values_in(which: Study) -> xr.DataArray:
        values = [draws_of(one, which) for one in levels.values()]
        return xr.concat(values, pd.Index(levels, name="level")).transpose("level", "chain", "draw")

    posterior = values_in(study)
    prior, note = _before(study, node, values_in)
    left_out = Coded.stated("not-simulated.levels", column=node.column, levels=", ".join(unlawful))
    best, rank, loss = ranked(posterior, lowest=node.lowest)
    best_before = None if prior is None else ranked(prior, lowest=node.lowest)[0]
    rows = []
    for index, level in enumerate(levels):
        row = _claim(best[index], None if best_before is None else best_before[index], note)
        row["note"] = "; ".join(filter(None, [row["note"], left_out if unlawful else ""]))
        row |= {"level": level, "unit": unit} | interval(rank[index], "rank")
        row |= _interval(posterior[index]) | {"mcse": row["mcse"], "expected_loss": float(loss[index].mean())}
        rows.append(row)
    return rows


def _with_a_law(study: Study, levels: dict[str, Node]) -> tuple[dict[str, Node], list[str]]:
    """What a choice compares, less the levels whose outcomes follow no law, and these.

    All, where two are not left.
    """
    recorded = study.recorded
    unlawful = [
        label
        for label, node in levels.items()
        if study.law.anywhere
        for quantity in outcomes_in(node, recorded)[:1]
        if not all(map(study.holds, conditions_of(quantity, recorded)))
    ]
    if len(levels) - len(unlawful) < 2:
        return levels, []
    return {label: node for label, node in levels.items() if label not in unlawful}, unlawful


def ranked(values: xr.DataArray, *, lowest: bool) -> tuple[xr.DataArray, xr.DataArray, xr.DataArray]:
    """Of each level and draw its part of being best, its rank from 1, and its distance from the best."""
    from scipy.stats import rankdata

    ordered = values if lowest else -values
    best = ordered == ordered.min("level")
    rank = values.copy(data=rankdata(ordered, method="min", axis=0))
    # Of a level that never ends, as a contact, beside another: nothing, and no difference of infinities.
    loss = xr.where(best, 0.0, ordered - ordered.min("level"))
    return best / best.sum("level"), rank, loss


def _of_levels(study: Study, node: Node) -> list[Coded]:
    """What is to be known of the levels that a question names: averages, and what is beyond the measured."""
    recorded, notes = study.recorded, []
    if isinstance(node, Choice):
        node = at_level(node, node.column, None, node.position)
    responses = [response for response in node.quantities() if is_response(response, recorded)]
    for response in responses:
        notes += beyond_notes(recorded, moving(condition_of(response, recorded), study.law.gravity))
    for response in responses:
        columns = [level.column for level in response.levels]
        notes += average_notes(recorded, responses_of(response.name, recorded), columns)
        if response.name in OUTCOMES and response not in searched(node):
            notes += study.deeper_at(list(filter(study.holds, conditions_of(response, recorded))))
    return list(dict.fromkeys(notes))


def _before(
    study: Study, node: Node, values: Callable[[Study], xr.DataArray]
) -> tuple[xr.DataArray | None, str]:
    """The values in draws from the prior alone, or why there are none."""
    if study.prior is None:
        return None, Coded.stated("no-prior.run")
    draws = study.prior
    if isinstance(node, Critical):
        most = max(SETTINGS.tried_before // draws.sizes["chain"], 1)
        draws = draws.isel(draw=slice(None, None, -(-draws.sizes["draw"] // most)))
    try:
        return values(replace(study, draws=draws)), ""
    except KeyError:
        known = {str(name) for name in study.prior.data_vars}
        lacking = [q.name for q in node.quantities() if q.name not in (*known, *study.recorded.formulas)]
        which = ", ".join(dict.fromkeys(lacking)) or "it"
        return None, Coded.stated("no-prior.draws", which=which)
    except QuestionError as slip:
        return None, Coded.stated("no-prior.slip", slip=slip.actual)


def _beyond_fastest(study: Study, node: Critical, posterior: xr.DataArray) -> str:
    """That a claim holds beyond the velocities that were measured, where its element's law is drawn out."""
    fastest = float(study.recorded.rows.get("velocity_m_s", pd.Series(dtype=float)).max())
    measured = fall_height(fastest) if node.column == DROP_HEIGHT else fastest
    share = float((posterior > measured).mean())
    limit = f"{general(float(measured))} {MOTION[node.column][1]}"
    return Coded.stated("beyond-measured.draws", percent=100 * share, limit=limit) if share else ""


def _probability(claim: xr.DataArray) -> tuple[float, float, float]:
    """The share of true draws, its Monte Carlo standard error, and the effective sample size.

    Where all draws agree, the error is that of one more draw which does not.
    """
    draws = claim.transpose("chain", "draw").to_numpy().astype(float)[None]
    p, count = float(draws.mean()), draws.size
    size = float(effective_size(draws)[0])
    if not 0 < p < 1:
        size = float(count)
        q = 1 / (count + 2)
        return p, float(np.sqrt(q * (1 - q) / count)), size
    return p, float(draws.std(ddof=1) / np.sqrt(size)), size


def _bayes_factor(p: float, size: float, p_0: float, size_0: float) -> tuple[float, str]:
    """Posterior over prior odds, or nothing and why."""
    if min(p_0, 1 - p_0) * size_0 < FEWEST:
        return np.nan, Coded.stated("too-few-draws.prior", value="true" if p_0 > 0.5 else "false")
    odds_0 = p_0 / (1 - p_0)
    few = FEWEST / size
    if min(p, 1 - p) < few:
        bound = (1 - few) / few
        words = f"above {_short(bound / odds_0)}" if p > 0.5 else f"below {_short(1 / bound / odds_0)}"
        return np.nan, Coded.stated("too-few-draws.posterior", bound=words)
    return p / (1 - p) / odds_0, ""


def _short(value: float) -> str:
    """Two digits and no exponent where one can be avoided."""
    return f"{float(f'{value:.2g}'):g}"


def _interval(values: xr.DataArray) -> dict[str, float]:
    draws = values.transpose("chain", "draw").to_numpy()
    return {name: float(end) for name, end in interval(values).items()} | {"mcse": _error_of_median(draws)}


def _error_of_median(draws: np.ndarray) -> float:
    """Half the distance of the quantiles that are one standard error of their rank about the median.

    As ArviZ has it: Beta(S/2 + 1, S/2 + 1) quantiles of the effective size S of the indicator (Vehtari et al.
    2021).
    """
    from scipy.stats import beta

    size = float(effective_size((draws <= np.median(draws)).astype(float)[None])[0])
    if not np.isfinite(size):
        return np.nan
    ends = np.asarray(beta.ppf([0.1586553, 0.8413447], size / 2 + 1, size / 2 + 1)) * draws.size - 1
    ordered = np.sort(draws, axis=None)
    low, high = ordered[int(max(ends[0], 0))], ordered[int(np.ceil(ends[1]))]
    return 0.0 if low == high else float(high - low) / 2
