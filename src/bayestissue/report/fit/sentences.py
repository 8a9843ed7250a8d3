"""Sentences of the page of a fit, by their names in ``sentences.toml``."""

from __future__ import annotations

from bayestissue.declarations import declared

SENTENCES = declared(__package__, "sentences.toml")


def said(name: str, /, **values: object) -> str:
    """A sentence such as ``said("sources.window")``, with ``values`` in its braces."""
    group, _, which = name.partition(".")
    return str(SENTENCES[group][which]).format(**values)
