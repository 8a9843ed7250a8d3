from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from bayestissue import runtime
from bayestissue.dataset import read_dataset
from bayestissue.fitting import resolve
from bayestissue.hierarchy.specification import Sampler
from bayestissue.hierarchy.trace_data import prepare
from bayestissue.inference.execution import ahead
from bayestissue.inference.execution.compiling import Helper
from bayestissue.resources import shared

EXAMPLE = shared("data", "published").parent / "example"
# Two of a chain, three of the correction, one of the choice, one that maps draws back, two of the
# predictions.
FUNCTIONS = 8
# The likelihood's values and the population at a draw, which this process asks for before all else.
OF_THE_SUMMARIES = 2
FIT = """
import sys
from collections import Counter
from pathlib import Path
from bayestissue import runtime
runtime.keep_compiled()
runtime.configure(one_core=True)
from jax import monitoring
from bayestissue.dataset import read_dataset
from bayestissue.fitting import resolve
from bayestissue.hierarchy.trace_data import prepare
from bayestissue.inference.execution import ahead
from bayestissue.inference.fit import fit_traces

found = Counter()
while_waiting = []
lowered_functions = ahead.lowered_functions


def counted(*arguments, **named):
    for lowered in lowered_functions(*arguments, **named):
        while_waiting.append(lowered)
        yield lowered


ahead.lowered_functions = counted
monitoring.register_event_listener(lambda event, **_: found.update([event]))
specification, source = resolve(sys.argv[1])
prepared = prepare(read_dataset(Path(sys.argv[2])), specification, source=source)
fit_traces(prepared, specification, 0, lambda *_: None)
print(found["/jax/compilation_cache/cache_hits"] + len(while_waiting))
"""


def test_without_a_folder_nothing_is_compiled_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "compiled_folder", lambda: None)
    with ahead.second_process(None, Sampler()) as helper:  # type: ignore[arg-type]
        assert type(helper) is Helper


@pytest.mark.long
@pytest.mark.parametrize("model", ["arma", "a2", "impact"])
def test_what_was_compiled_ahead_is_what_the_fit_asks_for(
    model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "compiled"))
    made = subprocess.run(  # noqa: S603 - our own program
        [sys.executable, "-c", FIT, model, str(EXAMPLE)], capture_output=True, text=True, check=True
    )
    assert int(made.stdout) >= FUNCTIONS - OF_THE_SUMMARIES


@pytest.mark.parametrize("model", ["arma", "a2", "impact"])
def test_every_part_can_be_made_from_shapes_alone(model: str) -> None:
    """A worker's error costs time only, and nobody would hear of it."""
    specification, source = resolve(model)
    prepared = prepare(read_dataset(EXAMPLE), specification, source=source)
    job = ahead.Job.of(prepared, specification.sampler)
    for profiled in (model == "arma", True):
        made = [
            lowered
            for part in ahead.PARTS
            for lowered in ahead.lowered_functions(part, job, profiled=profiled)
        ]
        assert len(made) == FUNCTIONS
