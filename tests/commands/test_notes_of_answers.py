"""What is said of several levels of a choice is printed once."""

from __future__ import annotations

import pandas as pd

from bayestissue.commands.finished_runs import _notes


def test_what_is_said_of_all_levels_is_said_once():
    notes = [
        "beyond; depth beyond; few draws above",
        "beyond; few draws below; depth beyond",
        "depth beyond; beyond",
    ]
    answers = pd.DataFrame({"level": ["a", "b", "c"], "note": notes})
    assert _notes(answers) == [
        ([], "beyond; depth beyond"),
        (["a"], "few draws above"),
        (["b"], "few draws below"),
    ]
    assert _notes(pd.DataFrame({"level": [""], "note": ["one; two"]})) == [([], "one; two")]
    assert _notes(pd.DataFrame({"level": [""], "note": [""]})) == []
