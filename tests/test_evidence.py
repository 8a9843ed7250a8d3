"""Evidence: the registry holds together, staleness is by content, and pages print what the files say."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))
from evidence import (
    figures,
    fingerprint,
    pages,
    provenance,
    references,
    registry,
    running,
    simulations,
    status,
    texts,
)
from evidence.families import intervals, outcomes
from evidence.registry import ROOT, Piece
from evidence.summary import figure
from evidence.texts import Figure

from bayestissue.recordings.signal import displacements

PIECES = list(registry.pieces().values())
# What every script may use without speaking of it: where things lie, and how numbers are held.
ANYWHERE = ("base/runtime.py", "base/resources.py", "recordings/dataset/")
OTHERS = "run `make evidence-pages`, and commit what it writes"


@pytest.mark.parametrize("piece", PIECES, ids=lambda piece: piece.name)
def test_a_piece_names_what_there_is(piece):
    for part in piece.parts():
        assert (ROOT / part.removesuffix("/*")).exists(), part
    assert set(piece.references) <= set(references.SETS)
    assert f"`{piece.name}`" in figure("evidence.provenance").text


@pytest.mark.parametrize("piece", PIECES, ids=lambda piece: piece.name)
def test_a_piece_speaks_of_what_its_scripts_import(piece):
    # The numbers of references.csv stand for the program where a piece names any.
    missing = [] if piece.references else [name for name in imported(piece) if not covered(name, piece)]
    assert not missing, f"{piece.name} of evidence.toml lacks {missing}"


@pytest.mark.parametrize("script", sorted({piece.scripts()[0] for piece in PIECES}))
def test_a_script_finds_all_that_it_imports(script):
    module = importlib.import_module(Path(script).stem)
    assert script in (module.__doc__ or "")
    assert callable(module.main)


def imported(piece: Piece) -> set[Path]:
    """The modules of the program that its scripts import, without those that they lead to."""
    found = set()
    for script in (name for name in piece.scripts() if name.endswith(".py")):
        for node in ast.walk(ast.parse((ROOT / script).read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayestissue"):
                found |= {
                    module(f"{node.module}.{alias.name}") or module(node.module) for alias in node.names
                }
    return {path for path in found if path}


def module(name: str) -> Path | None:
    path = ROOT / "src" / Path(*name.split("."))
    return next((each for each in (path.with_suffix(".py"), path / "__init__.py") if each.is_file()), None)


def covered(path: Path, piece: Piece) -> bool:
    name, within = (path.relative_to(top).as_posix() for top in (ROOT, ROOT / "src" / "bayestissue"))
    if path.name == "__init__.py" or within.startswith(ANYWHERE):
        return True
    return any(name == part or name.startswith(f"{part.rstrip('/*')}/") for part in piece.speaks_of)


CODE = """
def f(x):
    \"\"\"Of x.\"\"\"
    if x < 0:
        raise ValueError('no')
    return x + 1
"""


@pytest.mark.parametrize(
    ("file", "old", "new", "same"),
    [
        ("code.py", "Of x.", "Of another x, in other words.", True),
        ("code.py", "return x + 1", "return (x + 1)  # one more", True),
        ("code.py", "return x + 1", "return x + 2", False),
        ("code.py", "def f(x):", "def f(y):", False),
        ("code.py", "'no'", "f'not {x}, but 2'", True),
        ("model.toml", "# why", "# because", True),
        ("model.toml", "'a'", "'b'", False),
        # The evidence itself writes this table.
        ("shown.csv", "8", "9", True),
    ],
)
def test_words_do_not_make_evidence_stale_and_code_and_settings_do(
    tmp_path, monkeypatch, file, old, new, same
):
    folder = tmp_path / "part"
    folder.mkdir()
    monkeypatch.setattr(fingerprint, "SHOWN", folder / "shown.csv")
    for name, text in {
        "code.py": CODE,
        "model.toml": "# why\nname = 'a'\n",
        "shown.csv": "held\n8\n",
    }.items():
        (folder / name).write_text(text)
    before = fingerprint.of_parts(tmp_path, ["part"])
    (folder / file).write_text((folder / file).read_text().replace(old, new))
    changed = fingerprint.changed(before, fingerprint.of_parts(tmp_path, ["part"]))
    assert changed == ([] if same else ["part"])


@pytest.fixture
def piece(tmp_path, monkeypatch) -> Piece:
    """A piece of one part in a project of its own."""
    (tmp_path / "part.py").write_text("A = 1\n")
    (tmp_path / "script.py").write_text("")
    (tmp_path / "results").mkdir()
    for module in (registry, provenance, status):
        monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(registry, "BENCHMARKS", tmp_path)
    command = ("benchmarks/script.py", "a")
    made = Piece("piece", "piece", "", command, "", ("part.py",), 1)
    monkeypatch.setattr(provenance, "pieces", lambda: {"piece": made})
    monkeypatch.setattr(running, "fill_pages", list)
    return made


def state(piece: Piece) -> status.State:
    status.state_of.cache_clear()
    return status.state_of(piece)


def measure(*numbers: int, of: int = 1) -> None:
    """Units of the piece, of which these are taken."""

    def rows_of(unit: int) -> list[dict[str, float]]:
        if unit not in numbers:
            raise KeyboardInterrupt
        return [{"value": 1.5 * unit}, {"value": 7}]

    provenance.measure("piece", range(of), rows_of)


def test_a_script_writes_where_its_result_comes_from(piece):
    assert state(piece) == status.State("missing", "not measured")
    measure(0)
    about = provenance.read(piece)
    assert {"commit", "dirty", "date", "machine", "versions", "seconds", "processor_s"} <= about.keys()
    assert str(ROOT) not in json.dumps(about)
    assert state(piece).kind == "fresh"


def test_seconds_go_on_with_the_rows_and_begin_anew_without_them(piece, tmp_path):
    measure(0)
    about = tmp_path / "results" / "piece.json"
    for forgotten in (False, True):
        about.write_text(json.dumps(provenance.read(piece) | {"seconds": 1000}))
        if forgotten:
            piece.forget()
        measure(0)
        assert (provenance.read(piece)["seconds"] >= 1000) is not forgotten


def test_a_changed_part_and_a_changed_result_are_told(piece, tmp_path):
    measure(0)
    (tmp_path / "part.py").write_text("A = 1  # the same\n")
    assert state(piece).kind == "fresh"
    (tmp_path / "part.py").write_text("A = 2\n")
    assert state(piece) == status.State("stale", "changed since: part.py")
    (tmp_path / "part.py").write_text("A = 1\n")
    piece.path.write_text("unit,value\n0,2\n")
    assert "not those that it wrote" in state(piece).why


def test_a_result_without_provenance_is_not_measured(piece, tmp_path):
    piece.path.write_text("unit,value\n0,2\n")
    assert state(piece).kind == "missing"


def test_a_program_that_changes_while_it_is_measured_is_told(piece, tmp_path):
    with provenance.recorded("piece") as record:
        record.add(0, [{"value": 1}])
        (tmp_path / "part.py").write_text("A = 2\n")
    assert "while it ran: part.py" in state(piece).why


@pytest.fixture
def set_of_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> pd.DataFrame:
    """A set of results, accepted: medians of forty quantities, and a number without an error."""
    rng = np.random.default_rng(1)
    scale = rng.uniform(1, 2, 41)
    table = pd.DataFrame(
        {
            "quantity": [f"K {number} median" for number in range(40)] + ["flags"],
            "value": rng.normal(2000, 200, 41),
            "scale": scale,
            "mcse": np.where(np.arange(41) < 40, 0.02 * scale, np.nan),
        }
    )
    monkeypatch.setattr(references, "TABLE", tmp_path / "references.csv")
    table.assign(set="fit")[["set", *table]].to_csv(references.TABLE, index=False)
    references.accepted.cache_clear()
    yield table
    references.accepted.cache_clear()


def moved(table: pd.DataFrame, by: np.ndarray | float) -> pd.DataFrame:
    return table.assign(value=table["value"] + by)


OF_TWO_RUNS = 0.02 * np.sqrt(2)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (lambda table: moved(table, 5e-5), ""),
        # Other draws of the same, and the number without an error.
        (lambda table: moved(table, np.append(other_draws(table), 0.0)), ""),
        (lambda table: moved(table, 0.01 * table["value"]), "41 of 41 results differ"),
        # Each within what two runs may differ by, but all together not.
        (lambda table: moved(table, 2.5 * OF_TWO_RUNS * table["scale"]), "41 of 41 results differ"),
        (lambda table: moved(table, table["quantity"] == "flags"), "1 of 41 results differ, such as flags"),
        (lambda table: table[:40], "1 results came or went, such as flags"),
        (
            lambda table: table.assign(value=table["value"].where(table["quantity"] != "flags")),
            "1 of 41 results differ, such as flags",
        ),
    ],
)
def test_results_are_equal_to_rounding_or_within_monte_carlo_error(set_of_results, changed, said):
    told = references.differing("fit", changed(set_of_results))
    assert told.startswith(said) if said else not told


def other_draws(table: pd.DataFrame) -> np.ndarray:
    return np.random.default_rng(2).normal(0, OF_TWO_RUNS, 41)[:40] * table["scale"][:40]


def test_only_a_change_in_numbers_makes_evidence_stale_that_rests_on_them(piece, set_of_results, monkeypatch):
    piece = replace(piece, references=("fit",), speaks_of=())
    monkeypatch.setattr(provenance, "pieces", lambda: {"piece": piece})
    measure(0)
    assert state(piece).kind == "fresh"
    moved(set_of_results, 1).assign(set="fit").to_csv(references.TABLE, index=False)
    references.accepted.cache_clear()
    assert state(piece) == status.State("stale", "numbers changed since: fit")


@pytest.mark.slow
def test_the_program_s_numbers_are_those_that_were_accepted():
    assert not references.differing("points", references.SETS["points"]())


def test_a_stopped_run_goes_on_and_drops_what_another_version_made(piece, tmp_path, capsys):
    with pytest.raises(KeyboardInterrupt):
        measure(0, of=2)
    assert state(piece) == status.State("unfinished", "unfinished: 1 of 2 left")
    measure(1, of=2)
    assert state(piece).kind == "fresh"
    assert piece.rows()["unit"].tolist() == [0, 0, 1, 1]
    (tmp_path / "part.py").write_text("A = 2\n")
    with pytest.raises(KeyboardInterrupt):
        measure(0, of=2)
    assert "4 rows of another version" in capsys.readouterr().out
    assert piece.rows()["unit"].tolist() == [0, 0]


def test_a_trial_measures_so_many_units_and_says_that_some_are_left(piece, monkeypatch):
    monkeypatch.setenv(provenance.TRIAL, "2")
    measure(0, 1, of=5)
    assert state(piece) == status.State("unfinished", "unfinished: 3 of 5 left")


def test_a_unit_may_have_no_rows_or_columns_of_its_own(piece):
    with provenance.recorded("piece") as record:
        record.add("none", [])
        record.add("a", [{"K": 2.0}])
        record.add("b", [{"C": 3.0}])
        assert list(record.missing(["none", "a", "b"])) == []
    rows = pd.DataFrame({"K": [np.nan, 2.0, np.nan], "C": [np.nan, np.nan, 3.0]}, ["none", "a", "b"])
    pd.testing.assert_frame_equal(
        piece.rows().set_index("unit"), rows, check_names=False, check_index_type=False
    )


@pytest.fixture
def run(piece, monkeypatch):
    """Pieces as the command runs them; their scripts are functions here."""
    scripts, done = {"piece": lambda: None}, []

    def run_one(piece):
        done.append(piece.name)
        return scripts[piece.name]() or 0

    monkeypatch.setattr(running, "_run", run_one)

    def run(*pieces, **own):
        scripts.update(own)
        done.clear()
        status.state_of.cache_clear()
        return running.run_pieces(pieces), done

    return run


def test_what_is_fresh_is_not_run_again_and_what_is_left_is_said(piece, run, capsys):
    assert run(piece) == (0, ["piece"])
    assert "piece: not measured\nLeft: 1, about 0 min on two cores." in capsys.readouterr().out
    assert run(piece, piece=lambda: measure(0)) == (0, ["piece"])
    assert run(piece) == (0, [])
    assert "All of it is of this version." in capsys.readouterr().out


def test_a_failure_keeps_no_other_from_being_run_and_timed_ones_come_last(piece, run, capsys, monkeypatch):
    monkeypatch.setattr(running, "LANES", 1)
    long = replace(piece, name="long", minutes=5)
    timed = replace(piece, name="timed", minutes=9, alone=True)
    named = {"timed": lambda: 0, "long": lambda: 0, "piece": lambda: 3}
    assert run(timed, piece, long, **named) == (1, ["long", "piece", "timed"])
    said = capsys.readouterr().out
    assert "piece: failed with status 3" in said
    assert "timed, 3 of 3" in said
    assert "All: 9 min left." in said


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system binds no process to a core")
def test_two_pieces_run_side_by_side_each_on_a_core_of_its_own(piece, run):
    meeting, cores = threading.Barrier(2, timeout=20), []

    def meet():
        meeting.wait()
        cores.append(os.sched_getaffinity(0))

    before = os.sched_getaffinity(0)
    assert run(piece, replace(piece, name="b"), piece=meet, b=meet)[0] == 0
    assert os.sched_getaffinity(0) == before
    if len(before) > 1:
        assert [len(each) for each in cores] == [1, 1]
        assert cores[0] != cores[1]


def test_an_interruption_says_what_is_left(piece, run, capsys):
    def interrupt():
        raise KeyboardInterrupt

    assert run(piece, piece=interrupt)[0] == 1
    assert "Left: 1" in capsys.readouterr().out


def test_what_is_missing_here_is_the_reason_to_skip(piece, run, capsys, tmp_path, monkeypatch):
    recordings = replace(piece, packages=("no_such_package",), folders=("NO_SUCH_FOLDER",))
    assert run(recordings) == (0, [])
    said = capsys.readouterr().out
    assert "needs no_such_package: `make evidence-peers`" in said
    assert "NO_SUCH_FOLDER=FOLDER" in said
    monkeypatch.setenv("NO_SUCH_FOLDER", str(tmp_path))
    assert run(replace(recordings, packages=())) == (0, ["piece"])


def test_examples_that_hypothesis_drew_are_counted(tmp_path):
    long_tests = importlib.import_module("long_tests")
    said = (
        "tests/test_a.py::test_bytes[long csv]:\n\n  - during generate phase (3.57 seconds):\n"
        "    - Typical runtimes: ~ 0-261 ms\n    - 200 passing, 1 failing, and 27 invalid test cases\n\n"
        "tests/test_a.py::test_bytes[tdms]:\n\n  - during generate phase (3.57 seconds):\n"
        "    - 150 passing examples, 0 failing examples, 27 invalid examples\n"
    )
    report = tmp_path / "report.xml"
    report.write_text(
        '<testsuite><testcase name="test_bytes[long csv]" time="3"><failure/></testcase>'
        '<testcase name="test_bytes[tdms]" time="2"/><testcase name="test_other" time="1"/></testsuite>'
    )
    found = long_tests.rows_of(report, said)
    assert found["state"].tolist() == ["failed", "passed", "passed"]
    assert found["examples_passed"].tolist()[:2] == [200, 150]
    assert found["examples_failed"].tolist()[:2] == [1, 0]


def test_rows_are_the_same_however_they_are_written(piece, tmp_path):
    measure(0)
    before = provenance.digest(piece.rows())
    piece.path.write_text("value,unit,more\n0.0,0,\n7.0,0,\n")
    assert provenance.digest(piece.rows()) == before


def test_tables_of_a_simulation_change_those_before_them_at_any_depth():
    table = {
        "name": "a",
        "spreads": {"subject": 0.2},
        "design": {"subjects": 3, "conditions": [("t1", 0.7, 1.5)]},
    }
    tissue = {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, **simulations.by_response(mass_exponent=(0.5, 0.3))}
    made = simulations.simulation(table, {"tissue": tissue, "design": {"subjects": 2}}, seed=4)
    assert (made.name, made.seed, made.design.subjects) == ("a", 4, 2)
    assert made.design.conditions[0].mass_and_velocity() == (0.7, 1.5)
    assert (made.tissue.mass_exponent_C, made.tissue.sd_subject_K, made.tissue.sd_trial_K) == (0.3, 0.2, 0.0)
    assert table["design"]["subjects"] == 3


@pytest.mark.slow
@pytest.mark.parametrize("path", pages.pages(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_page_prints_what_the_files_say_whatever_the_program_is(path, monkeypatch):
    text = path.read_text(encoding="utf-8")
    monkeypatch.setattr(fingerprint, "of_file", lambda path: "another program")
    assert pages.filled_page(path) == text, OTHERS
    assert not list(pages.misplaced(text)), "a figure within a sentence can't begin a line"


def test_every_family_of_the_evidence_stands_in_the_manual():
    text = "".join(path.read_text(encoding="utf-8") for path in pages.pages())
    shown = re.findall(r"(?:<!-- evidence: |^\*Here .* from benchmarks/results: )(\w+)\.", text, re.MULTILINE)
    assert set(shown) == {*figures.FAMILIES, "evidence"}


def test_figures_are_filled_in_containers_and_left_alone_in_examples():
    name = "evidence.provenance"
    marked = f"<!-- evidence: {name} -->\n\nof long ago\n\n<!-- end -->"
    assert "of long ago" not in pages.filled(f":::{{container}} stacked\n\n{marked}\n\n:::\n")
    shown = f"```markdown\n{marked}\n```\n"
    assert pages.filled(shown) == shown


def test_no_measured_figure_is_typed():
    found = {path.relative_to(ROOT).as_posix(): pages.prose(path) for path in pages.sources()}
    typed = [(name, sentence) for name, text in found.items() for sentence in pages.typed(name, text)]
    assert not typed, f"take figures of evidence (benchmarks/README.md) for measured numbers: {typed}"


def test_no_likelihood_and_no_motion_is_far_from_its_oracles():
    """An oracle that integrates to 1e-12 and differentiates by steps of 1e-6 has some 1e-6 of its own."""
    measured = texts.raw("exactness").set_index(["what", "oracle"])["largest_difference"]
    assert measured[measured > 1e-5].empty


def test_the_page_of_a_fit_shows_the_coverage_that_was_measured():
    assert pages.SHOWN.read_text(encoding="utf-8") == pages.coverage_shown(), OTHERS


def test_no_exception_is_kept_that_is_not_needed():
    assert not list(pages.unlisted())


@pytest.mark.parametrize(
    ("sentence", "measured"),
    [
        ("The intervals held K in 88.3 % of them.", True),
        ("A fit takes 43 seconds.", True),
        ("Of 120 simulated campaigns it lost 3 of 100.", True),
        ("It is 12 times faster than the others.", True),
        ("90 % intervals hold the truth in nine of ten cases.", False),
        ("K varies by 31 % in the thesis.", False),
    ],
)
def test_a_typed_figure_is_found_but_where_it_is_marked_or_code(sentence, measured):
    assert bool(list(pages.typed("page.md", f"Words.\n\n{sentence}\n"))) is measured
    marked = f"<!-- evidence: coverage_fit.short -->\n\n{sentence}\n\n<!-- end -->\n"
    assert not list(pages.typed("page.md", marked))
    assert not list(pages.typed("page.md", f"```console\n{sentence}\n```\n"))


def test_the_readme_leaves_out_what_is_not_measured(monkeypatch):
    known = {"a.b": Figure("2 s"), "a.c": Figure("not measured yet", measured=False)}
    monkeypatch.setattr("evidence.pages.figure", known.get)
    marked = "It takes <!-- evidence: a.b -->long<!-- end -->. <!-- evidence: a.c -->Soon.<!-- end -->"
    said = "It takes <!-- evidence: a.b -->2 s<!-- end -->. <!-- evidence: a.c -->{}<!-- end -->"
    assert pages.filled(marked) == said.format("not measured yet")
    assert pages.filled(marked, measured=True) == said.format("")


def test_the_page_says_which_figures_an_earlier_version_measured(piece, tmp_path, monkeypatch):
    def versions() -> str:
        status.state_of.cache_clear()
        return figure("evidence.versions").text

    monkeypatch.setattr("evidence.summary.pieces", lambda: {"piece": piece})
    assert "Not measured in full: `piece` (not measured)." in versions()
    measure(0)
    assert versions().endswith("All figures were of that version.")
    (tmp_path / "part.py").write_text("A = 2\n")
    assert "Measured on an earlier version, at the commit given: `piece` (unknown)." in versions()


def test_an_unknown_figure_is_named(monkeypatch):
    monkeypatch.setattr("evidence.summary.figures", lambda: {"coverage_fit.impact_K_90": Figure("88 %")})
    with pytest.raises(KeyError, match="no pieces 'coverag'"):
        figure("coverag.impact_K_90")
    with pytest.raises(KeyError, match="there is no such figure"):
        figure("coverage_fit.impact_K_91")


def coverage_rows() -> pd.DataFrame:
    """Two campaigns of two impacts: of 50 % intervals one of the four holds the truth, of 90 % three."""
    low_high = {"q05": 0.0, "q25": 4.0, "q50": 5.0, "q75": 6.0, "q95": 10.0}
    rows = pd.DataFrame({"unit": [0, 0, 1, 1], "truth": [5.0, 2.0, 8.0, 12.0]})
    return rows.assign(quantity="K", each="impact", **low_high)


def test_coverage_has_the_standard_error_between_campaigns():
    lines = texts.coverage(coverage_rows(), ["each", "quantity"]).set_index("level")
    assert lines["held"].tolist() == [1, 3]
    # Shares of a half and none, and of all and a half.
    assert lines["se"].tolist() == pytest.approx([0.25, 0.25])
    assert lines.loc[90, "width"] == pytest.approx(np.median(10 / np.array([5.0, 2.0, 8.0, 12.0])))


def test_a_rate_of_none_has_an_upper_limit():
    # 1 - 0.05^(1/80)
    assert texts.at_most(0, 80) == "0 of 80 (below 3.7 %)"


def test_ranks_of_too_narrow_posteriors_spread_too_far():
    # Draws from a normal a tenth too narrow: ranks lie further out, as 200 sets of 15 quantities show.
    rng = np.random.default_rng(3)
    truth = rng.normal(size=(200, 15))
    uniform, narrow = norm.cdf(truth), norm.cdf(truth / 0.9)
    (right, error), (wide, _) = intervals.spread(uniform), intervals.spread(narrow)
    assert abs(right - 1) < 3 * error
    assert wide - 1 > 3 * error


def test_shares_of_outcomes_are_of_studies_and_of_all_outcomes():
    # Two studies: of the first a quarter of the intervals of one outcome lies below the truth.
    rows = pd.DataFrame({"new|force|below": [0.25, 0.0], "new|force|above": [0.0, 0.0]})
    rows = rows.assign(**{"new|depth|below": [0.0, 0.0], "new|depth|above": [0.5, 0.0]})
    lines = outcomes.shares(rows).set_index("outcome")
    assert lines.loc["force", ["share", "below", "above"]].tolist() == [0.875, 0.125, 0.0]
    # Two shares of 1 and of 1 - d have the standard error d / 2 of their mean.
    assert lines.loc["force", "se"] == pytest.approx(0.125)
    assert lines.loc["all", ["share", "se"]].tolist() == pytest.approx([1 - 0.375 / 2, 0.375 / 2])


def test_probabilities_of_being_best_are_drawn_over_the_share_that_is():
    random = np.random.default_rng(0)
    p = random.uniform(size=2000)
    true = (random.uniform(size=2000) < p).astype(float)
    names = ("best side|left", "best side|right")
    made = {f"{name}|p": one for name, one in zip(names, (p, 1 - p), strict=True)}
    made |= {f"{name}|true": one for name, one in zip(names, (true, 1 - true), strict=True)}
    lines = outcomes.reliability(pd.DataFrame(made))
    assert lines["claims"].sum() == 4000
    # Of a pair that is in one bin the two differences cancel.
    assert (abs(lines["share"] - lines["probability"]) <= 3.5 * lines["se"]).all()
    # Off by a tenth either way, which is some ten standard errors.
    wrong = outcomes.reliability(pd.DataFrame(made | {f"{names[0]}|true": true - 0.1}))
    assert (abs(wrong["share"] - wrong["probability"]) > 3.5 * wrong["se"]).any()
    assert outcomes.diagram(lines).count("<circle") == len(lines)


def test_traces_are_filled_up_in_all_that_they_have_by_sample():
    signal = displacements(references.campaign("kelvin_voigt", 1))
    shape, filled = signal.x.shape, importlib.import_module("studies").filled_up(signal, 256)
    by_sample = [name for name, value in vars(signal).items() if getattr(value, "shape", ()) == shape]
    assert {"x", "v", "value", "sample_number", "clipped"} <= set(by_sample)
    for name in by_sample:
        assert getattr(filled, name).shape == (shape[0], 256), name
        assert (getattr(filled, name)[:, : shape[1]] == getattr(signal, name)).all()
