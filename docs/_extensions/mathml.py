"""Equations become MathML when the pages are built: browsers show it without a script or a font to load."""

from __future__ import annotations

import re

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number
from sphinx.writers.html5 import HTML5Translator

LOG = logging.getLogger(__name__)
# Commands that docutils lacks, by one that shows the same.
SAME = {r"\dots": r"\ldots"}


def converted(node: nodes.Node, *, block: bool) -> str:
    """The equation as MathML; what can't be read is a warning, and so an error of a strict build."""
    tex = re.sub(r"\\[A-Za-z]+", lambda found: SAME.get(found[0], found[0]), node.astext())
    try:
        return tex2mathml(tex, as_block=block)
    except (MathError, IndexError) as error:
        LOG.warning("no MathML of %r: %s", tex, error, location=node)
        return ""


def visit_inline(self: HTML5Translator, node: nodes.math) -> None:
    """Equations within a line."""
    self.body.append(converted(node, block=False))
    raise nodes.SkipNode


def visit_block(self: HTML5Translator, node: nodes.math_block) -> None:
    """Equations on lines of their own; those with a label have a number."""
    self.body.append(self.starttag(node, "div", CLASS="math notranslate"))
    self.body.append(f'<div class="equation">{converted(node, block=True)}</div>')
    if node["number"]:
        self.body.append(f'<span class="eqno">({get_node_equation_number(self, node)})')
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Name the renderer, which ``html_math_renderer`` then chooses."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
