"""Outputs and pictures of the manual's pages, made anew: `python tests/docs/refresh.py [PAGE ...]`.

Every page is run in an empty folder, as in the tests; of the README, whose picture needs its fit, all. What
its commands print is written into it, but where the page leaves lines out by `...`. Pictures are taken by
Chromium of the pages that the commands wrote, or of the reports that docs/reports keeps. A page that ends in
.ipynb is its notebook, which notebooks/ keeps as text, without outputs.
"""

from __future__ import annotations

import base64
import hashlib
import io
import os
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import jupytext  # noqa: E402
import nbformat  # noqa: E402
import preparations  # noqa: E402
from nbclient import NotebookClient  # noqa: E402
from pages import DOCS, KEPT, NOTEBOOKS, OF, README, ROOT, Block, Command, commands, run  # noqa: E402
from PIL import Image  # noqa: E402
from PIL.PngImagePlugin import PngInfo  # noqa: E402

from bayestissue.base import runtime  # noqa: E402
from browser import DRAWN, Browser  # noqa: E402

COLOURS = 128


def refresh(page: Path) -> None:
    """Run a page, and write what it printed and showed into it and beside it."""
    printed: dict[int, list[str]] = {}
    changed: dict[int, Block] = {}

    def told(block: Block, command: Command | None, out: str) -> None:
        if block.language == "picture":
            if "picture of" in block.notes:
                _picture(block.notes["picture of"], page.parent / block.text.strip())
            return
        shown = block.text.splitlines() if command is None else command.shown
        changed[block.line] = block
        asked = [] if command is None else _as_written(block, command)
        printed.setdefault(block.line, []).extend([*asked, *_shown(shown, out)])

    with tempfile.TemporaryDirectory() as folder:
        run(page, Path(folder), preparations, told, whole=page == README)
    text = page.read_text(encoding="utf-8").splitlines()
    for line in sorted(changed, reverse=True):
        end = text.index("```", line)
        text[line:end] = printed[line]
    page.write_text("\n".join(text) + "\n", encoding="utf-8")


def _shown(before: list[str], out: str) -> list[str]:
    """What a page shows of an output: all, or what follows a first `...`; with more of these it stays."""
    lines = [line.rstrip() for line in out.strip("\n").splitlines()]
    if before[:1] == ["..."] and len(before) > 1 and before.count("...") == 1 and before[1] in lines:
        return ["...", *lines[lines.index(before[1]) :]]
    return before if "..." in before else lines


def _as_written(block: Block, command: Command) -> list[str]:
    """Lines of a command, with the line ends that the page has."""
    lines, taken = block.text.splitlines(), []
    for line in lines:
        if taken and taken[-1].endswith("\\"):
            taken.append(line)
        elif line.startswith("$ "):
            if taken and commands("\n".join(taken))[0].words == command.words:
                break
            taken = [line]
    return taken


def _picture(said: str, out: Path) -> None:
    source, _, size = said.partition(", ")
    out.parent.mkdir(exist_ok=True)
    width, height = map(int, size.split("x"))
    shown = (ROOT if source.startswith(KEPT) else Path.cwd()) / source
    with Browser() as tab:
        tab.open(shown, width, height=height)
        tab.until(DRAWN)
        small = _few_colours(Image.open(io.BytesIO(tab.picture())))
    stated = PngInfo()
    stated.add_text(OF, hashlib.sha256(shown.read_bytes()).hexdigest())
    small.save(out, optimize=True, pnginfo=stated)


def render(page: Path) -> None:
    """Run a notebook of the project and keep it with its outputs as a page."""
    notebook = jupytext.read(NOTEBOOKS[page.name])
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook, timeout=1800, kernel_name="python3", resources={"metadata": {"path": folder}}
        )
        # A kernel without widgets says so when a progress bar's library loads; the notebook shows no bar.
        client.execute(env=os.environ | {"PYTHONWARNINGS": "ignore:IProgress not found"})
    for cell in notebook.cells:
        cell.id = hashlib.sha256(cell.source.encode()).hexdigest()[:8]
        cell.metadata.pop("execution", None)
        for shown in (output["data"] for output in cell.get("outputs", ()) if "data" in output):
            if "image/png" in shown:
                small = io.BytesIO()
                _few_colours(Image.open(io.BytesIO(base64.b64decode(shown["image/png"])))).save(small, "PNG")
                shown["image/png"] = base64.b64encode(small.getvalue()).decode()
    nbformat.write(notebook, page)


def _few_colours(picture: Image.Image) -> Image.Image:
    """The same with a palette: figures and pages have few colours, and the file is a third.

    Colours are chosen by how far they are from others, and not by how much of the picture has them: a few
    markers keep theirs.
    """
    return picture.convert("RGB").quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE)


if __name__ == "__main__":
    runtime.configure()
    pages = [Path(name).resolve() for name in sys.argv[1:]]
    every = [README, *DOCS.glob("[th]*/*.md"), DOCS / "explanation" / "thesis.md"]
    for each in pages or [*every, *map((DOCS / "tutorial").joinpath, NOTEBOOKS)]:
        (render if each.suffix == ".ipynb" else refresh)(each)
