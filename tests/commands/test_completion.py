from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def test_the_shell_can_complete_commands_and_options() -> None:
    words = {"COMP_WORDS": "bayestissue estimate --meth", "COMP_CWORD": "2"}
    told = subprocess.run(  # noqa: S603
        [str(Path(sys.executable).with_name("bayestissue"))],
        env=os.environ | words | {"_BAYESTISSUE_COMPLETE": "complete_bash"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout.split() == ["--method"]
    assert told.stderr == ""
