"""The two command dialects of pan-tilt units, their features, and how to identify them.

What to use when: send `PROBE` to a unit that answers and pass its reply to `dialect_from_probe`.
`dialect_from_version` is a second check, from the answer to `V`.
`dialect_features` has the queries for polling and the shortest command interval.
"""

from dataclasses import dataclass
from enum import StrEnum

from gyrorig_protocol.ptu.ptu_commands import QUERY_COUNTER_HZ, PtuCommand
from gyrorig_protocol.ptu.ptu_events import Reply
from gyrorig_protocol.ptu.refusals import Refusal, RefusalKind
from gyrorig_protocol.ptu.reply_values import FirmwareVersion, read_value, read_version


class Dialect(StrEnum):
    """A command dialect; the value is its name in recordings and configurations."""

    D46 = "d46"
    E46 = "e46"


@dataclass(frozen=True, slots=True)
class DialectFeatures:
    """The features of a dialect."""

    motion_with_counter: bool  # BT, CNT, CNF
    motion: bool  # B
    model_and_serial_queries: bool  # VM, VS
    min_command_interval_s: float  # by vendor support: there is no flow control


# Command index of the E series manual v6.00: "E Series Command Only"; rates: vendor FAQ.
_FEATURES = {
    Dialect.D46: DialectFeatures(False, False, False, 0.1),
    Dialect.E46: DialectFeatures(True, True, True, 0.01),
}

PROBE: PtuCommand = QUERY_COUNTER_HZ  # causes no motion; the answer is one number or an error


def dialect_features(dialect: Dialect) -> DialectFeatures:
    """Return the features of `dialect`."""
    return _FEATURES[dialect]


def dialect_from_probe(reply: Reply) -> Dialect | None:
    """Return the dialect identified by the answer to `PROBE`; None if it identifies neither."""
    reading = read_value(PROBE, reply)
    if isinstance(reading, int) and reading > 0:
        return Dialect.E46
    if isinstance(reading, Refusal) and reading.kind is RefusalKind.ILLEGAL_COMMAND:
        return Dialect.D46
    return None


def dialect_from_version(text: str) -> Dialect | None:
    """Return the dialect of the controller named in the answer to `V`; None if it names none.

    A D48E is an E-series controller: the letter after the number decides.
    """
    version = read_version(text)
    if not isinstance(version, FirmwareVersion) or not version.controller:
        return None
    controller = version.controller
    return Dialect.E46 if "E" in controller else Dialect.D46
