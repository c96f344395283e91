"""What the unit's commands do and answer: two tables, one for axis commands, one for the rest.

A handler gets the unit, the time at which the command acts and the argument, and returns
an `Answer`. Texts are those of the command reference manual v3.00D and of clients that
match them on real units (reference survey of PTU clients); where firmware differs, the
dialect or a setting chooses.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

from gyrorig_daemon.emulator.ptu.unit import AxisState, PtuUnit


@dataclass(frozen=True, slots=True)
class Answer:
    """What a command gets. `terse` is None where the words stay in terse mode too."""

    words: str = ""
    terse: str | None = ""
    ok: bool = True
    done_s: float | None = None  # the reply waits until then


DONE = Answer()
ILLEGAL = Answer("Illegal Command Entered", None, ok=False)

Handler = Callable[[PtuUnit, float, int | None], Answer]
AxisHandler = Callable[[PtuUnit, AxisState, float, int | None], Answer]


def refuse(text: str) -> Answer:
    """Return an error; errors have their words in terse mode too."""
    return Answer(text, None, ok=False)


def value(words: str, number: int | str) -> Answer:
    """Return a queried value; `{}` in the words is its place."""
    return Answer(words.format(number), str(number))


def always(words: str) -> Answer:
    """Return a text that terse mode does not shorten."""
    return Answer(words, None)


def _out_of_bounds(unit: PtuUnit, state: AxisState, steps: int) -> Answer | None:
    bounds = unit.bounds(state)
    if bounds is None:
        return None
    if steps > bounds[1]:
        return refuse(f"Maximum allowable {state.name} position is {bounds[1]}")
    if steps < bounds[0]:
        return refuse(f"Minimum allowable {state.name} position is {bounds[0]}")
    return None


def _bad_speed(state: AxisState, speed: int) -> Answer | None:
    if speed > state.upper:
        return refuse(f"{state.name} speed cannot exceed {state.upper} positions/sec")
    if speed < state.lower:
        return refuse(f"Motor speed cannot be less than {state.lower} pos/sec")
    return None


def _position(unit: PtuUnit, state: AxisState, time_s: float, number: int | None) -> Answer:
    if number is None:
        return value(f"Current {state.name} position is {{}}", state.count(time_s))
    fault = _out_of_bounds(unit, state, number)
    if fault is None:
        unit.begin(state, time_s, number)
    return fault or DONE


def _offset(unit: PtuUnit, state: AxisState, time_s: float, number: int | None) -> Answer:
    if number is None:
        word = "Target" if unit.settings.dialect == "e46" else "Current"
        return value(f"{word} {state.name} position is {{}}", state.target())
    return _position(unit, state, time_s, state.count(time_s) + number)


def _speed(unit: PtuUnit, state: AxisState, time_s: float, number: int | None) -> Answer:
    if number is None:
        word = "Target" if unit.settings.dialect == "e46" else "Desired"
        return value(f"{word} {state.name} speed is {{}} positions/sec", state.speed)
    if unit.velocity:
        fault = None if number == 0 else _bad_speed(state, abs(number))
        if fault is None:
            unit.drive(state, time_s, number)
        return fault or DONE
    fault = _bad_speed(state, number)
    if fault is None:
        state.speed = number
        unit.apply_law(state, time_s)
    return fault or DONE


def _speed_change(unit: PtuUnit, state: AxisState, time_s: float, number: int | None) -> Answer:
    now = state.speed_now(time_s)
    if number is None:
        return value(f"Current {state.name} speed is {{}} positions/sec", now)
    return _speed(unit, state, time_s, (now if unit.velocity else abs(now)) + number)


def _recompute(unit: PtuUnit, state: AxisState, time_s: float) -> Answer:
    """Wait for both axes to rest, then for the tables; nothing changes on the fly."""
    done_s = max(time_s, unit.rests_at_s()) + unit.settings.recompute_s
    state.axis.set_law(done_s, state.law())
    return Answer(done_s=done_s)


def _acceleration(unit: PtuUnit, state: AxisState, time_s: float, number: int | None) -> Answer:
    if number is None:
        unit_text = "positions/" + unit.settings.acceleration_text
        return value(f"Current {state.name} acceleration is {{}} {unit_text}", state.acceleration)
    if number < 1:
        return refuse(f"{state.name} acceleration is out of range")
    state.acceleration = number
    return _recompute(unit, state, time_s)


def _base_speed(unit: PtuUnit, state: AxisState, time_s: float, number: int | None) -> Answer:
    if number is None:
        return value(f"Current {state.name} base speed is {{}} positions/sec", state.base)
    if number > state.upper:
        return refuse(f"{state.name} speed cannot exceed {state.upper} positions/sec")
    if number < 0:
        return refuse("Motor speed cannot be less than 0 pos/sec")
    state.base = number
    return _recompute(unit, state, time_s)


def _upper_speed(unit: PtuUnit, state: AxisState, time_s: float, number: int | None) -> Answer:
    if number is None:
        return value(f"Maximum {state.name} speed is {{}} positions/sec", state.upper)
    highest = round(unit.settings.speed_limit_steps_s * state.ratio)
    if number > highest:
        return refuse(f"{state.name} speed cannot exceed {highest} positions/sec")
    if number < state.lower:
        return refuse(f"Motor speed cannot be less than {state.lower} pos/sec")
    state.upper = number
    state.speed = min(state.speed, number)
    return _recompute(unit, state, time_s)


def _lower_speed(_unit: PtuUnit, state: AxisState, _time_s: float, number: int | None) -> Answer:
    if number is None:
        return value(f"Minimum {state.name} speed is {{}} positions/sec", state.lower)
    if number > state.upper:
        return refuse(f"{state.name} speed cannot exceed {state.upper} positions/sec")
    if number < 0:
        return refuse("Motor speed cannot be less than 0 pos/sec")
    state.lower = number
    return DONE


def _resolution(unit: PtuUnit, state: AxisState, _time_s: float, number: int | None) -> Answer:
    if number is not None:
        return ILLEGAL
    arcsec = unit.settings.resolution_arcsec / state.ratio
    if unit.settings.dialect == "d46":
        # The manual's own text cuts the digits: 185.1428 of 185.142857.
        return value(
            f"{{}} seconds arc per {state.name} position", f"{int(arcsec * 1e4) / 1e4:.4f}"
        )
    return value("{} seconds arc per position", f"{arcsec:.6f}")


def _minimum(_unit: PtuUnit, state: AxisState, _time_s: float, number: int | None) -> Answer:
    low = state.factory_limits()[0]
    return ILLEGAL if number is not None else value(f"Minimum {state.name} position is {{}}", low)


def _maximum(_unit: PtuUnit, state: AxisState, _time_s: float, number: int | None) -> Answer:
    high = state.factory_limits()[1]
    return ILLEGAL if number is not None else value(f"Maximum {state.name} position is {{}}", high)


def _user_minimum(_unit: PtuUnit, state: AxisState, _time_s: float, number: int | None) -> Answer:
    if number is None:
        return value(f"Minimum user {state.name} position is {{}}", state.user_minimum)
    if number > 0:
        return refuse(f"Maximum allowable {state.name} position is 0")
    state.user_minimum = number
    return DONE


def _user_maximum(_unit: PtuUnit, state: AxisState, _time_s: float, number: int | None) -> Answer:
    if number is None:
        return value(f"Maximum user {state.name} position is {{}}", state.user_maximum)
    if number < 0:
        return refuse(f"Minimum allowable {state.name} position is 0")
    state.user_maximum = number
    return DONE


def _hold_power(level: str | None) -> AxisHandler:
    def handler(_unit: PtuUnit, state: AxisState, _time_s: float, number: int | None) -> Answer:
        if number is not None:
            return ILLEGAL
        if level is None:
            return Answer(state.hold_power, state.hold_power[:3])
        state.hold_power = level
        return DONE

    return handler


def _move_power(level: str | None) -> AxisHandler:
    def handler(_unit: PtuUnit, state: AxisState, _time_s: float, number: int | None) -> Answer:
        if number is not None:
            return ILLEGAL
        if level is None:
            return Answer(state.move_power, state.move_power[:3])
        state.move_power = level
        return DONE

    return handler


# After the axis letter. Longer names are tried first.
AXIS_COMMANDS: dict[str, AxisHandler] = {
    "P": _position,
    "O": _offset,
    "S": _speed,
    "D": _speed_change,
    "A": _acceleration,
    "B": _base_speed,
    "U": _upper_speed,
    "L": _lower_speed,
    "R": _resolution,
    "N": _minimum,
    "X": _maximum,
    "NU": _user_minimum,
    "XU": _user_maximum,
    "H": _hold_power(None),
    "HR": _hold_power("REGULAR"),
    "HL": _hold_power("LOW"),
    "HO": _hold_power("OFF"),
    "M": _move_power(None),
    "MH": _move_power("HIGH"),
    "MR": _move_power("REGULAR"),
    "ML": _move_power("LOW"),
}

_COMMAND = re.compile(r"([A-Z?]+)([+-]?\d{1,9})?")


def run_axis_command(unit: PtuUnit, text: str, time_s: float) -> Answer | None:
    """Run a command of one axis; None when `text` is none."""
    match = _COMMAND.fullmatch(text)
    if match is None or text[0] not in "PT":
        return None
    handler = AXIS_COMMANDS.get(match[1][1:])
    if handler is None:
        return None
    state = unit.axes["P" if text[0] == "P" else "T"]
    return handler(unit, state, time_s, int(match[2]) if match[2] else None)


def check_position(unit: PtuUnit, state: AxisState, steps: int) -> Answer | None:
    """Return the refusal of a target, None when it is inside the limits."""
    return _out_of_bounds(unit, state, steps)


def check_speed(state: AxisState, speed: int) -> Answer | None:
    """Return the refusal of a speed, None when it is inside the bounds."""
    return _bad_speed(state, speed)
