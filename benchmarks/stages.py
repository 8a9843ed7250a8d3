"""Where the processor's time of a fit goes: seconds of each stage, from the first import to the page.

    taskset -c 0 .venv/bin/python benchmarks/stages.py
    taskset -c 0 .venv/bin/python benchmarks/stages.py data/example models/maxwell.toml

Seconds of the processor in this process, which other work on the machine changes less than the clock's.
A stage that lies within another counts for itself alone, so that the column adds up to the whole. The first
run on a machine compiles as well: run it twice. Last is what a transition of one chain takes with the traces
at a few nodes, as the chains have them, and with all of their samples, in turns.
"""

from __future__ import annotations

import builtins
import functools
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

# By module: the functions that are stages.
STAGES = {
    "inference.chain.run": ("look",),
    "inference.factors.scores": ("log_densities",),
    "inference.quantities.quantity_draws": ("posterior_draws", "prior_draws"),
    "inference.results.tree": ("posterior_tree", "replicates"),
    "inference.fit": (
        "expanded",
        "explanations",
        "cross_validation",
        "prior_sensitivity",
        "summary_table",
        "uncertainty_budget",
        "model_form",
        *("contrasts_table", "coefficients", "as_variables", "reliability"),
        *("levels_table", "loops_table", "curves_table"),
    ),
    "studies.fitting": ("judge", "agreement"),
    "base.results.files": ("write_tree",),
    "base.results.tables": ("write_table",),
    "reports.pages.fit.fit_page": ("page_of", "render_page"),
    "reports.pages.fit.study_answers": ("contrasts_table", "reliability_table"),
    "reports.pages.page": ("drawn",),
}
# What a study asks of a fit: comparisons, reliability, agreement of methods, and their part of a page.
STUDY = (
    *("coefficients", "as_variables", "reliability", "agreement"),
    # The name of contrasts' table is that of its part of a page too.
    *STAGES["reports.pages.fit.study_answers"],
)
# Segments of a chain by each way, the first of which compiles.
TURNS = 11
spent: dict[str, float] = {}
with_all_within: dict[str, float] = {}
_within: list[float] = []


def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """``function``, whose processor time, less that of stages within it, is added to ``spent``."""

    @functools.wraps(function)
    def called(*arguments: Any, **named: Any) -> Any:
        begun = time.process_time()
        _within.append(0.0)
        try:
            return function(*arguments, **named)
        finally:
            taken = time.process_time() - begun
            spent[name] = spent.get(name, 0.0) + taken - _within.pop()
            with_all_within[name] = with_all_within.get(name, 0.0) + taken
            if _within:
                _within[-1] += taken

    return called


def _time_imports() -> None:
    bare, deep = builtins.__import__, [False]

    def imported(*arguments: Any, **named: Any) -> Any:
        if deep[0]:
            return bare(*arguments, **named)
        deep[0] = True
        try:
            return timed("imports", bare)(*arguments, **named)
        finally:
            deep[0] = False

    builtins.__import__ = imported  # type: ignore[assignment]


def _time_stages() -> None:
    """Wherever a stage's function has been imported to, the timed one takes its place."""
    import bayestissue.reports.pages.fit.fit_page
    import bayestissue.studies.fitting  # noqa: F401
    from bayestissue.inference.chain.run import Chains

    # Of all threads together.
    Chains.next = timed("chain", Chains.next)  # type: ignore[method-assign]
    wrapped = {}
    for module, names in STAGES.items():
        for name in names:
            function = getattr(sys.modules[f"bayestissue.{module}"], name)
            wrapped[id(function)] = function, timed(name, function)
    for module in [each for name, each in sys.modules.items() if name.startswith("bayestissue")]:
        for name, value in list(vars(module).items()):
            if id(value) in wrapped and wrapped[id(value)][0] is value:
                setattr(module, name, wrapped[id(value)][1])


def of_transitions(dataset: Path, model: str) -> str:
    """Milliseconds of a transition of one chain, at nodes and of all samples, the least of several turns."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from bayestissue.base.impact_arrays import padded_impacts
    from bayestissue.inference.chain.chain_settings import ChainSettings
    from bayestissue.inference.chain.draws import _advanced
    from bayestissue.inference.chain.moves import Kernel
    from bayestissue.inference.chain.target import Target
    from bayestissue.inference.chain.warm_up import begin
    from bayestissue.inference.factors.expansions import expanded
    from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
    from bayestissue.model.hierarchy.specification import read_specification
    from bayestissue.model.hierarchy.trace_data import prepare
    from bayestissue.recordings.dataset import read_dataset

    prepared = prepare(read_dataset(dataset), read_specification(Path(model)), source=model)
    target, settings = Target.from_prepared(prepared), ChainSettings.of_size(len(prepared.impacts))
    if target.compressed is None:
        return "these traces are not compressed"
    sites = padded_impacts(expanded(prepared))
    of_all = GaussianFactor(*(jnp.asarray(leaf)[None] for leaf in sites))
    (carried,), tuning = begin(target, of_all, 1, np.random.default_rng(0))
    key = jax.random.PRNGKey(0)
    ways = {"nodes": target, "all samples": replace(target, compressed=None)}
    least = dict.fromkeys(ways, float("inf"))
    for turn in range(TURNS):
        for name, one in ways.items():
            begun = time.process_time()
            jax.block_until_ready(_advanced(Kernel(one, settings, tuning), carried, key))
            if turn:
                least[name] = min(least[name], (time.process_time() - begun) / settings.segment)
    ratio = least["all samples"] / least["nodes"]
    figures = ", ".join(f"{name} {1e3 * seconds:.3f} ms" for name, seconds in least.items())
    return f"a transition: {figures}, {ratio:.2f} times"


def main(dataset: str = "data/example", model: str = "models/impact.toml") -> None:
    """Fit, and print what each stage took."""
    _time_imports()
    from bayestissue.base import runtime

    runtime.keep_compiled()
    runtime.configure()
    from bayestissue.commands.datasets import fit

    _time_stages()
    with tempfile.TemporaryDirectory() as folder:
        timed("all else", fit)(dataset=Path(dataset), out=Path(folder) / "run", model=model, quiet=True)
    for name, seconds in sorted(spent.items(), key=lambda pair: -pair[1]):
        print(f"{name:26}{seconds:7.2f}")
    print(f"{'together':26}{sum(spent.values()):7.2f}")
    study = sum(with_all_within.get(name, 0.0) for name in STUDY)
    print(f"of that, what a study asks (with figures): {study:.2f}")
    print(of_transitions(Path(dataset), model))


if __name__ == "__main__":
    main(*sys.argv[1:])
