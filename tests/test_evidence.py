"""Evidence: the registry holds together, staleness is by content, and pages print what the files say."""

from __future__ import annotations

import ast
import json
import re
import sys
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
    status,
    texts,
)
from evidence.families import intervals, outcomes
from evidence.registry import ROOT, Piece
from evidence.summary import figure
from evidence.texts import Figure

PIECES = list(registry.pieces().values())
# What every script may use without speaking of it: where things lie, and how numbers are held.
ANYWHERE = ("base/runtime.py", "base/resources.py", "recordings/dataset/")
OTHERS = "run `make evidence-pages`, and commit what it writes"


def test_a_piece_names_what_there_is_and_what_its_scripts_import():
    provenances = figure("evidence.provenance").text
    for piece in PIECES:
        assert [part for part in piece.parts() if not (ROOT / part.removesuffix("/*")).exists()] == []
        assert set(piece.references) <= set(references.SETS)
        assert f"`{piece.name}`" in provenances
        # The numbers of references.csv stand for the program where a piece names any.
        missing = [] if piece.references else [name for name in imported(piece) if not covered(name, piece)]
        assert not missing, f"{piece.name} of evidence.toml lacks {missing}"


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
        ("code.py", "return x + 1", "return x + 2", False),
        ("code.py", "'no'", "f'not {x}, but 2'", True),
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
    content = {"code.py": CODE, "model.toml": "# why\nname = 'a'\n", "shown.csv": "held\n8\n"}
    for name, text in content.items():
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


def test_a_result_says_where_it_comes_from_and_is_stale_where_that_or_itself_has_changed(piece, tmp_path):
    assert state(piece) == status.State("missing", "not measured")
    measure(0)
    about = provenance.read(piece)
    assert {"commit", "dirty", "date", "machine", "versions", "seconds", "processor_s"} <= about.keys()
    assert str(ROOT) not in json.dumps(about)
    assert state(piece).kind == "fresh"
    (tmp_path / "part.py").write_text("A = 2\n")
    assert state(piece) == status.State("stale", "changed since: part.py")
    (tmp_path / "part.py").write_text("A = 1\n")
    piece.path.write_text("unit,value\n0,2\n")
    assert "not those that it wrote" in state(piece).why
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
        # Each within what two runs may differ by, but all together not.
        (lambda table: moved(table, 2.5 * OF_TWO_RUNS * table["scale"]), "41 of 41 results differ"),
        (lambda table: moved(table, table["quantity"] == "flags"), "1 of 41 results differ, such as flags"),
        (lambda table: table[:40], "1 results came or went, such as flags"),
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


@pytest.mark.slow
@pytest.mark.parametrize("path", pages.pages(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_page_prints_what_the_files_say_whatever_the_program_is(path, monkeypatch):
    text = path.read_text(encoding="utf-8")
    monkeypatch.setattr(fingerprint, "of_file", lambda path: "another program")
    assert pages.filled_page(path) == text, OTHERS
    assert not list(pages.misplaced(text)), "a figure within a sentence can't begin a line"


def test_figures_are_filled_and_left_out_of_the_readme_where_they_are_not_measured(monkeypatch):
    known = {"a.b": Figure("2 s"), "a.c": Figure("not measured yet", measured=False)}
    monkeypatch.setattr("evidence.pages.figure", known.get)
    marked = "It takes <!-- evidence: a.b -->long<!-- end -->. <!-- evidence: a.c -->Soon.<!-- end -->"
    said = "It takes <!-- evidence: a.b -->2 s<!-- end -->. <!-- evidence: a.c -->{}<!-- end -->"
    assert pages.filled(marked) == said.format("not measured yet")
    assert pages.filled(marked, measured=True) == said.format("")
    example = f"```markdown\n{marked}\n```\n"
    assert pages.filled(example) == example


def test_every_family_of_the_evidence_stands_in_the_manual():
    text = "".join(path.read_text(encoding="utf-8") for path in pages.pages())
    shown = re.findall(r"(?:<!-- evidence: |^\*Here .* from benchmarks/results: )(\w+)\.", text, re.MULTILINE)
    assert set(shown) == {*figures.FAMILIES, "evidence"}


def test_no_measured_figure_is_typed():
    found = {path.relative_to(ROOT).as_posix(): pages.prose(path) for path in pages.sources()}
    typed = [(name, sentence) for name, text in found.items() for sentence in pages.typed(name, text)]
    assert not typed, f"take figures of evidence (benchmarks/README.md) for measured numbers: {typed}"


def test_no_likelihood_and_no_motion_is_far_from_its_oracles():
    """An oracle that integrates to 1e-12 and differentiates by steps of 1e-6 has some 1e-6 of its own."""
    measured = texts.raw("exactness").set_index(["what", "oracle"])["largest_difference"]
    assert measured[measured > 1e-5].empty


@pytest.mark.slow
def test_the_page_of_a_fit_shows_the_coverage_that_was_measured():
    assert pages.SHOWN.read_text(encoding="utf-8") == pages.coverage_shown(), OTHERS


def test_no_exception_is_kept_that_is_not_needed():
    assert not list(pages.unlisted())


@pytest.mark.parametrize(
    ("sentence", "measured"),
    [
        ("The intervals held K in 88.3 % of them.", True),
        ("A fit takes 43 seconds.", True),
        ("90 % intervals hold the truth in nine of ten cases.", False),
        ("K varies by 31 % in the thesis.", False),
    ],
)
def test_a_typed_figure_is_found_but_where_it_is_marked_or_code(sentence, measured):
    assert bool(list(pages.typed("page.md", f"Words.\n\n{sentence}\n"))) is measured
    marked = f"<!-- evidence: coverage_fit.short -->\n\n{sentence}\n\n<!-- end -->\n"
    assert not list(pages.typed("page.md", marked))
    assert not list(pages.typed("page.md", f"```console\n{sentence}\n```\n"))


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
