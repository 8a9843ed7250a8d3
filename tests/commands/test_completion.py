from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("typed", "offered"), [("bayestissue fi", "fit"), ("bayestissue estimate --meth", "--method")]
)
def test_the_shell_can_complete_commands_and_options(typed: str, offered: str) -> None:
    words = {"COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    told = subprocess.run(  # noqa: S603
        [str(Path(sys.executable).with_name("bayestissue"))],
        env=os.environ | words | {"_BAYESTISSUE_COMPLETE": "complete_bash"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout.split() == [offered]
    assert told.stderr == ""
