"""Commands for a pan-tilt unit, limited to those that the daemon is allowed to send.

What to use when: the constants for commands without an argument; `query_quantity` and
`assign_quantity` for a quantity of an axis. `PtuCommand.encode()` returns the bytes to send;
`reply_values.read_value` reads the answer.

Every command ends with a space, never with CR, because after a CR a real unit begins its answer
with an LF (source: a client of a D48E). Left out on purpose: DS, DF, DR and LD (they write the
EEPROM, discard the operator's settings or unlock the limits), `@` (changes the baud rate), M (any
following byte moves the unit) and U (silences it).
"""

from dataclasses import dataclass
from enum import Enum, StrEnum

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.ptu.ptu_events import Axis

INT32_MAX = 2**31 - 1  # the range of positions in recordings; no unit counts further


class AnswerKind(Enum):
    """The kind of answer to a command, for `reply_values.read_value`."""

    NOTHING = "no answer"
    DONE = "* alone"
    INTEGER = "one integer"
    RESOLUTION = "arc-seconds per position"
    MOTION = "positions and speeds of both axes"
    MOTION_AND_COUNTER = "positions, speeds and the controller's counter"
    POWER = "supply voltage and temperatures"
    VERSION = "a firmware version"
    WORD = "a mode in words"
    TEXT = "free text"


@dataclass(frozen=True, slots=True)
class PtuCommand:
    """One command: its text, the kind of its answer, and the timeout for the answer."""

    text: str
    answer_kind: AnswerKind
    timeout_s: float = 1.0  # ten times the period of the vendor's lowest rate, 10 commands/s

    def encode(self) -> bytes:
        """Return the bytes to write."""
        return f"{self.text} ".encode("ascii")


class Quantity(StrEnum):
    """A quantity of an axis; the value is its letter in commands."""

    POSITION = "P"  # steps; assigned: the target, queried: the present position
    OFFSET = "O"  # steps; assigned: relative to the position, queried: the target
    SPEED = "S"  # steps/s; the desired speed, not the present one
    SPEED_CHANGE = "D"  # steps/s; assigned: relative to the present speed, queried: present
    ACCELERATION = "A"  # steps/s^2, above the base speed
    BASE_SPEED = "B"  # steps/s, reached without a ramp
    UPPER_SPEED = "U"  # steps/s
    LOWER_SPEED = "L"  # steps/s
    RESOLUTION = "R"  # arc-seconds per position, queried only
    MINIMUM = "N"  # steps, found by the last reset, queried only
    MAXIMUM = "X"  # steps, found by the last reset, queried only


_QUERY_ONLY = (Quantity.RESOLUTION, Quantity.MINIMUM, Quantity.MAXIMUM)
_SIGNED_QUANTITIES = (Quantity.POSITION, Quantity.OFFSET, Quantity.SPEED_CHANGE)
# The unit recomputes its speed tables: "several seconds" (manual v3.00D), > 6 s for PL and more
# than 300 s for PU on one unit (comments in a client). After 15 s the command is sent again.
_RECOMPUTE_TIMEOUT_S = 15.0
_RECOMPUTING_QUANTITIES = (
    Quantity.ACCELERATION,
    Quantity.BASE_SPEED,
    Quantity.UPPER_SPEED,
    Quantity.LOWER_SPEED,
)
_RESET_TIMEOUT_S = 90.0  # existing clients wait 15, 30 and 60 s for both axes

RESYNCHRONISE = PtuCommand("", AnswerKind.NOTHING)  # a delimiter alone ends any unfinished command
ENABLE_ECHO = PtuCommand("EE", AnswerKind.DONE)
DISABLE_ECHO = PtuCommand("ED", AnswerKind.DONE)
QUERY_ECHO = PtuCommand("E", AnswerKind.WORD)
TERSE_FEEDBACK = PtuCommand("FT", AnswerKind.DONE)
VERBOSE_FEEDBACK = PtuCommand("FV", AnswerKind.DONE)
QUERY_FEEDBACK = PtuCommand("F", AnswerKind.WORD)
INDEPENDENT_SPEED = PtuCommand("CI", AnswerKind.DONE)
QUERY_SPEED_MODE = PtuCommand("C", AnswerKind.WORD)
IMMEDIATE_EXECUTION = PtuCommand("I", AnswerKind.DONE)
SLAVED_EXECUTION = PtuCommand("S", AnswerKind.DONE)
# Answered only when both axes have arrived: do not use it in a polling loop.
AWAIT_COMPLETION = PtuCommand("A", AnswerKind.DONE, timeout_s=_RESET_TIMEOUT_S)
QUERY_LIMITS = PtuCommand("L", AnswerKind.WORD)
ENABLE_LIMITS = PtuCommand("LE", AnswerKind.DONE)
HALT_BOTH_AXES = PtuCommand("H", AnswerKind.DONE)
RESET_BOTH_AXES = PtuCommand("R", AnswerKind.DONE, timeout_s=_RESET_TIMEOUT_S)
QUERY_VERSION = PtuCommand("V", AnswerKind.VERSION)
QUERY_MODEL = PtuCommand("VM", AnswerKind.TEXT)  # E series
QUERY_SERIAL = PtuCommand("VS", AnswerKind.TEXT)  # E series
QUERY_POWER = PtuCommand("O", AnswerKind.POWER)
QUERY_MOTION = PtuCommand("B", AnswerKind.MOTION)  # E series
QUERY_MOTION_AND_COUNTER = PtuCommand("BT", AnswerKind.MOTION_AND_COUNTER)  # E series
QUERY_COUNTER = PtuCommand("CNT", AnswerKind.INTEGER)  # E series
QUERY_COUNTER_HZ = PtuCommand("CNF", AnswerKind.INTEGER)  # E series


def query_quantity(axis: Axis, quantity: Quantity) -> PtuCommand:
    """Return the command that queries `quantity` of `axis`."""
    is_resolution = quantity is Quantity.RESOLUTION
    return PtuCommand(
        f"{axis.value}{quantity.value}",
        AnswerKind.RESOLUTION if is_resolution else AnswerKind.INTEGER,
    )


def assign_quantity(axis: Axis, quantity: Quantity, value: int) -> PtuCommand:
    """Return the command that sets `quantity` of `axis` to `value`.

    Args:
        axis: which axis.
        quantity: the quantity to set.
        value: in the unit of the quantity: steps, steps/s or steps/s^2.

    Raises:
        UsageError: the quantity is read-only, or the value is out of range.
    """
    name = quantity.name.lower().replace("_", " ")
    if quantity in _QUERY_ONLY:
        raise UsageError(
            f"the {name} of the {axis.label} axis cannot be set, because it is read-only",
            "read the value with a query",
        )
    if abs(value) > INT32_MAX or (value < 0 and quantity not in _SIGNED_QUANTITIES):
        raise UsageError(
            f"the value {value} is not a valid {name} of the {axis.label} axis",
            "give a value within the range of the pan-tilt unit",
        )
    timeout_s = _RECOMPUTE_TIMEOUT_S if quantity in _RECOMPUTING_QUANTITIES else 1.0
    return PtuCommand(f"{axis.value}{quantity.value}{value:d}", AnswerKind.DONE, timeout_s)


def halt_axis(axis: Axis) -> PtuCommand:
    """Return the command that stops one axis; `HALT_BOTH_AXES` stops both."""
    return PtuCommand(f"H{axis.value}", AnswerKind.DONE)


def reset_axis(axis: Axis) -> PtuCommand:
    """Return the command that homes one axis; `RESET_BOTH_AXES` homes both."""
    return PtuCommand(f"R{axis.value}", AnswerKind.DONE, _RESET_TIMEOUT_S)


def query_step_mode(axis: Axis) -> PtuCommand:
    """Return the command that queries the step mode of an axis."""
    return PtuCommand(f"W{axis.value}", AnswerKind.WORD)


def query_hold_power(axis: Axis) -> PtuCommand:
    """Return the command that queries the motor current at rest."""
    return PtuCommand(f"{axis.value}H", AnswerKind.WORD)


def query_move_power(axis: Axis) -> PtuCommand:
    """Return the command that queries the motor current in motion."""
    return PtuCommand(f"{axis.value}M", AnswerKind.WORD)
