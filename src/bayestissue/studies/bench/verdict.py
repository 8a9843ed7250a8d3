"""What to do about a drop: go on, repeat it, or look at the bench. By the flags of `check` and `estimate`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

from bayestissue.base.remedies import Code, codes_in, entries

# Flags of a recording that was spoilt, which another drop does not have. Others are of the bench or of the
# analysis: repeating mends none of them.
_SPOILT = frozenset(
    {"spike", "repeated-samples", "zero-moved", "starts-above-zero", "starts-below-zero", "starts-deep"}
    | {"no-law", "contact-doubtful", "no-zero-velocity", "too-few-samples", "too-deep"}
    | {"velocity-off", "several-impacts", "no-answer", "recording-twice"}
)
Kind = Literal["good", "again", "look"]


class DropVerdict(NamedTuple):
    """What to do about a drop.

    Attributes:
        kind: "good", "again" where it is to be repeated, or "look" where the bench is to be looked at.
        reason: why, in a few words; empty where it is good.
        code: of the entry of `bayestissue.base.remedies` that says more, if any.
    """

    kind: Kind
    reason: str = ""
    code: Code = ""

    @property
    def spoilt(self) -> bool:
        """Whether the recording itself is spoilt, which another drop mends, and so left out of the dataset.

        A drop that is only unlike others stays: left out for its number, people would look more alike than
        they are.
        """
        return self.code in _SPOILT

    @property
    def words(self) -> str:
        """The verdict as people read it."""
        return f"{self.kind}: {self.reason}" if self.reason else self.kind

    @property
    def advice(self) -> str:
        """What the reason does to K and C, and what to do."""
        return entries()[self.code].advice if self.code else ""


def verdict(
    flags: Iterable[str],
    *,
    velocity: tuple[float, float | None, float] = (0.0, None, 0.0),
    unlike: str = "",
) -> DropVerdict:
    """The verdict on a drop that could be read.

    Args:
        flags: of `bayestissue.estimate`, and what `check` says besides.
        velocity: at contact, m/s; the one that is wanted, if any; and by which fraction it may differ.
        unlike: how it is unlike what its person's other drops let expect, in words; empty if it is not.
    """
    coded = [(flag, codes[0] if (codes := codes_in(flag)) else "") for flag in flags]
    for flag, code in coded:
        if code in _SPOILT:
            return DropVerdict("again", flag, code)
    actual, wanted, within = velocity
    if wanted is not None and abs(actual / wanted - 1) > within:
        return DropVerdict("again", f"{actual:.3g} m/s at contact, and {wanted:.3g} m/s is wanted")
    if unlike:
        return DropVerdict("again", unlike)
    return DropVerdict("look", *coded[0]) if coded else DropVerdict("good")
