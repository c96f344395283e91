"""The two dialects, what each offers, and how to tell them apart.

What to use when: send `PROBE` to a unit that answers, give its reply to
`dialect_from_probe`; `dialect_from_version` is a second opinion from the `V` text.
`offers(dialect)` says which queries to poll with and how fast.
"""

from dataclasses import dataclass
from enum import StrEnum

from gyrorig_protocol.ptu.commands import QUERY_COUNTER_HZ, PtuCommand
from gyrorig_protocol.ptu.events import Reply
from gyrorig_protocol.ptu.refusals import Refusal, RefusalKind
from gyrorig_protocol.ptu.values import Version, read, read_version


class Dialect(StrEnum):
    """The value is the name in recordings and configurations."""

    D46 = "d46"
    E46 = "e46"


@dataclass(frozen=True, slots=True)
class Offers:
    """What a daemon can rely on with a dialect."""

    motion_with_counter: bool  # BT, CNT, CNF
    motion: bool  # B
    short_identity: bool  # VM, VS
    min_command_interval_s: float  # vendor support: no flow control, so no faster


# Command index of the E series manual v6.00: "E Series Command Only"; rates: vendor FAQ.
_OFFERS = {
    Dialect.D46: Offers(False, False, False, 0.1),
    Dialect.E46: Offers(True, True, True, 0.01),
}

PROBE: PtuCommand = QUERY_COUNTER_HZ  # moves nothing, answers one number or an error


def offers(dialect: Dialect) -> Offers:
    """Return what `dialect` offers."""
    return _OFFERS[dialect]


def dialect_from_probe(reply: Reply) -> Dialect | None:
    """Return the dialect that the answer to `PROBE` shows; None where it shows neither."""
    reading = read(PROBE, reply)
    if isinstance(reading, int) and reading > 0:
        return Dialect.E46
    if isinstance(reading, Refusal) and reading.kind is RefusalKind.ILLEGAL_COMMAND:
        return Dialect.D46
    return None


def dialect_from_version(text: str) -> Dialect | None:
    """Return the dialect of the controller that a `V` text names; None where it names none.

    A D48E is an E-series controller: the letter behind the number decides.
    """
    version = read_version(text)
    if not isinstance(version, Version) or not version.controller:
        return None
    controller = version.controller
    return Dialect.E46 if "E" in controller else Dialect.D46
