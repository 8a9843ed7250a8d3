from __future__ import annotations

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.conditions import summary_lines


def test_every_number_of_both_tables_is_there(published: PublishedTables) -> None:
    lines = summary_lines(published)
    assert len(lines) == 9 + 2 * 9 * 3
    lost = [line for line in lines if not line.reproduced]
    assert len(lost) == 12
    assert all("are lost" in line.note for line in lost)


def test_all_averages_agree(published: PublishedTables) -> None:
    found = [line.agrees for line in summary_lines(published) if line.quantity.startswith("average")]
    assert found.count(True) == 14
    assert found.count(None) == 4


def test_slips_are_named(published: PublishedTables) -> None:
    notes = {line.quantity: line.note for line in summary_lines(published) if line.agrees is False}
    assert "repeats the range" in notes["standard deviation of K, trial 17"]
    assert notes["range of C, trial 16"] == "differs by +0.983"
    # 2 · 0.75 / 0.666 = 1.5008²
    assert "needs V = 1.501 m/s" in notes["mass, trial 7"]
    assert "average of C, trial 26" not in notes
