"""Read what a reply says, as a value, given which command it answers.

What to use when: `read` wherever a strange answer is to be counted and lived with (a
poll); it returns a `ValueFault` or a `Refusal` and raises nothing. The `require_*`
functions where there is no going on without the value (opening a unit); they raise
`DeviceError`. The grammar is data: `_NOUNS`, `_CONTRARY` and the patterns below.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu.commands import INT32_MAX, Expects, PtuCommand
from gyrorig_protocol.ptu.events import Reply
from gyrorig_protocol.ptu.refusals import Refusal, classify_refusal


@dataclass(frozen=True, slots=True)
class ValueFault:
    """An answer without the value that was asked for."""

    reason: str
    text: str


@dataclass(frozen=True, slots=True)
class Done:
    """`*` alone: it was done."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Both axes at one moment, as `B` and `BT` answer; the moment is the counter's."""

    pan_steps: int
    tilt_steps: int
    pan_speed_steps_s: int
    tilt_speed_steps_s: int
    counter: int | None  # of CNF ticks per second; wraps at an unknown width; None for B


@dataclass(frozen=True, slots=True)
class PowerState:
    """Supply and temperatures. D series has one temperature, E series head, pan, tilt."""

    supply_v: float
    temperatures_c: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Version:
    """A firmware version, and the controller named in it, "" where it names none."""

    number: str
    controller: str
    text: str


Value: TypeAlias = Done | int | float | Motion | PowerState | Version | str
Reading: TypeAlias = Value | Refusal | ValueFault

DONE: Final = Done()
_COUNTER_MAX = 2**64 - 1  # the width of controller_time in recordings
_MAX_ARCSEC = 3600.0  # a full step of the 17.5:1 head is 370.29: a degree a step is no unit

# `22`, `Current Pan position is 22`, `Current Pan acceleration is 2000 positions/sec^2`.
_INTEGER = re.compile(r"(?:[A-Za-z][A-Za-z-]*\s+)*([-+]?\d{1,20})(?:\s+[A-Za-z]\S*)*")
# A point is required: without it a stale terse position would pass for a resolution.
_DECIMAL = re.compile(r"(\d{1,9}\.\d{0,12})(?:\s+[A-Za-z]+)*")
_MOTION = re.compile(
    r"P\s*\(\s*([-+]?\d{1,11})\s*,\s*([-+]?\d{1,11})\s*\)\s*"
    r"S\s*\(\s*([-+]?\d{1,11})\s*,\s*([-+]?\d{1,11})\s*\)\s*(\d{1,20})?"
)
_POWER_D = re.compile(r"(\d{1,3}(?:\.\d{1,3})?)\s*V\w*\s*@\s*(-?\d{1,3}(?:\.\d{1,3})?)\s*degF")
_POWER_E = re.compile(r"\d{1,3}(?:\.\d{1,3})?(?:\s*,\s*-?\d{1,3}(?:\.\d{1,3})?){1,3}")
_VERSION = re.compile(r"\bv?(\d{1,3}\.\d{1,3}(?:\.\w{1,12})?)", re.IGNORECASE)
_CONTROLLER = re.compile(r"\b([DE](?:46|47|48|100|300)\w{0,3})\b", re.IGNORECASE)

# By the second letter of a two-letter query: the noun that a verbose answer names.
_NOUNS = {
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
# By the same letter: a word that only the answer to another query can hold.
_CONTRARY = {"N": "maximum", "X": "minimum", "U": "minimum", "L": "maximum"}
_OTHER_AXIS = {"P": "tilt", "T": "pan"}


def read(command: PtuCommand, reply: Reply) -> Reading:
    """Return what `reply` says in answer to `command`; raises nothing.

    Returns:
        The value by `command.expects`; a `Refusal` where the unit answered an error; a
        `ValueFault` where the answer cannot be that command's.
    """
    if not reply.ok:
        return classify_refusal(reply.text)
    return _READERS[command.expects](reply.text, command.text)


def read_integer(text: str, query: str = "") -> int | ValueFault:
    """Return the integer of a terse or verbose answer.

    Args:
        text: such as `22`, or `Current Pan position is 22`. The 2 of `positions/sec^2`
            is no number: only digits with space around them are. What another query
            answers, such as `P(1,2) S(3,4) 5`, is a fault.
        query: the command's text; an answer that names another axis or another quantity
            is a fault, so that a stale answer is not taken for this one's.
    """
    fault = _foreign(text, query)
    if fault is not None:
        return fault
    match = _INTEGER.fullmatch(text)
    if match is None:
        return ValueFault("not one integer, alone or in a sentence", text)
    value = int(match.group(1))
    limit = _COUNTER_MAX if query in ("CNT", "CNF") else INT32_MAX
    return value if abs(value) <= limit else ValueFault("the integer is out of range", text)


def read_resolution_arcsec(text: str, query: str = "") -> float | ValueFault:
    """Return arc-seconds per position from `185.1428` or `185.1428 seconds arc per position`."""
    fault = _foreign(text, query)
    if fault is not None:
        return fault
    match = _DECIMAL.fullmatch(text)
    if match is None:
        return ValueFault("no decimal number in front", text)
    value = float(match.group(1))
    return value if 0.0 < value <= _MAX_ARCSEC else ValueFault("no such resolution", text)


def read_motion(text: str, with_counter: bool) -> Motion | ValueFault:
    """Return what `P(-2300,550) S(600,200) 9278` says; `B` has no counter behind it."""
    match = _MOTION.fullmatch(text)
    if match is None:
        return ValueFault("not P(pan,tilt) S(pan,tilt)", text)
    pan, tilt, pan_speed, tilt_speed = (int(part) for part in match.groups()[:4])
    counter = None if match.group(5) is None else int(match.group(5))
    if max(abs(pan), abs(tilt), abs(pan_speed), abs(tilt_speed)) > INT32_MAX:
        return ValueFault("a position or speed is out of range", text)
    if with_counter and (counter is None or counter > _COUNTER_MAX):
        return ValueFault("no counter, or one out of range", text)
    return Motion(pan, tilt, pan_speed, tilt_speed, counter)


def read_power(text: str) -> PowerState | ValueFault:
    """Return supply and temperatures from `Input 30 VDC @ 86 degF` or `13.2,99,97,104`."""
    match = _POWER_D.search(text)
    if match is not None:
        numbers = [float(part) for part in match.groups()]
    elif _POWER_E.fullmatch(text):
        numbers = [float(part) for part in text.split(",")]
    else:
        return ValueFault("no supply voltage and temperature", text)
    # Both dialects report degrees Fahrenheit.
    return PowerState(numbers[0], tuple((degf - 32.0) / 1.8 for degf in numbers[1:]))


def read_version(text: str) -> Version | ValueFault:
    """Return the version in a text such as `Pan-Tilt Controller v1.90.0r0(D46 C14/E), ...`."""
    number = _VERSION.search(text)
    if number is None:
        return ValueFault("no version number", text)
    controller = _CONTROLLER.search(text)
    return Version(number.group(1), controller.group(1).upper() if controller else "", text)


def _read_done(text: str, _query: str) -> Done | ValueFault:
    return ValueFault("a value where none was asked for", text) if text else DONE


def _read_text(text: str, _query: str) -> str | ValueFault:
    return text if text else ValueFault("an empty answer", text)


_READERS: dict[Expects, Callable[[str, str], Value | ValueFault]] = {
    Expects.NOTHING: lambda text, _query: ValueFault("an answer to nothing", text),
    Expects.DONE: _read_done,
    Expects.INTEGER: read_integer,
    Expects.RESOLUTION: read_resolution_arcsec,
    Expects.MOTION: lambda text, _query: read_motion(text, with_counter=False),
    Expects.MOTION_AND_COUNTER: lambda text, _query: read_motion(text, with_counter=True),
    Expects.POWER: lambda text, _query: read_power(text),
    Expects.VERSION: lambda text, _query: read_version(text),
    Expects.WORD: _read_text,
    Expects.TEXT: _read_text,
}


def require_done(command: PtuCommand, reply: Reply) -> None:
    """Check that `command` was carried out.

    Raises:
        DeviceError: it was refused, or answered by something else.
    """
    if not isinstance(_require(command, reply), Done):
        raise _unreadable(command, reply.text, "a value where none was asked for")


def require_integer(command: PtuCommand, reply: Reply) -> int:
    """Return the integer that `command` asked for.

    Raises:
        DeviceError: the answer does not hold one.
    """
    value = _require(command, reply)
    if not isinstance(value, int):
        raise _unreadable(command, reply.text, "no integer")
    return value


def require_resolution_arcsec(command: PtuCommand, reply: Reply) -> float:
    """Return the arc-seconds per position that `command` asked for.

    Raises:
        DeviceError: the answer does not hold them.
    """
    value = _require(command, reply)
    if not isinstance(value, float):
        raise _unreadable(command, reply.text, "no resolution")
    return value


def require_motion(command: PtuCommand, reply: Reply) -> Motion:
    """Return the motion that `command` asked for.

    Raises:
        DeviceError: the answer does not hold it.
    """
    value = _require(command, reply)
    if not isinstance(value, Motion):
        raise _unreadable(command, reply.text, "no motion")
    return value


def require_text(command: PtuCommand, reply: Reply) -> str:
    """Return the text that `command` asked for.

    Raises:
        DeviceError: the answer is empty or an error.
    """
    value = _require(command, reply)
    if isinstance(value, Version):
        return value.text
    if not isinstance(value, str):
        raise _unreadable(command, reply.text, "no text")
    return value


def _require(command: PtuCommand, reply: Reply) -> Value:
    reading = read(command, reply)
    if isinstance(reading, Refusal):
        raise DeviceError(
            f"the pan-tilt unit refused {command.text!r}: {reading.text or 'no reason given'}",
            reading.kind.value,
        )
    if isinstance(reading, ValueFault):
        raise _unreadable(command, reply.text, reading.reason)
    return reading


def _unreadable(command: PtuCommand, text: str, reason: str) -> DeviceError:
    return DeviceError(
        f"the pan-tilt unit answered {text[:60]!r} to {command.text!r}",
        f"{reason}; check the port, the baud rate and the dialect",
    )


def _foreign(text: str, query: str) -> ValueFault | None:
    """Return a fault where a verbose answer names what `query` did not ask for."""
    words = text.lower().split()
    if len(query) != 2 or not any(word.isalpha() for word in words):
        return None
    axis, quantity = query[0], query[1]
    if _OTHER_AXIS.get(axis) in words:
        return ValueFault("the answer is for the other axis", text)
    noun = _NOUNS.get(quantity)
    if noun is not None and noun not in words:
        return ValueFault(f"the answer is not about a {noun}", text)
    if _CONTRARY.get(quantity) in words:
        return ValueFault("the answer is for the opposite bound", text)
    return None
