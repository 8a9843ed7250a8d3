"""Pages of the manual as programs: files are written, commands and Python run, their outputs compared.

A page is Markdown. What the runner takes from it:

- a `console` block: a line that begins with `$ ` is a command (with `\\` at its end it goes on in the next
  line), the lines after it are what the command prints;
- a `python` block, and a `text` block right after it: what it prints;
- a `{code-block}` with a `:caption:`: the file of that name, or with "(add at the end)" what is added to one;
- HTML comments, on a line of their own, for the block or picture that follows:
  `<!-- prepare: NAME -->` calls a function of preparations.py in the page's folder,
  `<!-- not run: REASON -->` leaves the block out (its commands' options are checked all the same),
  `<!-- takes long: REASON -->` does too, unless all of the page is asked for,
  `<!-- stays: REASON -->` also, and its commands then run in the background until the page ends,
  `<!-- exit status: 2 -->` is what the last command of the block ends with, and
  `<!-- picture of: PAGE.html, WIDTHxHEIGHT -->` says of what refresh.py takes the picture: a page that the
  commands before it wrote, or a report that docs/reports keeps.

Numbers may differ by a tenth, as they do between machines and compilers; a line `...` stands for any lines.
"""

from __future__ import annotations

import io
import math
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, chdir, contextmanager, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path

import click
import matplotlib as mpl
import typer

from bayestissue import cli
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.recordings.dataset import read_dataset
from bayestissue.studies.fitting import formulas_of, require_answerable, resolve
from command_line import bayestissue

ROOT = Path(__file__).resolve().parents[2]
DOCS, README = ROOT / "docs", ROOT / "README.md"
# Where reports of this version are kept, and the name by which a picture states the SHA-256 of what it shows.
KEPT, OF = "docs/reports/", "of"
NOTEBOOKS = {"notebook.ipynb": ROOT / "notebooks" / "traces.py"}
WIDTH = "96"
SHARED = ("data", "models")
# Of blocks that run only where all of a page is asked for.
LONG = ("takes long", "stays")
APART = ("not run", *LONG, "exit status", "picture of", "prepare")
ADDED = " (add at the end)"
_NOTE = re.compile(rf"^<!-- ({'|'.join(APART)}): (.*?) -->$")
_FENCE = re.compile(r"^(```+)(\{[\w-]+\})? ?(.*)$")
_NUMBER = re.compile(r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])")
_BOXES = re.compile(r"[\u2500-\u257f]+")


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, text, first line in the page (from 0), caption, and notes before it."""

    language: str
    text: str
    line: int
    caption: str = ""
    notes: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Command:
    """A command of a `console` block and the lines that the page shows after it."""

    words: str
    shown: list[str]


def blocks(text: str) -> Iterator[Block]:
    """Fenced blocks and pictures of a page, in its order."""
    lines, at, notes = text.splitlines(), 0, {}
    while at < len(lines):
        line = lines[at]
        if note := _NOTE.match(line):
            notes[note[1]] = note[2]
        elif fence := _FENCE.match(line):
            end = lines.index(fence[1], at + 1)
            inner = lines[at + 1 : end]
            caption = ""
            while fence[2] and inner and inner[0].startswith(":"):
                name, _, value = inner.pop(0)[1:].partition(": ")
                caption = value if name == "caption" else caption
            inside = "\n".join(inner).strip("\n") + "\n"
            if fence[2] in (None, "{code-block}"):
                yield Block(fence[3], inside, at + 1, caption, notes)
            at, notes = end, {}
        elif line.startswith("!["):
            yield Block("picture", line.split("(")[1].rstrip(")"), at, "", notes)
            notes = {}
        elif notes and line.strip():
            # Notes before a paragraph, such as a preparation.
            yield Block("", "", at, "", notes)
            notes = {}
        at += 1


def commands(text: str) -> list[Command]:
    """The commands of a `console` block."""
    found: list[Command] = []
    for line in text.replace("\\\n", "").splitlines():
        if line.startswith("$ "):
            found.append(Command(line[2:], []))
        elif found:
            found[-1].shown.append(line)
    return found


def run(
    page: Path,
    folder: Path,
    preparations: object = None,
    told: Callable | None = None,
    *,
    whole: bool = False,
) -> None:
    """Run a page in ``folder``; an output other than the page's is an AssertionError.

    ``told``, called with each block, the command or None, and what was printed, replaces the comparison.
    ``whole`` runs what takes long, too.
    """
    left_out = ("not run",) if whole else ("not run", *LONG)
    for name in SHARED:
        if not (folder / name).exists():
            (folder / name).symlink_to(ROOT / name)
    names: dict[str, object] = {}
    told = told or (lambda block, command, out: compare(page, block, command, out))
    last, printed = Block("", "", 0), ""
    with chdir(folder), mpl.rc_context({"backend": "agg"}), ExitStack() as staying:
        for block in blocks(page.read_text(encoding="utf-8")):
            if "prepare" in block.notes:
                getattr(preparations, block.notes["prepare"])(folder)
            if block.caption:
                _write(block)
            elif any(note in block.notes for note in left_out):
                parse(block)
            elif "stays" in block.notes:
                for command in commands(block.text):
                    staying.enter_context(_in_the_background(command.words))
            elif block.language == "console":
                _console(block, told)
            elif block.language == "python":
                with redirect_stdout(io.StringIO()) as said:
                    exec(compile("\n" * block.line + block.text, str(page), "exec"), names)  # noqa: S102
                printed = said.getvalue()
            elif block.language == "picture":
                told(block, None, "")
            elif block.language == "text" and last.language == "python":
                told(block, None, printed)
            last = block


def _write(block: Block) -> None:
    path = Path(block.caption.removesuffix(ADDED))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a" if block.caption.endswith(ADDED) else "w", encoding="utf-8") as file:
        file.write(block.text)


def _console(block: Block, told: Callable) -> None:
    every = commands(block.text)
    for number, command in enumerate(every):
        status, out = _execute(command.words)
        last = number == len(every) - 1
        expected = int(block.notes.get("exit status", "0")) if last else 0
        assert status == expected, f"line {block.line}: {command.words}\nended with {status}\n{out}"
        told(block, command, out)


@contextmanager
def _in_the_background(words: str) -> Iterator[None]:
    """A program of this environment, stopped when it is left."""
    name, *arguments = shlex.split(words)
    command = [Path(sys.executable).with_name(name), *arguments]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, **quiet) as begun:  # noqa: S603 - as the page has it
        try:
            yield
        finally:
            begun.terminate()


def _execute(words: str) -> tuple[int, str]:
    if words.startswith("bayestissue "):
        os.environ["COLUMNS"] = WIDTH
        ended = bayestissue(*shlex.split(words, comments=True)[1:])
        # Messages name whole paths, which differ from reader to reader.
        return ended.status, (ended.err + ended.out).replace(f"{Path.cwd()}{os.sep}", "")
    done = subprocess.run(words, shell=True, capture_output=True, text=True, check=False)  # noqa: S602
    return done.returncode, done.stderr + done.stdout


def parse(block: Block) -> None:
    """Of commands that do not run here: an unknown option, or a fit that would be refused, is an error."""
    if block.language == "python":
        compile(block.text, "block", "exec")
    group = typer.main.get_command(cli.app)
    for command in commands(block.text) if block.language == "console" else ():
        words = shlex.split(command.words, comments=True)
        if "bayestissue" in words:
            words = words[words.index("bayestissue") + 1 :]
            known = group.get_command(click.Context(group), words[0])
            assert known is not None, f"line {block.line}: no command {words[0]}"
            options = {name for parameter in known.params for name in parameter.opts}
            unknown = [word for word in words if word.startswith("--") and word not in options]
            assert not unknown, f"line {block.line}: {unknown}"
            if words[0] == "fit" and Path(words[1]).is_dir():
                given = {
                    key: words[words.index(key) + 1] for key in ("--model", "--K", "--ask") if key in words
                }
                data, model = read_dataset(words[1]), given.get("--model")
                formulas = formulas_of(given.get("--K"), None)
                asked = [given["--ask"]] if "--ask" in given else []
                specification, source = resolve(model, data.quantity, formulas=formulas, questions=asked)
                prepared = prepare(data, specification, source=source)
                require_answerable(prepared, specification, source)


def compare(page: Path, block: Block, command: Command | None, out: str) -> None:
    """Raise an AssertionError where the page shows other lines than were printed."""
    shown = block.text.splitlines() if command is None else command.shown
    if block.language == "picture" or not any(line.strip() for line in shown):
        return
    wanted, found = _stable(shown), _stable(out.splitlines())
    at = 0
    for number, line in enumerate(wanted):
        if line == "...":
            continue
        free = number > 0 and wanted[number - 1] == "..."
        while free and at < len(found) and not same(line, found[at]):
            at += 1
        what = f"{page.name}, line {block.line}: the page shows\n  {line}\nprinted was\n{out}"
        assert at < len(found), what
        assert same(line, found[at]), what
        at += 1
    more = found[at:] if not wanted or wanted[-1] != "..." else []
    assert not more, f"{page.name}, line {block.line}: printed besides\n" + "\n".join(more)


def same(one: str, other: str) -> bool:
    """Whether two lines are the same, their numbers to a tenth."""
    numbers = [[float(n.replace("−", "-")) for n in _NUMBER.findall(line)] for line in (one, other)]
    words = [_NUMBER.sub("#", line) for line in (one, other)]
    return words[0] == words[1] and all(
        math.isclose(a, b, rel_tol=0.1, abs_tol=0.02 if abs(a) < 1 else 0.0)
        for a, b in zip(*numbers, strict=True)
    )


def _stable(lines: list[str]) -> list[str]:
    """Lines without the boxes of tables, spaces made one, empty lines left out."""
    return [line for line in (" ".join(_BOXES.sub(" ", each).split()) for each in lines) if line]
