"""Install pinned packages into an environment, and say every few seconds how far that is.

    python tools/install.py VENV LOCK...        the packages of the lock files, and this project beside them

pip alone is silent for minutes when it is told to be quiet, and prints hundreds of lines when it is not.
Python's own library is all that is there yet.
"""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from pathlib import Path

EVERY_S = 5.0


def pinned(locks: list[Path]) -> int:
    """How many packages the lock files name; on this system some may not be needed."""
    names = (re.match(r"[A-Za-z0-9._-]+==", line) for lock in locks for line in lock.read_text().splitlines())
    return sum(name is not None for name in names)


def installed(venv: Path) -> int:
    """How many packages the environment has."""
    return sum(1 for _ in (venv / "lib").glob("python*/site-packages/*.dist-info"))


def read(lines: Iterable[str], said: list[str], downloaded: list[str]) -> None:
    """Keep what pip says, and the packages that it fetches."""
    for line in lines:
        said.append(line)
        if found := re.match(r"\s*(?:Downloading|Using cached) (\S+)\.whl \(", line):
            downloaded.append(found[1].split("-")[0])


def run(command: list[str], doing: str, venv: Path) -> None:
    """Run pip; a line every few seconds, and all that it said if it fails."""
    began = time.monotonic()
    print(f"{doing} ...", flush=True)
    said: list[str] = []
    downloaded: list[str] = []
    spoke = began
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        reader = threading.Thread(target=read, args=(process.stdout, said, downloaded), daemon=True)
        reader.start()
        while process.poll() is None:
            time.sleep(0.2)
            if (now := time.monotonic()) - spoke > EVERY_S:
                spoke = now
                last = f", the last {downloaded[-1]}" if downloaded else ""
                counts = f"{len(downloaded)} packages fetched{last}; {installed(venv)} installed"
                print(f"  {now - began:3.0f} s: {counts}", flush=True)
        reader.join()
    if process.returncode:
        sys.exit(f"{''.join(said)}\ninstalling failed; the lines above are pip's")
    print(f"  done after {time.monotonic() - began:.0f} s", flush=True)


def main() -> None:
    """Install what the command line names."""
    venv, *locks = map(Path, sys.argv[1:])
    pip = [str(venv / "bin" / "python"), "-m", "pip", "--disable-pip-version-check", "install"]
    named = [word for lock in locks for word in ("--requirement", str(lock))]
    about = f"installing {pinned(locks)} packages of {', '.join(map(str, locks))}"
    run([*pip, "--progress-bar", "off", *named], about, venv)
    run([*pip, "--no-deps", "--no-build-isolation", "--editable", "."], "installing bayestissue", venv)


if __name__ == "__main__":
    main()
