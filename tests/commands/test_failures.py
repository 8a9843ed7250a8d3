"""What the world does to a command: one line, a documented status, and nothing lost or left behind."""

from __future__ import annotations

import errno
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue.base.errors import InputError
from bayestissue.base.results.files import write_tree
from bayestissue.base.results.output_folder import claim
from bayestissue.reports.pages.run_folder import read_about
from bayestissue.studies import comparing
from command_line import bayestissue
from make_fit_run import make_scored_run

pytestmark = pytest.mark.slow

MORE = "More: bayestissue explain"
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("runs")
    return [make_scored_run(folder / name, likelihood="a2") for name in ("one", "other")]


def test_the_input_of_a_command_is_never_replaced(runs) -> None:
    before = {path: path.read_bytes() for path in runs[0].iterdir()}
    for out in (runs[0], runs[0].parent):
        refused = bayestissue("compare", *runs, "--out", out, "--overwrite")
        assert (refused.status, "what this command reads" in refused.err) == (2, True)
    assert {path: path.read_bytes() for path in runs[0].iterdir()} == before


def test_a_page_that_fails_leaves_the_results_and_can_be_drawn_again(runs, tmp_path, monkeypatch) -> None:
    out = tmp_path / "comparison"

    def fails(*_: object) -> None:
        raise ValueError("ParseFatalException:\n$x_{1$\n ^")

    with monkeypatch.context() as patched:
        patched.setattr(comparing, "page_of", fails)
        ended = bayestissue("compare", *runs, "--out", out)
    assert ended.status == 4
    assert ended.err == (
        f"the results are in {out}, but their page could not be drawn (ValueError: ParseFatalException: "
        f"$x_{{1$ ^); `bayestissue report {out}` draws the page\n{MORE} page-not-drawn\n"
    )
    assert {path.name for path in out.iterdir()} >= {"comparison.csv", "posteriors.csv", "run.json"}
    assert not (out / "report.html").exists()
    assert bayestissue("report", out).status == 0
    assert (out / "report.html").exists()


def test_a_full_disk_is_one_line_and_leaves_nothing(runs, tmp_path, monkeypatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    out = tmp_path / "deep" / "comparison"
    monkeypatch.setattr(pd.DataFrame, "to_csv", full)
    ended = bayestissue("compare", *runs, "--out", out)
    said = f"could not go on: {out}: No space left on device\n{MORE} machine-failed\n"
    assert (ended.status, ended.err) == (5, said)
    assert list(tmp_path.iterdir()) == []


def test_a_tree_that_has_no_room_is_refused_before_it_is_written(tmp_path: Path) -> None:
    """In a process of its own, which may write no file above a megabyte."""
    program = (
        "import resource, sys, numpy as np, xarray as xr\n"
        "from pathlib import Path\n"
        "from bayestissue.base.results.files import write_tree\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))\n"
        "write_tree(xr.DataTree(xr.Dataset({'K': ('draw', np.zeros(200_000))})), Path(sys.argv[1]))\n"
    )
    path = tmp_path / "posterior.nc"
    ended = subprocess.run(  # noqa: S603 - our own program
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1].startswith("OSError: [Errno 27] File too large")
    assert list(tmp_path.iterdir()) == []
    write_tree(xr.DataTree(xr.Dataset({"K": ("draw", np.zeros(9))})), path)
    assert path.is_file()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_an_output_that_takes_nothing_is_one_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "bayestissue", "explain"]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(  # noqa: S603 - our own program
            command, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert (ended.returncode, ended.stderr) == (
        5,
        f"could not go on: standard output: No space left on device\n{MORE} machine-failed\n",
    )


def test_whoever_has_seen_enough_gets_no_complaint() -> None:
    command = [sys.executable, "-m", "bayestissue", "explain"]
    started = subprocess.Popen(  # noqa: S603 - our own program
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert started.stdout is not None
    started.stdout.close()
    assert started.stderr is not None
    with started.stderr as stream:
        assert stream.read() == ""
    assert started.wait() == 1


def test_a_file_of_a_run_that_was_changed_is_refused_by_its_hash(tmp_path: Path) -> None:
    """By every command that reads a run; a run of an earlier version has no hashes, and is read."""
    run = tmp_path / "run"
    with claim(run, overwrite=False, command="fit") as target, target.folder() as staging:
        shutil.copytree(make_scored_run(tmp_path / "made", likelihood="a2"), staging, dirs_exist_ok=True)
    mark = run / ".bayestissue.json"
    whole = (run / "posterior.nc").read_bytes()
    at = ("--at", run / "summary.csv", "--out", tmp_path / "out")
    # The one is cut short, the other has another byte.
    for spoilt in (whole[: len(whole) // 2], whole[:-5] + bytes([whole[-5] ^ 1]) + whole[-4:]):
        (run / "posterior.nc").write_bytes(spoilt)
        for command in (["report", run], ["ask", run, "K > 0"], ["predict", run, *at], ["open", run]):
            refused = bayestissue(*command)
            assert refused.status == 2, command
            assert "posterior.nc: found" in refused.err
            assert "the bytes that were written" in refused.err
    assert not (tmp_path / "out").exists()
    (run / "posterior.nc").write_bytes(whole)
    assert read_about(run)
    text = (run / "run.json").read_text()
    (run / "run.json").write_text(text.replace("0", "1", 1))
    with pytest.raises(InputError, match="it was edited, or damaged"):
        read_about(run)
    mark.write_text(json.dumps({k: v for k, v in json.loads(mark.read_text()).items() if k != "sha256"}))
    assert read_about(run)


def test_a_cache_that_cannot_be_made_is_done_without(tmp_path: Path) -> None:
    """A file stands where the folder of compiled functions should be."""
    (tmp_path / "file").write_text("")
    program = (
        "from bayestissue.base import runtime\nruntime.keep_compiled()\nruntime.configure()\n"
        "import jax, jax.numpy as jnp\n"
        "print(jax.jit(lambda x: 2 * x)(jnp.ones(3)).sum(), jax.config.jax_compilation_cache_dir)\n"
    )
    ended = subprocess.run(  # noqa: S603 - our own program
        [sys.executable, "-W", "error", "-c", program],
        env={"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "file" / "below"), "PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.stdout, ended.stderr) == ("6.0 None\n", "")
