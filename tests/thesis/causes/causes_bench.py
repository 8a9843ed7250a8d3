"""Small specifications for the tests of causes."""

from __future__ import annotations

from functools import cache

from bayestissue.dataset.published import read_published
from bayestissue.resources import shared
from bayestissue.thesis.causes.batches import Batch, batches
from bayestissue.thesis.causes.design import Design, published_design
from bayestissue.thesis.causes.specification import CausesSpecification, Range, Sizes, chosen, read_causes


@cache
def design() -> Design:
    return published_design(read_published())[0]


def specification(*causes: str, each: int = 40, batch: int = 10) -> CausesSpecification:
    path = shared("models", "causes.toml")
    small = chosen(read_causes(path), causes, str(path))
    # Short recordings: one width to compile, and little to compute.
    recording = small.recording.model_copy(update={"samples_to_peak": Range(low=16, high=20)})
    return small.model_copy(update={"campaigns": Sizes(each=each, batch=batch), "recording": recording})


def work(*causes: str, each: int = 40, batch: int = 10) -> list[Batch]:
    return batches(design(), specification(*causes, each=each, batch=batch), seed=3)
