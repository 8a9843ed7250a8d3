"""What is said of a measuring chain that the traces contradict."""

from __future__ import annotations

from typing import Any

from bayestissue.outline import first_of

_MOST_NAMED = 12
_UNTRUSTED = (
    "K and C of these impacts can't be trusted: their intervals rest on the declared errors. "
    "If the measuring chain is right, the tissue obeys another law than the model's."
)
_CHECK = {
    "velocity and gain": "Check the velocity at contact, and the recorder's gain (sensitivity, unit, scale)",
    "offset": "Check the recorder's zero (drift, hum, a baseline that moves at contact)",
    "contact": "Check the moment of contact (signal.contact), and that the recording begins before it",
}
_OTHER = {"offset": "a zero of the recorder", "contact": "a moment of contact"}
_OF = {"offset": "the mean deceleration", "contact": "the time to zero velocity"}
_OF_GROUP = {"trial": "the velocity that is stated for this condition", "subject": "what differs for them"}


def in_words(told: dict[str, Any]) -> str:
    """Sentences on what `bayestissue.inference.checking.measuring_chain.judge` found."""
    if told["passed"] is None:
        return (
            f"Whether the measuring chain is as declared can't be told ({told['error']}): the residuals stay "
            "structured whatever its errors are, and what the traces ask of it may be the tissue's law."
        )
    check = _CHECK[told["error"]]
    if told["error"] == "velocity and gain" and told["kind"] in _OF_GROUP:
        check += f"; first {_OF_GROUP[told['kind']]}"
    checks = ". ".join([check, *(_CHECK[each] for each in told["alike"])])
    return (
        f"The traces contradict the measuring chain in {_where(told)}: {_what(told)}, {_sds(told)}. "
        f"K would then be {_change(told['change_K'])} and C {_change(told['change_C'])}.{_alike(told)} "
        f"{checks}. {_UNTRUSTED}"
    )


def _alike(told: dict[str, Any]) -> str:
    others = [
        f"{_OTHER[each]} off by {_percent(size)} of {_OF[each]}" for each, size in told["alike"].items()
    ]
    return f" To the traces {' or '.join(others)} would look the same." if others else ""


def _where(told: dict[str, Any]) -> str:
    count, of = len(told["impacts"]), told["of"]
    if told["kind"] == "all":
        return f"all {of} impacts" if of > 1 else "the only impact"
    if told["kind"] in _OF_GROUP:
        return f"all impacts of {told['kind']} {first_of(told['groups'], _MOST_NAMED)} ({count} of {of})"
    return f"{count} of {of} impacts ({first_of(told['impacts'], _MOST_NAMED)})"


def _what(told: dict[str, Any]) -> str:
    size, alike = told["relative"], told["common"] or len(told["impacts"]) == 1
    about = "" if alike else "up to "
    share = f"{about}{_percent(size if alike else told['greatest'])}"
    if (error := told["error"]) in _OTHER:
        return f"they ask for {_OTHER[error]} off by {share} of {_OF[error]}"
    if not alike:
        return f"they ask for other velocities, off by {share} (or for another gain of each)"
    way, reads = ("higher", "much") if size > 0 else ("lower", "little")
    return (
        f"they ask for a velocity {share} {way} than stated, or a recorder that reads {share} too {reads}"
        + (", by one common factor" if told["common"] and len(told["impacts"]) > 1 else "")
    )


def _sds(told: dict[str, Any]) -> str:
    sds = told["declared_sds"]
    if sds is None:
        return "where no error was declared"
    return f"{sds:.2g} declared standard deviations" + (" (median)" if len(told["impacts"]) > 1 else "")


def _change(ratio: float) -> str:
    return f"{_percent(ratio)} {'higher' if ratio > 0 else 'lower'}"


def _percent(ratio: float) -> str:
    return f"{100 * abs(ratio):.2g} %"
