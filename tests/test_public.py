"""What `import bayestissue as bt` offers: right digits whatever JAX was set to, and names that pickle."""

from __future__ import annotations

import json
import os
import pickle
import pydoc
import subprocess
import sys
import threading
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.resources import shared
from bayestissue.studies import fitting

pytestmark = pytest.mark.slow

# 1 - phi1 - phi2 is 4e-5 here: rounding errors of 1e-16 come out 1e5 times larger, and in a fit more so.
ROUNDING = 1e-9
SERIES = np.cumsum(np.cumsum(np.random.default_rng(1).normal(size=40)))
CALLS = """
import json, sys
import bayestissue as bt
import jax, numpy as np

found = {"before": jax.config.jax_enable_x64}
for state in ("as it was", "on"):
    if state == "on":
        jax.config.update("jax_enable_x64", True)
    phi1, phi2, theta1 = bt.to_discrete(60.0, 0.2, 1e-4)
    omega_n, zeta = bt.to_continuous(phi1, phi2, theta1, 1e-4)
    density = bt.arma21_log_likelihood(np.array(json.loads(sys.argv[2])), 1.9, -0.95, 0.3, 1.0)
    told = {
        "differences": [float(2 - phi1), float(1 - phi1 - phi2)],
        "there_and_back": [float(omega_n), float(zeta)],
        "spring_damper": [float(value) for value in bt.spring_damper(60.0, 0.2, 0.1)],
        "likelihood": float(density),
        "dtypes": sorted({str(value.dtype) for value in (phi1, phi2, theta1, omega_n, zeta)}),
    }
    table = bt.estimate(bt.read_dataset(sys.argv[1]))
    told["estimates"] = table.to_csv(index=False)
    plan = bt.plan(people=[6], masses_kg=[0.5, 1.0], ask={"sure": "mass_exponent_K < 0.5"}, studies=100)
    told["plan"] = plan.designs.drop(columns="minutes", errors="ignore").to_csv(index=False)
    told["after"] = jax.config.jax_enable_x64
    assert table["K_N_per_m"].notna().all()
    found[state] = told
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def some_impacts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four impacts of the example, of which several had no likelihood in float32."""
    whole, some = bt.read_dataset(shared("data", "example")), [0, 3, 6, 8]
    impacts = whole.impacts.iloc[some].reset_index(drop=True)
    few = replace(whole, impacts=impacts, traces=[whole.traces[n] for n in some])
    return few.write(tmp_path_factory.mktemp("some") / "impacts")


@pytest.fixture(scope="module")
def in_a_fresh_interpreter(some_impacts: Path) -> dict:
    environment = {name: value for name, value in os.environ.items() if name != "JAX_ENABLE_X64"}
    command = [sys.executable, "-c", CALLS, str(some_impacts), json.dumps(SERIES.tolist())]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)  # noqa: S603
    assert done.stderr == ""
    return json.loads(done.stdout)


@pytest.mark.parametrize("state", ["as it was", "on"])
def test_every_function_answers_in_float64(in_a_fresh_interpreter, state):
    assert in_a_fresh_interpreter["before"] is False
    told = in_a_fresh_interpreter[state]
    assert told["after"] is (state == "on")
    for table in ("estimates", "plan"):
        assert told[table] == in_a_fresh_interpreter["on"][table]
    assert told["dtypes"] == ["float64"]
    # With w = 60 * 1e-4: expansions of 2 - phi1 and of 1 - phi1 - phi2, their next terms of w^3 bounded.
    w = 60e-4
    assert told["differences"] == pytest.approx([0.4 * w, w**2], abs=2 * w**2)
    assert told["there_and_back"] == pytest.approx([60.0, 0.2], rel=ROUNDING)
    assert told["spring_damper"] == pytest.approx([360.0, 2.4], rel=1e-15)
    with jax.enable_x64(True):
        expected = float(bt.arma21_log_likelihood(SERIES, 1.9, -0.95, 0.3, 1.0))
    assert told["likelihood"] == pytest.approx(expected, rel=1e-12)


def test_a_transformation_in_float32_is_refused_and_in_float64_is_right():
    def there_and_back(w):
        return bt.to_continuous(*bt.to_discrete(w, 0.2, 1e-4), 1e-4)[0]

    with jax.enable_x64(False):
        for transformed in (jax.jit, jax.grad, jax.vmap):
            with pytest.raises(TypeError, match=r"to_discrete.*float32; expected float64.*enable_x64"):
                transformed(there_and_back)(jnp.full(3, 60.0) if transformed is jax.vmap else 60.0)
        with jax.enable_x64(True):
            slope = jax.jit(jax.value_and_grad(there_and_back))(60.0)
            many = jax.vmap(lambda w: bt.spring_damper(w, 0.2, 0.1)[0])(jnp.array([60.0, 70.0]))
        assert not jax.config.jax_enable_x64
    assert np.asarray(slope) == pytest.approx([60.0, 1.0], rel=ROUNDING)
    assert np.asarray(many) == pytest.approx([360.0, 490.0], rel=1e-15)


def test_a_fit_is_in_float64_and_other_threads_keep_their_setting(some_impacts, monkeypatch):
    seen = {}

    def prepare(*_, **__):
        seen["here"] = jnp.zeros(1).dtype
        other = threading.Thread(target=lambda: seen.update(there=jax.config.jax_enable_x64))
        other.start()
        other.join()
        raise bt.InputError(())

    monkeypatch.setattr(fitting, "prepare_without_phantoms", prepare)
    dataset = bt.read_dataset(some_impacts)
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(bt.InputError):
            bt.fit(dataset, "impact")
        assert not jax.config.jax_enable_x64
    finally:
        jax.config.update("jax_enable_x64", True)
    assert seen == {"here": np.float64, "there": False}


@pytest.mark.parametrize("kind", [list, pd.Series])
def test_whatever_is_like_an_array_is_an_argument(kind):
    phi1, phi2, theta1 = bt.to_discrete(kind([60.0, 70.0]), 0.2, dt=1e-4)
    omega_n, zeta = bt.to_continuous(
        *(kind(np.asarray(each).tolist()) for each in (phi1, phi2, theta1)), 1e-4
    )
    np.testing.assert_allclose(omega_n, [60.0, 70.0], ROUNDING)
    np.testing.assert_allclose(bt.spring_damper(omega_n, zeta, kind([0.1, 0.1]))[0], [360.0, 490.0], ROUNDING)


def test_what_is_public_and_no_more_is_listed() -> None:
    assert dir(bt) == sorted([*bt.__all__, "__version__"])
    assert bt.__version__ == version("bayestissue")
    shown = pydoc.plain(pydoc.render_doc(bt.dataset))
    assert "\ndataset(impacts: " in shown
    for name in bt.__all__:
        assert pickle.loads(pickle.dumps(getattr(bt, name))) is getattr(bt, name), name  # noqa: S301
