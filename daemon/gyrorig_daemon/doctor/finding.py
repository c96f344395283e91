"""Findings of the doctor: one line, a severity, and a remedy."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

from gyrorig_protocol.errors import GyrorigError


class Level(IntEnum):
    """Severity of a finding; the highest one decides the exit status."""

    OK = 0
    NOTE = 1  # for information; no action is needed
    WARNING = 2  # it works now, but a later session will fail or give worse data
    FAULT = 3  # it does not work


# 4: "done, but there is a problem", as in every command of the project
EXIT_CODES = {Level.OK: 0, Level.NOTE: 0, Level.WARNING: 4, Level.FAULT: 1}


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check.

    `code` identifies the kind of finding for programs and never changes. `subject` is the part
    of the rig, as the configuration names it.
    """

    level: Level
    subject: str
    code: str
    what: str
    remedy: str = ""

    def to_document(self) -> dict[str, str]:
        """Return the finding for `--json`."""
        return {
            "level": self.level.name.lower(),
            "subject": self.subject,
            "code": self.code,
            "what": self.what,
            "remedy": self.remedy,
        }


def ok(subject: str, code: str, what: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(Level.OK, subject, code, what)


def note(subject: str, code: str, what: str, remedy: str = "") -> Finding:
    """Return a finding for information."""
    return Finding(Level.NOTE, subject, code, what, remedy)


def warning(subject: str, code: str, what: str, remedy: str) -> Finding:
    """Return a finding that will affect a later session."""
    return Finding(Level.WARNING, subject, code, what, remedy)


def fault(subject: str, code: str, what: str, remedy: str) -> Finding:
    """Return a finding that prevents the rig from working."""
    return Finding(Level.FAULT, subject, code, what, remedy)


def from_error(subject: str, code: str, error: GyrorigError) -> Finding:
    """Return an error as a fault."""
    return fault(subject, code, error.problem, error.remedy)


def worst(findings: Iterable[Finding]) -> Level:
    """Return the highest level among `findings`."""
    return max((finding.level for finding in findings), default=Level.OK)
