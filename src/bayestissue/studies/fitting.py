"""The fit of recorded traces, from a dataset and a model to what a run folder holds."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base import resources, runtime
from bayestissue.base.errors import Coded, InputError, Problem, refuse
from bayestissue.base.result import Say, silent
from bayestissue.base.results.tables import typed
from bayestissue.base.settings import read_text
from bayestissue.base.words import Words
from bayestissue.inference.answers.reliability import agreement
from bayestissue.inference.chain.results import ChainEnd
from bayestissue.inference.checking import model_form
from bayestissue.inference.checking.findings import (
    doubts_in_words,
    headline,
    noted,
    remarks,
    verdict_in_words,
    warnings,
)
from bayestissue.inference.checking.mass_checks import judge_force, judge_reference
from bayestissue.inference.checking.measuring_chain import common_gain, judge
from bayestissue.inference.checking.recording_warnings import (
    clipped_recordings,
    contradicted_velocity,
    flagged_recordings,
    judge_peaks,
    unused_channels,
)
from bayestissue.inference.factors.expansions import expanded
from bayestissue.inference.fit import Beginning, ChainJob, TraceAnalysis, fit_traces
from bayestissue.inference.points.notes import ANOTHER_VELOCITY
from bayestissue.inference.results.meanings import COLUMNS, symbols
from bayestissue.inference.single.phantoms import prepare_without_phantoms
from bayestissue.model.hierarchy.columns import untried
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.specification import Formulas, ModelSpecification, specification_of
from bayestissue.model.hierarchy.trace_data import (
    KINDS,
    Prepared,
    assemble,
    named_model,
    prepare,
    too_short,
    with_discrepancy,
)
from bayestissue.recordings.dataset.left_out import reason_of
from bayestissue.studies.finished import Fit, read_run

if TYPE_CHECKING:
    from bayestissue.recordings.dataset import Dataset

type Model = str | Path | Mapping[str, Any] | ModelSpecification
type Questions = str | Sequence[str] | Mapping[str, str]
# With so many impacts to look for spoilt recordings takes as long as the fit.
_MANY = 5000
# Remarks that the first screen of a page has elsewhere.
_ELSEWHERE = ("flagged-recordings", "prior-sensitive")


def fit(
    dataset: Dataset | str | Path,
    model: Model | None = None,
    seed: int = 0,
    *,
    K: str | None = None,
    C: str | None = None,
    ask: str | Sequence[str] | Mapping[str, str] = (),
    continue_from: Fit | str | Path | None = None,
    say: Say | None = None,
) -> Fit:
    """The posterior of K and C of every impact, person and condition, and of the mass exponents.

    log K and log C of all impacts are modelled jointly with the errors of the measuring chain that the
    dataset states; see the commented model files. Chains run side by side, as many as this process may use
    cores; how many changes no number.

    Args:
        dataset: as `bayestissue.read_dataset` returns it, or its folder.
        model: the name of a model that comes with the program, such as "impact" or "maxwell"; the path of
            your own file; what such a file holds, as a dict; or a `ModelSpecification`. "impact" of recorded
            decelerations and accelerations and "arma" of displacements unless given.
        seed: same seed, same machine: same numbers. A whole number from 0.
        K: what log K depends on, in the notation of R, such as "side + (1|subject)"; as the model has it
            unless given.
        C: the same of log C; that of ``K`` unless given.
        ask: questions, as `Fit.ask` takes them, beside those of the model; a dict names them.
        continue_from: a fit, or the folder of a run, of the same recordings and model: its chains go on where
            they ended, without a warm-up, until there are draws enough, and the draws are the new ones. Of
            the model, what ``[sampler]`` says of draws may be another, and the questions.
        say: told the stage, how much of it is done, and its total.

    Returns:
        The fit: ``.summary`` (a row a quantity: median, 90 % interval, R-hat), ``.posterior`` (all draws, as
        ArviZ has them), ``.questions``, ``.contrasts``, ``.verdict``, and the methods ``.ask(question)``,
        ``.predict(table)``, ``.report(folder)``.

    Raises:
        InputError: the model is wrong, or asks for what these recordings can't tell; the seed is none;
            ``continue_from`` is of something else.

    Example:
        >>> fit = bt.fit("drops", K="log(mass_kg) + side + (1|subject)", ask="K[side=left] > K[side=right]")
        >>> fit.questions[["question", "posterior"]]
        >>> fit.report("runs/drops")
    """
    from bayestissue.recordings.dataset import as_dataset

    seed, recorded = _checked_seed(seed), as_dataset(dataset)
    with _set_up():
        request = FitRequest(model, K, C, ask, continue_from)
        return fit_job(recorded, request, seed).fit(say or silent)


class FitRequest(NamedTuple):
    """What is to be fitted to recordings: arguments of `fit`, and options of the command."""

    model: Model | None = None
    K: str | None = None
    C: str | None = None
    ask: Questions = ()
    continue_from: Fit | str | Path | None = None


def fit_job(
    dataset: Dataset,
    request: FitRequest,
    seed: int,
    *,
    skip_short: bool = False,
    resolved: Callable[[ModelSpecification], None] = lambda _: None,
) -> FitJob:
    """All steps of `fit` before the work, in their order.

    Args:
        dataset: what is fitted.
        request: the model, its formulas and questions, and a run of the same.
        seed: of all draws.
        skip_short: leave out impacts of too few samples, which are refused else.
        resolved: told the model, before it meets the data.

    Raises:
        InputError: as of `fit`.
    """
    model, K, C, ask, continue_from = request
    specification, source = resolve(model, dataset.quantity, formulas=formulas_of(K, C), questions=ask)
    resolved(specification)
    run = continue_from if isinstance(continue_from, Fit | None) else read_run(continue_from)
    if run is not None and (rival := run.diagnostics.get("another_element")):
        # The earlier run was led to another element: this one goes on with that.
        specification = model_form.stiffening_by(specification, rival["formula"]) or specification
    if skip_short:
        dataset = without_short(dataset, specification, source)
    dataset, prepared = prepare_without_phantoms(dataset, specification, source=source)
    require_answerable(prepared, specification, source)
    job = FitJob(dataset, specification, prepared, seed)
    if run is None:
        return job
    return replace(
        job, earlier=job.earlier_run(run, "continue_from" if run is continue_from else str(continue_from))
    )


def numpyro_model(
    dataset: Dataset | str | Path, model: Model | None = None, *, K: str | None = None, C: str | None = None
) -> Callable[[], None]:
    """The model that `fit` draws from, for numpyro's own samplers: ``MCMC(NUTS(bt.numpyro_model(dataset)))``.

    Its posterior is the one that `fit` has, and its sites have the names of ``posterior.nc``: standard
    deviations are sampled by name, and effects, K and C of every impact follow from ``locations`` and
    ``log_K_and_C``. It is not the way to fit many impacts, whose likelihoods have gradients that are dear.

    Args:
        dataset: as of `fit`.
        model: as of `fit`; a discrepancy that the file leaves to the program is left out.
        K: as of `fit`.
        C: as of `fit`.

    Returns:
        What `numpyro.infer.MCMC`, `Predictive` and `log_density` take, without arguments. It needs double
        precision: call ``numpyro.enable_x64()`` first.

    Raises:
        InputError: as of `fit`.
    """
    from bayestissue.recordings.dataset import as_dataset

    dataset = as_dataset(dataset)
    specification, source = resolve(model, dataset.quantity, formulas=formulas_of(K, C))
    _, prepared = prepare_without_phantoms(dataset, specification, source=source)
    return named_model(prepared)


def _checked_seed(seed: Any) -> int:
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool) and 0 <= seed <= runtime.MOST_SEED:
        return int(seed)
    raise InputError.stated(
        "option-value.seed", "arguments", column="seed", value=seed, most=runtime.MOST_SEED
    )


def formulas_of(K: str | None, C: str | None) -> dict[str, str]:
    """The formulas that are given, by response; that of K is C's too, where C has none."""
    for name, formula in (("K", K), ("C", C)):
        if not isinstance(formula, str | None):
            raise InputError.of_argument(name, formula, "a formula as text, such as 'side + (1|subject)'")
    return {q: formula for q, formula in (("K", K), ("C", K if C is None else C)) if formula is not None}


def named_questions(questions: Questions) -> Mapping[str, str]:
    """Questions by their names; those without are question_1 and so on."""
    texts = [questions] if isinstance(questions, str) else questions
    if isinstance(texts, Mapping):
        return texts
    return {f"question_{number}": text for number, text in enumerate(texts, start=1)}


def default_model(quantity: str) -> str:
    """The model of a recorded quantity: decelerations of either sign, or displacements."""
    return "arma" if quantity == "displacement" else "impact"


def resolve(
    model: Model | None,
    quantity: str = "deceleration",
    *,
    formulas: Mapping[str, str] = MappingProxyType({}),
    questions: Questions = (),
) -> tuple[ModelSpecification, str]:
    """The model that a name, a path, a dict or a specification stands for, and what messages call it.

    Args:
        model: any of these; `default_model` of the ``quantity`` where None.
        quantity: what was recorded, as `Dataset.quantity` has it.
        formulas: in place of the model's own, by response.
        questions: beside the model's own; as of `named_questions`.

    Raises:
        InputError: there is no such model or file (see `resources.model_file`), or it is wrong.
    """
    tables = {"formula": formulas, "questions": named_questions(questions)}
    if isinstance(model, ModelSpecification) and not any(tables.values()):
        return model, f"model {model.name}"
    content, source, text = _content(model, quantity, formulas)
    completed = content | {key: {**content.get(key, {}), **table} for key, table in tables.items() if table}
    return specification_of(completed, source, text=text), source


def _content(
    model: Model | None, quantity: str, formulas: Mapping[str, str]
) -> tuple[dict[str, Any], str, str]:
    """What a model's file would hold, what messages call it, and its text."""
    if isinstance(model, ModelSpecification):
        content = model.model_dump(mode="json", exclude_unset=True)
        # Priors that were filled in are of its own formulas.
        terms = Formulas(**{**dict(model.formula), **formulas}).group_terms()
        keys = {f"{term.slope}|{term.grouping}" if term.slope else term.grouping for term in terms}
        for name in {"sd_group", "sd_slope"} & set(content.get("priors", {})):
            priors = content["priors"][name]
            content["priors"][name] = {key: priors[key] for key in priors if key in keys}
        return content, f"model {model.name}", ""
    if isinstance(model, Mapping):
        return resources.with_base(model, "model"), "model", ""
    named = default_model(quantity) if model is None else model
    path = resources.model_file(named, lambda content: content.get("likelihood") in KINDS)
    return resources.model_content(path), str(path), read_text(path, str(path))


def without_short(dataset: Dataset, specification: ModelSpecification, source: str) -> Dataset:
    """The dataset less the impacts of too few samples, which are told as left out; all of them stay."""
    from bayestissue.recordings.signal import displacements

    problems = too_short(dataset, displacements(dataset, specification.signal), source)
    short = {problem.impact for problem in problems}
    long_enough = ~dataset.impacts["impact"].isin(short).to_numpy()
    if not problems or not long_enough.any():
        return dataset
    return replace(dataset.select(long_enough), left_out=(*dataset.left_out, *problems))


def require_answerable(prepared: Prepared, specification: ModelSpecification, source: str) -> None:
    """Raise an `InputError` of every question of the model file that can't be read or fits no such data."""
    if not specification.questions:
        return
    from bayestissue.inference.answers.questions import of_model, require_readable
    from bayestissue.inference.answers.study import Study

    require_readable(of_model(specification.questions, source), Study(xr.Dataset(), prepared.design.recorded))


class EarlierRun(NamedTuple):
    """A run of the same recordings and model, to go on with.

    Attributes:
        end: where its chains ended.
        form: of a second fit with a discrepancy what the first said of the model's form, else nothing.
        element: of one with another element why it has it, else nothing.
    """

    end: ChainEnd | None
    form: dict[str, Any]
    element: dict[str, Any]


def _of_the_chains(model: dict[str, Any]) -> dict[str, Any]:
    """Of a model what may not be another in a run that goes on."""
    free = {"name", "description", "questions", "practical_equivalence", "comparison", "sampler"}
    fixed = {key: value for key, value in model.items() if key not in free}
    return fixed | {"sampler.chains": model.get("sampler", {}).get("chains")}


@dataclass(frozen=True, eq=False)
class FitJob:
    """A fit in which all that can be wrong was looked for, and nothing was sampled.

    Attributes:
        dataset: what is fitted.
        specification: the model file.
        prepared: the two as the sampler takes them.
        seed: of all draws.
        earlier: a run whose chains go on.
        say: told the stage, how much of it is done, and its total.
        checkpoints: a folder for finished parts, see `ChainJob`; none are kept without.
    """

    dataset: Dataset
    specification: ModelSpecification
    prepared: Prepared
    seed: int
    earlier: EarlierRun | None = None
    say: Say = silent
    checkpoints: Path | None = None

    def earlier_run(self, run: Fit, source: str = "continue_from") -> EarlierRun:
        """The run that this fit is to go on with, which messages call ``source``.

        Raises:
            InputError: it is no finished fit, its chains were not kept, or it is of other recordings or
                another model: every difference.
        """
        model = self.specification.model_dump(mode="json") | self.prepared.design.resolved()
        # As JSON has it, like what was read.
        here, there = (_of_the_chains(one) for one in (json.loads(json.dumps(model)), run.about["model"]))
        problems = [
            Problem.stated("another-run.model", source, None, key, here.get(key), there=there.get(key))
            for key in sorted(here.keys() | there.keys())
            if here.get(key) != there.get(key)
        ]
        if run.about.get("input_hash") != self.dataset.input_hash:
            where = source, None, "input_hash", self.dataset.name
            problems.append(Problem.stated("another-run.recordings", *where))
        refuse(problems)
        form = run.diagnostics["model_form"] if "score_without" in run.about.get("discrepancy", {}) else {}
        return EarlierRun(run.chain_end(), form, run.diagnostics.get("another_element", {}))

    def fit(self, say: Say = silent, checkpoints: Path | None = None) -> Fit:
        """Sample and label.

        Where the residuals are plainly structured and the model file leaves it to the program, a second fit
        with a discrepancy follows, and is the one that is told; the first is not finished if its best fits
        show it. Before that a stiffening spring is tried, where they are so at some levels of a factor alone.
        Chains go on from those of an ``earlier`` run of the same; if that was a second fit, so is this one.
        float64 must be set.
        """
        start = runtime.CommandStart()
        say("summarising each trace", 0, 1)
        plain = self._without_discrepancy()
        expansions = expanded(plain)
        job, analysis = replace(self, say=say, checkpoints=checkpoints)._first_or_second(expansions)
        points, flags = _points_and_flags(job)
        log_gain = common_gain(plain, analysis.tree)
        chain = judge(plain, expansions, log_gain) if job.dataset.quantity != "displacement" else {}
        diagnostics = analysis.diagnostics | job._of_recordings(analysis, flags, chain)
        tables = analysis.tables | {"summary": noted(analysis.summary, diagnostics)}
        analysis = replace(analysis, diagnostics=diagnostics, tables=tables)
        return job.finished(analysis, points, (start.time, start.seconds))

    def _without_discrepancy(self) -> Prepared:
        """The same without the discrepancy, which would take up what the measuring chain does."""
        if not self.prepared.model.discrepancy:
            return self.prepared
        without = self.specification.model_copy(update={"discrepancy": "none"})
        return assemble(self.dataset, without, self.prepared.design, self.prepared.signal)

    def _sampled(self, beginning: Beginning) -> TraceAnalysis:
        job = ChainJob(self.prepared, self.specification.sampler, self.seed, self.say, self.checkpoints)
        return fit_traces(job, self.specification, beginning)

    def _again(self, words: str, prepared: Prepared) -> FitJob:
        """A second fit, its stages told and its checkpoints kept apart from those of the first."""
        parts = self.checkpoints and self.checkpoints / words.split()[-1]
        if parts is not None:
            parts.mkdir(exist_ok=True)

        def say(stage: str, done: int, total: int) -> None:
            self.say(f"again with {words}: {stage}", done, total)

        return replace(self, prepared=prepared, say=say, checkpoints=parts)

    def _first_or_second(self, expansions: GaussianFactor) -> tuple[FitJob, TraceAnalysis]:
        """The fit as the model file has it, or another that it leads to, with its model; see `fit`."""
        end, form, rival = self.earlier or EarlierRun(None, {}, {})
        start, took = runtime.CommandStart(), ""
        alone, may_add = not self.prepared.model.discrepancy, self.specification.may_add_discrepancy
        if self.earlier is None and may_add and alone:
            form = model_form.misfit_precheck(self.prepared, expansions, self.seed) or {}
        if not form:
            first = self._sampled(end or (expansions if alone else None))
            form, end = first.diagnostics.get("model_form", {}), None
            if not (may_add and form.get("structured", False)):
                return self, _with_element(first, rival)
            took = f", which took {max(start.seconds, 1):.0f} s"
            if (tried := self._another_element(form, took)) is not None:
                return tried
        if self.earlier is None:
            words = "the traces obey another law than the model's: a second fit begins, with a discrepancy"
            self.say(f"{words}; it may take several times as long as the first{took}", 1, 1)
        wider = self._again(
            "a discrepancy", with_discrepancy(self.dataset, self.specification, self.prepared)
        )
        second = wider._sampled(end)
        of_both = model_form.with_discrepancy(form, second.tree)
        of_both |= {"impacts": second.diagnostics.get("model_form", {}).get("impacts", {})}
        return wider, replace(second, diagnostics=second.diagnostics | {"model_form": of_both})

    def _another_element(self, form: dict[str, Any], took: str) -> tuple[FitJob, TraceAnalysis] | None:
        """The fit of a spring that stiffens; None where nothing speaks for it, or it explains less."""
        names = self.prepared.impacts["impact"].astype(str).to_numpy()
        rival = model_form.instead(form, names, self.prepared.design.recorded)
        stiffens = model_form.stiffening_by(self.specification, rival["formula"]) if rival else None
        if stiffens is None:
            return None
        words = f"a stiffening spring is tried, by {rival['formula']}"
        self.say(f"{words}: a second fit, as long as the first{took}", 1, 1)
        try:
            of_spring = prepare(self.dataset, stiffens, source="model")
        except InputError:
            return None
        of_spring = replace(of_spring, reference=self.prepared.reference)
        job = replace(self._again("a stiffening spring", of_spring), specification=stiffens)
        second = job._sampled(None)
        return (job, _with_element(second, rival)) if model_form.explains(second.diagnostics) else None

    def _of_recordings(
        self, analysis: TraceAnalysis, flags: list[list[Coded]], chain: dict[str, Any]
    ) -> dict[str, Any]:
        """What recordings add to ``diagnostics.json``: entries beside, or in place of, those of the draws.

        Args:
            analysis: the results.
            flags: what is wrong with the recording of each impact.
            chain: what the traces say of their measuring chain.
        """
        prepared, form = self.prepared, analysis.diagnostics.get("model_form")
        names, limited = prepared.impacts["impact"].astype(str).tolist(), prepared.signal.limited
        # Tissue that is taken along at contact leaves the impactor another velocity than the stated one.
        if "added_mass" in analysis.diagnostics:
            flags = [[flag for flag in of_one if flag != ANOTHER_VELOCITY] for of_one in flags]
        entries = {
            "measuring_chain": chain,
            "model_form": form and model_form.stated(form, chain),
            "rows": form and model_form.marked_rows(form),
            "recorded_peak": judge_peaks(self.dataset, prepared, analysis.summary),
            "recordings": flagged_recordings(names, flags),
            "velocity": contradicted_velocity(flags, chain),
            "clipped": clipped_recordings(names, limited.tolist()),
            "channels": _of_channels(self.dataset, prepared, analysis),
            "reference": prepared.reference and judge_reference(prepared.reference),
        }
        return {name: entry for name, entry in entries.items() if entry}

    def finished(self, analysis: TraceAnalysis, points: pd.DataFrame, clock: tuple[datetime, float]) -> Fit:
        """A fit of all that its run folder holds.

        Args:
            analysis: the results.
            points: the table of the thesis's method.
            clock: when the fit began, and how many seconds it took.
        """
        further = {"estimates_dds": points, "agreement": _agreement(points, analysis.summary)}
        tables = {name: typed(name, table) for name, table in (analysis.tables | further).items()}
        fit = Fit(
            runtime.run_record("fit", "fit", *clock, **self._provenance(analysis)),
            analysis.tree,
            analysis.diagnostics,
            tables.__getitem__,
            self.dataset.folder,
            self.dataset,
            self.prepared,
            analysis.end,
        )
        if self.specification.questions:
            from bayestissue.inference.answers.questions import ask_what_can_be, of_model

            questions = of_model(self.specification.questions, "model")
            tables["questions"] = typed("questions", ask_what_can_be(fit.study, questions))
        return fit

    def _provenance(self, analysis: TraceAnalysis) -> dict[str, Any]:
        """What ``run.json`` says of the fit itself."""
        data, prepared, diagnostics = self.dataset, self.prepared, analysis.diagnostics
        nouns, sizes = Words(data.words), analysis.tree["posterior"].sizes
        return {
            "dataset": data.name,
            "description": data.description,
            "quantity": data.quantity,
            "words": dict(data.words),
            **({"site": data.site} if data.site else {}),
            "model": self.specification.model_dump(mode="json") | prepared.design.resolved(),
            "terms_left_out": prepared.design.terms_left_out(),
            "columns_not_used": untried(prepared.design.recorded),
            "uncertainty": vars(data.uncertainty),
            "contact": prepared.signal.phase.words,
            "left_out": [str(problem) for problem in data.left_out],
            "exclusions": [{"impact": p.impact, "reason": reason_of(p)} for p in data.left_out],
            "seed": self.seed,
            "input_hash": data.input_hash,
            **({"whole_hash": data.whole_hash} if data.whole_hash else {}),
            # Of many impacts there are fewer draws of a single one.
            **(
                {"kept_draws_of_an_impact": sizes["chain"] * sizes["kept_draw"]}
                if "kept_draw" in sizes
                else {}
            ),
            **self._discrepancy(analysis),
            "route": diagnostics.get("route", {}),
            "verdict": {
                "passed": diagnostics["passed"],
                "headline": nouns(headline(diagnostics)),
                "words": nouns(verdict_in_words(diagnostics)),
                "doubts": nouns(doubts_in_words(diagnostics)),
                "warned": bool(warnings(diagnostics)),
                # What is not wrong, but should be known beside a verdict that passed.
                "remarks": nouns(remarks(diagnostics, _ELSEWHERE)),
            },
        }

    def _discrepancy(self, analysis: TraceAnalysis) -> dict[str, Any]:
        """Of a fit with a discrepancy: its rms as a fraction of the peak, and why the program added it."""
        if not self.prepared.model.discrepancy:
            return {}
        discrepancy = {"rms_of_peak": float(analysis.tree["posterior"].dataset["discrepancy"].median())}
        if self.specification.discrepancy == "automatic":
            discrepancy["score_without"] = analysis.diagnostics["model_form"]["score"]
        return {"discrepancy": discrepancy}


def _with_element(analysis: TraceAnalysis, rival: dict[str, Any]) -> TraceAnalysis:
    """A fit, with why it has another element than the model file."""
    if not rival:
        return analysis
    return replace(analysis, diagnostics=analysis.diagnostics | {"another_element": rival})


def _of_channels(dataset: Dataset, prepared: Prepared, analysis: TraceAnalysis) -> dict[str, Any]:
    """What a force beside the deceleration says, or why it was not used."""
    if prepared.force:
        posterior, form = analysis.tree["posterior"].dataset, analysis.diagnostics["channels"]["form"]
        return judge_force(prepared.force, posterior, prepared.signal.mass, form)
    return unused_channels(dataset.channels, prepared.force_unused) if dataset.channels else {}


def _agreement(points: pd.DataFrame, summary: pd.DataFrame) -> pd.DataFrame:
    values = {}
    for q, quantity in symbols(set(summary["variable"])).items():
        median = summary[summary["variable"] == quantity].set_index("label")["median"]
        values[quantity] = pd.DataFrame({"dds": points.set_index("impact")[COLUMNS[q]], "posterior": median})
    return agreement(values)


def _points_and_flags(job: FitJob) -> tuple[pd.DataFrame, list[list[Coded]]]:
    """The table of the thesis's method, and what is wrong with the recordings of each impact.

    Of `_MANY` impacts and more, spoilt recordings are left to `check`: to look for them would take as long as
    the fit.
    """
    from bayestissue.inference.points.point_estimates import Inspected, thesis_table
    from bayestissue.recordings.signal import SignalOptions, displacements
    from bayestissue.recordings.signal.quality import inspect

    dataset, options, signal = job.dataset, job.specification.signal, job.prepared.signal
    findings = inspect(dataset, options) if len(dataset.impacts) < _MANY else {}
    of_default = signal if options == SignalOptions() else displacements(dataset)
    of_thesis = thesis_table(Inspected(dataset, displacements(dataset, rule="trapezoidal"), findings))
    return of_thesis, Inspected(dataset, of_default, findings).flags()


@contextmanager
def _set_up() -> Iterator[None]:
    """The numerical libraries as an entry point sets them up, for the length of a block."""
    import scipy.linalg  # noqa: F401 - compiled functions call its BLAS, which must be there to be limited
    from threadpoolctl import threadpool_limits

    runtime.release_compiled()
    # Chains have a thread each; with more for BLAS in each they were measured to take three times as long.
    with threadpool_limits(1), runtime.compiled_kept():
        yield
