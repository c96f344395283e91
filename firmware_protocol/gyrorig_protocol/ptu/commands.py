"""Commands for a pan-tilt unit: only those that a daemon may send.

What to use when: the constants for commands without an argument; `query` and `assign`
for an axis and a quantity; `set_step_mode`, `set_hold_power`, `set_move_power` for the
modes. `PtuCommand.encode()` gives the bytes; `values.read` reads the answer.

Every command ends with a space, never CR: after a CR a real unit begins its answer with
an LF (client of a D48E). Left out on purpose: DS, DF, DR and LD (they write the EEPROM,
undo the operator's settings or unlock the limits), `@` (changes the baud rate), M (any
byte then moves the unit) and U (silences it).
"""

from dataclasses import dataclass
from enum import Enum, StrEnum

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.ptu.events import Axis

INT32_MAX = 2**31 - 1  # the width of positions in recordings; no unit counts further


class Expects(Enum):
    """What kind of answer a command gets; `values.read` goes by it."""

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
    """One command: what to send, what answer it gets, how long that may take."""

    text: str
    expects: Expects
    patience_s: float = 1.0  # vendor rate: 10 commands/s at the slowest, so ten times that

    def encode(self) -> bytes:
        """Return the bytes to write."""
        return f"{self.text} ".encode("ascii")


class Quantity(StrEnum):
    """What an axis can be asked for or told; the value is its letter in commands."""

    POSITION = "P"  # steps; assigned: the target, queried: where it is
    OFFSET = "O"  # steps; assigned: relative to here, queried: the target
    SPEED = "S"  # steps/s; the desired speed, not the present one
    SPEED_CHANGE = "D"  # steps/s; assigned: relative to the present speed, queried: present
    ACCELERATION = "A"  # steps/s^2, above the base speed
    BASE_SPEED = "B"  # steps/s, reached without a ramp
    UPPER_SPEED = "U"  # steps/s
    LOWER_SPEED = "L"  # steps/s
    RESOLUTION = "R"  # arc-seconds per position, queried only
    MINIMUM = "N"  # steps, found by the last reset, queried only
    MAXIMUM = "X"  # steps, found by the last reset, queried only


_QUERIED_ONLY = (Quantity.RESOLUTION, Quantity.MINIMUM, Quantity.MAXIMUM)
_SIGNED = (Quantity.POSITION, Quantity.OFFSET, Quantity.SPEED_CHANGE)
# The speed tables are recomputed: "several seconds" (manual v3.00D), > 6 s for PL and no
# end within 300 s for PU on one unit (comments of a client). Given 15 s, then asked again.
_RECOMPUTE_S = 15.0
_RECOMPUTED = (
    Quantity.ACCELERATION,
    Quantity.BASE_SPEED,
    Quantity.UPPER_SPEED,
    Quantity.LOWER_SPEED,
)
_RESET_S = 90.0  # clients allow 15, 30 and 60 s for both axes

RESYNC = PtuCommand("", Expects.NOTHING)  # a bare delimiter ends any pending parse
ECHO_ON = PtuCommand("EE", Expects.DONE)
ECHO_OFF = PtuCommand("ED", Expects.DONE)
QUERY_ECHO = PtuCommand("E", Expects.WORD)
TERSE = PtuCommand("FT", Expects.DONE)
VERBOSE = PtuCommand("FV", Expects.DONE)
QUERY_FEEDBACK = PtuCommand("F", Expects.WORD)
INDEPENDENT_SPEED = PtuCommand("CI", Expects.DONE)
QUERY_SPEED_MODE = PtuCommand("C", Expects.WORD)
IMMEDIATE = PtuCommand("I", Expects.DONE)
SLAVED = PtuCommand("S", Expects.DONE)
# Answered when both axes are there and not before: never in a loop that polls.
AWAIT = PtuCommand("A", Expects.DONE, patience_s=_RESET_S)
QUERY_LIMITS = PtuCommand("L", Expects.WORD)
LIMITS_ON = PtuCommand("LE", Expects.DONE)
HALT = PtuCommand("H", Expects.DONE)
RESET = PtuCommand("R", Expects.DONE, patience_s=_RESET_S)
QUERY_VERSION = PtuCommand("V", Expects.VERSION)
QUERY_MODEL = PtuCommand("VM", Expects.TEXT)  # E series
QUERY_SERIAL = PtuCommand("VS", Expects.TEXT)  # E series
QUERY_POWER = PtuCommand("O", Expects.POWER)
QUERY_MOTION = PtuCommand("B", Expects.MOTION)  # E series
QUERY_MOTION_AND_COUNTER = PtuCommand("BT", Expects.MOTION_AND_COUNTER)  # E series
QUERY_COUNTER = PtuCommand("CNT", Expects.INTEGER)  # E series
QUERY_COUNTER_HZ = PtuCommand("CNF", Expects.INTEGER)  # E series


class StepMode(StrEnum):
    """How a motor step is divided; the unit recalibrates the axis, that is, it moves."""

    FULL = "F"
    HALF = "H"
    QUARTER = "Q"
    EIGHTH = "E"
    AUTO = "A"


class Power(StrEnum):
    """Motor current; OFF is for holding only, HIGH for moving only."""

    HIGH = "H"
    REGULAR = "R"
    LOW = "L"
    OFF = "O"


def query(axis: Axis, quantity: Quantity) -> PtuCommand:
    """Return the command that asks `axis` for `quantity`."""
    resolution = quantity is Quantity.RESOLUTION
    return PtuCommand(
        f"{axis.value}{quantity.value}", Expects.RESOLUTION if resolution else Expects.INTEGER
    )


def assign(axis: Axis, quantity: Quantity, value: int) -> PtuCommand:
    """Return the command that tells `axis` the `value` of `quantity`.

    Args:
        axis: which axis.
        quantity: what is told.
        value: steps, steps/s or steps/s^2, as the quantity says.

    Raises:
        UsageError: the quantity can only be asked for, or the value has no meaning.
    """
    name = quantity.name.lower().replace("_", " ")
    if quantity in _QUERIED_ONLY:
        raise UsageError(f"the {name} of the {axis.word} axis", "can be asked for, not set")
    if abs(value) > INT32_MAX or (value < 0 and quantity not in _SIGNED):
        raise UsageError(f"{value} is no {name}", "give a value that the unit can count")
    patience_s = _RECOMPUTE_S if quantity in _RECOMPUTED else 1.0
    return PtuCommand(f"{axis.value}{quantity.value}{value:d}", Expects.DONE, patience_s)


def halt(axis: Axis) -> PtuCommand:
    """Return the command that brings one axis to rest; `HALT` does it to both."""
    return PtuCommand(f"H{axis.value}", Expects.DONE)


def reset(axis: Axis) -> PtuCommand:
    """Return the command that homes one axis; `RESET` does it to both."""
    return PtuCommand(f"R{axis.value}", Expects.DONE, _RESET_S)


def query_step_mode(axis: Axis) -> PtuCommand:
    """Return the command that asks for an axis' step mode."""
    return PtuCommand(f"W{axis.value}", Expects.WORD)


def set_step_mode(axis: Axis, mode: StepMode) -> PtuCommand:
    """Return the command that sets an axis' step mode. The axis may move."""
    return PtuCommand(f"W{axis.value}{mode.value}", Expects.DONE, _RESET_S)


def query_hold_power(axis: Axis) -> PtuCommand:
    """Return the command that asks for the motor current at rest."""
    return PtuCommand(f"{axis.value}H", Expects.WORD)


def set_hold_power(axis: Axis, power: Power) -> PtuCommand:
    """Return the command that sets the motor current at rest.

    Raises:
        UsageError: HIGH is for moving.
    """
    if power is Power.HIGH:
        raise UsageError("the holding current cannot be high", "choose regular, low or off")
    return PtuCommand(f"{axis.value}H{power.value}", Expects.DONE)


def query_move_power(axis: Axis) -> PtuCommand:
    """Return the command that asks for the motor current in motion."""
    return PtuCommand(f"{axis.value}M", Expects.WORD)


def set_move_power(axis: Axis, power: Power) -> PtuCommand:
    """Return the command that sets the motor current in motion.

    Raises:
        UsageError: OFF is for holding.
    """
    if power is Power.OFF:
        raise UsageError("the moving current cannot be off", "choose high, regular or low")
    return PtuCommand(f"{axis.value}M{power.value}", Expects.DONE)
