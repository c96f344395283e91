"""Reply values: read a reply as a value, depending on the command that it answers.

What to use when: `read_value` for polling, where an invalid answer is counted and ignored; it
returns a `ValueFault` or a `Refusal` and raises nothing. The `require_*` functions where the value
is necessary, for example when a unit is opened; they raise `DeviceError`. The grammar is in tables:
`_QUANTITY_NOUNS`, `_OPPOSITE_BOUND_WORDS` and the patterns below.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu.ptu_commands import INT32_MAX, AnswerKind, PtuCommand
from gyrorig_protocol.ptu.ptu_events import Reply
from gyrorig_protocol.ptu.refusals import Refusal, classify_refusal


@dataclass(frozen=True, slots=True)
class ValueFault:
    """An answer without the requested value."""

    reason: str
    text: str


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """`*` alone: the command was executed."""


@dataclass(frozen=True, slots=True)  # `gyrorigd halt` loads this module, but not msgspec
class MotionReading:
    """Positions and speeds of both axes at the time of the counter: the answer to `B` or `BT`."""

    pan_steps: int
    tilt_steps: int
    pan_speed_steps_s: int
    tilt_speed_steps_s: int
    counter: int | None  # CNF ticks per second, wraps at an unknown width; None for B


@dataclass(frozen=True, slots=True)
class PowerReading:
    """Supply voltage and temperatures. D series: one; E series: head, pan, tilt."""

    supply_v: float
    temperatures_c: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class FirmwareVersion:
    """A firmware version and the controller named in it, "" if none is named."""

    number: str
    controller: str
    text: str


Value: TypeAlias = (
    Acknowledgement | int | float | MotionReading | PowerReading | FirmwareVersion | str
)
Reading: TypeAlias = Value | Refusal | ValueFault

ACKNOWLEDGEMENT: Final = Acknowledgement()
_COUNTER_MAX = 2**64 - 1  # the width of controller_time in recordings
_MAX_ARCSEC = 3600.0  # a full step of the 17.5:1 head is 370.29; no unit has one degree per step

# `22`, `Current Pan position is 22`, `Current Pan acceleration is 2000 positions/sec^2`.
_INTEGER_PATTERN = re.compile(r"(?:[A-Za-z][A-Za-z-]*\s+)*([-+]?\d{1,20})(?:\s+[A-Za-z]\S*)*")
# A decimal point is required; otherwise a late terse position would be read as a resolution.
_DECIMAL_PATTERN = re.compile(r"(\d{1,9}\.\d{0,12})(?:\s+[A-Za-z]+)*")
_MOTION_PATTERN = re.compile(
    r"P\s*\(\s*([-+]?\d{1,11})\s*,\s*([-+]?\d{1,11})\s*\)\s*"
    r"S\s*\(\s*([-+]?\d{1,11})\s*,\s*([-+]?\d{1,11})\s*\)\s*(\d{1,20})?"
)
_POWER_D_PATTERN = re.compile(
    r"(\d{1,3}(?:\.\d{1,3})?)\s*V\w*\s*@\s*(-?\d{1,3}(?:\.\d{1,3})?)\s*degF"
)
_POWER_E_PATTERN = re.compile(r"\d{1,3}(?:\.\d{1,3})?(?:\s*,\s*-?\d{1,3}(?:\.\d{1,3})?){1,3}")
_VERSION_PATTERN = re.compile(r"\bv?(\d{1,3}\.\d{1,3}(?:\.\w{1,12})?)", re.IGNORECASE)
_CONTROLLER_PATTERN = re.compile(r"\b([DE](?:46|47|48|100|300)\w{0,3})\b", re.IGNORECASE)

# By the second letter of a two-letter query: the noun in a verbose answer.
_QUANTITY_NOUNS = {
    "P": "position",
    "O": "position",
    "N": "position",
    "X": "position",
    "S": "speed",
    "D": "speed",
    "B": "speed",
    "U": "speed",
    "L": "speed",
    "A": "acceleration",
}
# By the same letter: a word that only the answer to another query can contain.
_OPPOSITE_BOUND_WORDS = {"N": "maximum", "X": "minimum", "U": "minimum", "L": "maximum"}
_OTHER_AXIS_NAMES = {"P": "tilt", "T": "pan"}


def read_value(command: PtuCommand, reply: Reply) -> Reading:
    """Read the value of `reply` to `command`; raises nothing.

    Returns:
        The value by `command.expects`; a `Refusal` if the unit answered with an error; a
        `ValueFault` if the answer cannot be to that command.
    """
    if not reply.ok:
        return classify_refusal(reply.text)
    return _READERS[command.answer_kind](reply.text, command.text)


def read_integer(text: str, query: str = "") -> int | ValueFault:
    """Return the integer of a terse or verbose answer.

    Args:
        text: such as `22`, or `Current Pan position is 22`. Only digits with space around them
            are a number, not the 2 of `positions/sec^2`. The answer to another kind of query, such
            as `P(1,2) S(3,4) 5`, is a fault.
        query: the command's text. An answer that names another axis or quantity is a fault, so
            that a late answer to an earlier query is rejected.
    """
    fault = _find_mismatch(text, query)
    if fault is not None:
        return fault
    match = _INTEGER_PATTERN.fullmatch(text)
    if match is None:
        return ValueFault("not one integer, alone or in a sentence", text)
    value = int(match.group(1))
    limit = _COUNTER_MAX if query in ("CNT", "CNF") else INT32_MAX
    return value if abs(value) <= limit else ValueFault("the integer is out of range", text)


def read_resolution_arcsec(text: str, query: str = "") -> float | ValueFault:
    """Return arc-seconds per position from `185.1428` or `185.1428 seconds arc per position`."""
    fault = _find_mismatch(text, query)
    if fault is not None:
        return fault
    match = _DECIMAL_PATTERN.fullmatch(text)
    if match is None:
        return ValueFault("not a decimal number", text)
    value = float(match.group(1))
    return value if 0.0 < value <= _MAX_ARCSEC else ValueFault("not a possible resolution", text)


def read_motion(text: str, with_counter: bool) -> MotionReading | ValueFault:
    """Read `P(-2300,550) S(600,200) 9278`; the answer to `B` has no counter."""
    match = _MOTION_PATTERN.fullmatch(text)
    if match is None:
        return ValueFault("not P(pan,tilt) S(pan,tilt)", text)
    *motion, ticks = match.groups()
    pan_steps, tilt_steps, pan_speed_steps_s, tilt_speed_steps_s = numbers = [*map(int, motion)]
    counter = None if ticks is None else int(ticks)
    if max(map(abs, numbers)) > INT32_MAX:
        return ValueFault("a position or speed is out of range", text)
    if with_counter and (counter is None or counter > _COUNTER_MAX):
        return ValueFault("no counter, or one out of range", text)
    return MotionReading(pan_steps, tilt_steps, pan_speed_steps_s, tilt_speed_steps_s, counter)


def read_power(text: str) -> PowerReading | ValueFault:
    """Return supply and temperatures from `Input 30 VDC @ 86 degF` or `13.2,99,97,104`."""
    match = _POWER_D_PATTERN.search(text)
    if match is not None:
        numbers = [float(part) for part in match.groups()]
    elif _POWER_E_PATTERN.fullmatch(text):
        numbers = [float(part) for part in text.split(",")]
    else:
        return ValueFault("no supply voltage and temperature", text)
    # Both dialects report degrees Fahrenheit.
    return PowerReading(numbers[0], tuple((degf - 32.0) / 1.8 for degf in numbers[1:]))


def read_version(text: str) -> FirmwareVersion | ValueFault:
    """Return the version in a text such as `Pan-Tilt Controller v1.90.0r0(D46 C14/E), ...`."""
    number = _VERSION_PATTERN.search(text)
    if number is None:
        return ValueFault("no version number", text)
    controller = _CONTROLLER_PATTERN.search(text)
    return FirmwareVersion(number.group(1), controller.group(1).upper() if controller else "", text)


def _read_acknowledgement(text: str, _query: str) -> Acknowledgement | ValueFault:
    return ValueFault("a value that was not requested", text) if text else ACKNOWLEDGEMENT


def _read_text(text: str, _query: str) -> str | ValueFault:
    return text if text else ValueFault("an empty answer", text)


_READERS: dict[AnswerKind, Callable[[str, str], Value | ValueFault]] = {
    AnswerKind.NOTHING: lambda text, _query: ValueFault("an answer without a query", text),
    AnswerKind.DONE: _read_acknowledgement,
    AnswerKind.INTEGER: read_integer,
    AnswerKind.RESOLUTION: read_resolution_arcsec,
    AnswerKind.MOTION: lambda text, _query: read_motion(text, with_counter=False),
    AnswerKind.MOTION_AND_COUNTER: lambda text, _query: read_motion(text, with_counter=True),
    AnswerKind.POWER: lambda text, _query: read_power(text),
    AnswerKind.VERSION: lambda text, _query: read_version(text),
    AnswerKind.WORD: _read_text,
    AnswerKind.TEXT: _read_text,
}


def require_done(command: PtuCommand, reply: Reply) -> None:
    """Check that `command` was executed.

    Raises:
        DeviceError: it was refused, or the answer is of another kind.
    """
    if not isinstance(_require_value(command, reply), Acknowledgement):
        raise _unreadable_error(command, reply.text, "a value that was not requested")


def require_integer(command: PtuCommand, reply: Reply) -> int:
    """Return the integer that answers `command`.

    Raises:
        DeviceError: the answer is not an integer.
    """
    value = _require_value(command, reply)
    if not isinstance(value, int):
        raise _unreadable_error(command, reply.text, "not an integer")
    return value


def require_resolution_arcsec(command: PtuCommand, reply: Reply) -> float:
    """Return the arc-seconds per position that answer `command`.

    Raises:
        DeviceError: the answer is not a resolution.
    """
    value = _require_value(command, reply)
    if not isinstance(value, float):
        raise _unreadable_error(command, reply.text, "not a resolution")
    return value


def _require_value(command: PtuCommand, reply: Reply) -> Value:
    reading = read_value(command, reply)
    if isinstance(reading, Refusal):
        raise DeviceError(
            f"the pan-tilt unit refused the command {command.text!r} "
            f"({reading.text or 'no reason given'})",
            reading.kind.value,
        )
    if isinstance(reading, ValueFault):
        raise _unreadable_error(command, reply.text, reading.reason)
    return reading


def _unreadable_error(command: PtuCommand, text: str, reason: str) -> DeviceError:
    return DeviceError(
        f"the pan-tilt unit sent the invalid answer {text[:60]!r} to the command "
        f"{command.text!r} ({reason})",
        "check the port, the baud rate and the dialect of the unit in the rig file",
    )


def _find_mismatch(text: str, query: str) -> ValueFault | None:
    """Return a fault if a verbose answer names another axis or quantity than `query`."""
    words = text.lower().split()
    if len(query) != 2 or not any(word.isalpha() for word in words):
        return None
    axis, quantity = query[0], query[1]
    if _OTHER_AXIS_NAMES.get(axis) in words:
        return ValueFault("the answer is for the other axis", text)
    noun = _QUANTITY_NOUNS.get(quantity)
    if noun is not None and noun not in words:
        return ValueFault(f"the answer is not about a {noun}", text)
    if _OPPOSITE_BOUND_WORDS.get(quantity) in words:
        return ValueFault("the answer is for the opposite bound", text)
    return None
