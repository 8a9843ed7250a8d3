"""The list of checks. A new one is a decorated function in a module that the package imports."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from bayestissue.thesis.audit.findings import Bearing, Finding, Severity


@dataclass(frozen=True)
class Check[Subject]:
    """A named check, how serious its findings are, and why."""

    name: str
    look: Callable[[Subject], Iterable[Finding]]
    severity: Severity
    bearing: Bearing
    reason: str


class Registry[Subject]:
    """Checks of one kind of subject, in the order in which they were registered."""

    def __init__(self) -> None:
        self.checks: dict[str, Check[Subject]] = {}

    def check(
        self, *, severity: Severity, bearing: Bearing, reason: str
    ) -> Callable[[Callable[[Subject], Iterable[Finding]]], Callable[[Subject], Iterable[Finding]]]:
        """Register a function that yields a finding for everything it does not believe.

        Args:
            severity: of its findings, unless a finding says otherwise.
            bearing: what its findings put in doubt; among equals in severity this decides which comes first.
            reason: why they are that serious, in one sentence.
        """

        def register(look: Callable[[Subject], Iterable[Finding]]) -> Callable[[Subject], Iterable[Finding]]:
            name = look.__name__
            if name in self.checks:
                raise ValueError(f"a check named {name} is registered already")
            self.checks[name] = Check(name, look, severity, bearing, reason)
            return look

        return register

    def run(self, subject: Subject) -> Iterator[Finding]:
        """Every finding of every check on ``subject``, with its severity and what it bears on."""
        for check in self.checks.values():
            for finding in check.look(subject):
                severity = finding.severity or check.severity
                yield replace(finding, severity=severity, bearing=check.bearing)
