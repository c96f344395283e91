"""What an examination finds: one line, how bad it is, and what to do about it."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

from gyrorig_protocol.errors import GyrorigError


class Level(IntEnum):
    """How bad a finding is; the worst one decides the exit code."""

    OK = 0
    NOTE = 1  # worth knowing; nothing has to be done
    WARNING = 2  # it records today; some night it will not, or worse than it could
    FAULT = 3  # it does not work as it is


# 4: "done, but something ..." as in every command of the project
EXIT_CODES = {Level.OK: 0, Level.NOTE: 0, Level.WARNING: 4, Level.FAULT: 1}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    `code` names the kind of finding for programs and never changes; `subject` is what was
    looked at, in the words of the rig's configuration.
    """

    level: Level
    subject: str
    code: str
    what: str
    remedy: str = ""

    def to_document(self) -> dict[str, str]:
        """Return it for `--json`."""
        return {
            "level": self.level.name.lower(),
            "subject": self.subject,
            "code": self.code,
            "what": self.what,
            "remedy": self.remedy,
        }


def ok(subject: str, code: str, what: str) -> Finding:
    """Return a finding of which nothing follows."""
    return Finding(Level.OK, subject, code, what)


def note(subject: str, code: str, what: str, remedy: str = "") -> Finding:
    """Return a finding that is worth knowing."""
    return Finding(Level.NOTE, subject, code, what, remedy)


def warning(subject: str, code: str, what: str, remedy: str) -> Finding:
    """Return a finding that will matter some night."""
    return Finding(Level.WARNING, subject, code, what, remedy)


def fault(subject: str, code: str, what: str, remedy: str) -> Finding:
    """Return a finding that keeps the rig from working."""
    return Finding(Level.FAULT, subject, code, what, remedy)


def from_error(subject: str, code: str, error: GyrorigError) -> Finding:
    """Return the fault that an error tells of."""
    return fault(subject, code, error.what, error.remedy)


def worst(findings: Iterable[Finding]) -> Level:
    """Return the worst level among `findings`."""
    return max((finding.level for finding in findings), default=Level.OK)
