"""Sentences of the page of a fit, by their names in ``sentences.toml``."""

from __future__ import annotations

from bayestissue.base.declarations import declared, sentences

SENTENCES = declared(__package__, "sentences.toml")
said = sentences(__package__)
