"""Commands of one axis of the emulated unit, and their replies.

A handler gets the unit, the time at which the command acts and the argument, and returns a `Reply`.
The texts are those of the command reference manual v3.00D, and of clients that match them on real
units. Where firmware versions differ, the dialect or a setting decides.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

from gyrorig_daemon.emulator.ptu.unit_controller import AxisState, UnitController


@dataclass(frozen=True, slots=True)
class Reply:
    """What a command gets. `terse` is None where the words stay in terse mode too."""

    verbose: str = ""
    terse: str | None = ""
    ok: bool = True
    done_s: float | None = None  # the reply waits until then


DONE = Reply()
ILLEGAL = Reply("Illegal Command Entered", None, ok=False)

Handler = Callable[[UnitController, float, int | None], Reply]
AxisHandler = Callable[[UnitController, AxisState, float, int | None], Reply]


def error_reply(text: str) -> Reply:
    """Return an error, which has its text in terse mode too."""
    return Reply(text, None, ok=False)


def value_reply(template: str, number: int | str) -> Reply:
    """Return a queried value, inserted for `{}` in the template."""
    return Reply(template.format(number), str(number))


def fixed_reply(text: str) -> Reply:
    """Return a text that is the same in terse mode."""
    return Reply(text, None)


def _out_of_bounds(unit: UnitController, state: AxisState, steps: int) -> Reply | None:
    bounds = unit.bounds(state)
    if bounds is None:
        return None
    if steps > bounds[1]:
        return error_reply(f"Maximum allowable {state.name} position is {bounds[1]}")
    if steps < bounds[0]:
        return error_reply(f"Minimum allowable {state.name} position is {bounds[0]}")
    return None


def _bad_speed(state: AxisState, speed: int) -> Reply | None:
    if speed > state.upper:
        return error_reply(f"{state.name} speed cannot exceed {state.upper} positions/sec")
    if speed < state.lower:
        return error_reply(f"Motor speed cannot be less than {state.lower} pos/sec")
    return None


def _position(unit: UnitController, state: AxisState, time_s: float, number: int | None) -> Reply:
    if number is None:
        return value_reply(f"Current {state.name} position is {{}}", state.count(time_s))
    refusal = _out_of_bounds(unit, state, number)
    if refusal is None:
        unit.request_position(state, time_s, number)
    return refusal or DONE


def _offset(unit: UnitController, state: AxisState, time_s: float, number: int | None) -> Reply:
    if number is None:
        adjective = "Target" if unit.settings.dialect == "e46" else "Current"
        return value_reply(f"{adjective} {state.name} position is {{}}", state.target())
    return _position(unit, state, time_s, state.count(time_s) + number)


def _speed(unit: UnitController, state: AxisState, time_s: float, number: int | None) -> Reply:
    if number is None:
        word = "Target" if unit.settings.dialect == "e46" else "Desired"
        return value_reply(f"{word} {state.name} speed is {{}} positions/sec", state.speed)
    if unit.in_velocity_mode:
        refusal = None if number == 0 else _bad_speed(state, abs(number))
        if refusal is None:
            unit.set_velocity(state, time_s, number)
        return refusal or DONE
    refusal = _bad_speed(state, number)
    if refusal is None:
        state.speed = number
        unit.apply_law(state, time_s)
    return refusal or DONE


def _speed_change(
    unit: UnitController, state: AxisState, time_s: float, number: int | None
) -> Reply:
    current = state.speed_now(time_s)
    if number is None:
        return value_reply(f"Current {state.name} speed is {{}} positions/sec", current)
    return _speed(
        unit, state, time_s, (current if unit.in_velocity_mode else abs(current)) + number
    )


def _recompute(unit: UnitController, state: AxisState, time_s: float) -> Reply:
    """Wait until both axes have stopped, then for the tables."""
    done_s = max(time_s, unit.rests_at_s()) + unit.settings.recompute_s
    state.axis.set_law(done_s, state.law())
    return Reply(done_s=done_s)


def _acceleration(
    unit: UnitController, state: AxisState, time_s: float, number: int | None
) -> Reply:
    if number is None:
        unit_text = "positions/" + unit.settings.acceleration_text
        return value_reply(
            f"Current {state.name} acceleration is {{}} {unit_text}", state.acceleration
        )
    if number < 1:
        return error_reply(f"{state.name} acceleration is out of range")
    state.acceleration = number
    return _recompute(unit, state, time_s)


def _base_speed(unit: UnitController, state: AxisState, time_s: float, number: int | None) -> Reply:
    if number is None:
        return value_reply(f"Current {state.name} base speed is {{}} positions/sec", state.base)
    if number > state.upper:
        return error_reply(f"{state.name} speed cannot exceed {state.upper} positions/sec")
    if number < 0:
        return error_reply("Motor speed cannot be less than 0 pos/sec")
    state.base = number
    return _recompute(unit, state, time_s)


def _upper_speed(
    unit: UnitController, state: AxisState, time_s: float, number: int | None
) -> Reply:
    if number is None:
        return value_reply(f"Maximum {state.name} speed is {{}} positions/sec", state.upper)
    highest = round(unit.settings.speed_limit_steps_s * state.ratio)
    if number > highest:
        return error_reply(f"{state.name} speed cannot exceed {highest} positions/sec")
    if number < state.lower:
        return error_reply(f"Motor speed cannot be less than {state.lower} pos/sec")
    state.upper = number
    state.speed = min(state.speed, number)
    return _recompute(unit, state, time_s)


def _lower_speed(
    _unit: UnitController, state: AxisState, _time_s: float, number: int | None
) -> Reply:
    if number is None:
        return value_reply(f"Minimum {state.name} speed is {{}} positions/sec", state.lower)
    if number > state.upper:
        return error_reply(f"{state.name} speed cannot exceed {state.upper} positions/sec")
    if number < 0:
        return error_reply("Motor speed cannot be less than 0 pos/sec")
    state.lower = number
    return DONE


def _resolution(
    unit: UnitController, state: AxisState, _time_s: float, number: int | None
) -> Reply:
    if number is not None:
        return ILLEGAL
    arcsec = unit.settings.resolution_arcsec / state.ratio
    if unit.settings.dialect == "d46":
        # The manual truncates the digits: 185.1428 instead of 185.142857.
        return value_reply(
            f"{{}} seconds arc per {state.name} position", f"{int(arcsec * 1e4) / 1e4:.4f}"
        )
    return value_reply("{} seconds arc per position", f"{arcsec:.6f}")


def _minimum(_unit: UnitController, state: AxisState, _time_s: float, number: int | None) -> Reply:
    low = state.factory_limits()[0]
    return (
        ILLEGAL
        if number is not None
        else value_reply(f"Minimum {state.name} position is {{}}", low)
    )


def _maximum(_unit: UnitController, state: AxisState, _time_s: float, number: int | None) -> Reply:
    high = state.factory_limits()[1]
    return (
        ILLEGAL
        if number is not None
        else value_reply(f"Maximum {state.name} position is {{}}", high)
    )


def _user_minimum(
    _unit: UnitController, state: AxisState, _time_s: float, number: int | None
) -> Reply:
    if number is None:
        return value_reply(f"Minimum user {state.name} position is {{}}", state.user_minimum)
    if number > 0:
        return error_reply(f"Maximum allowable {state.name} position is 0")
    state.user_minimum = number
    return DONE


def _user_maximum(
    _unit: UnitController, state: AxisState, _time_s: float, number: int | None
) -> Reply:
    if number is None:
        return value_reply(f"Maximum user {state.name} position is {{}}", state.user_maximum)
    if number < 0:
        return error_reply(f"Minimum allowable {state.name} position is 0")
    state.user_maximum = number
    return DONE


def _hold_power(level: str | None) -> AxisHandler:
    def handler(
        _unit: UnitController, state: AxisState, _time_s: float, number: int | None
    ) -> Reply:
        if number is not None:
            return ILLEGAL
        if level is None:
            return Reply(state.hold_power, state.hold_power[:3])
        state.hold_power = level
        return DONE

    return handler


def _move_power(level: str | None) -> AxisHandler:
    def handler(
        _unit: UnitController, state: AxisState, _time_s: float, number: int | None
    ) -> Reply:
        if number is not None:
            return ILLEGAL
        if level is None:
            return Reply(state.move_power, state.move_power[:3])
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


def run_axis_command(unit: UnitController, text: str, time_s: float) -> Reply | None:
    """Run a command of one axis; None if `text` is not one."""
    match = _COMMAND.fullmatch(text)
    if match is None or text[0] not in "PT":
        return None
    handler = AXIS_COMMANDS.get(match[1][1:])
    if handler is None:
        return None
    state = unit.axes["P" if text[0] == "P" else "T"]
    return handler(unit, state, time_s, int(match[2]) if match[2] else None)


def check_position(unit: UnitController, state: AxisState, steps: int) -> Reply | None:
    """Return the refusal of a target, None when it is inside the limits."""
    return _out_of_bounds(unit, state, steps)


def check_speed(state: AxisState, speed: int) -> Reply | None:
    """Return the refusal of a speed, None when it is inside the bounds."""
    return _bad_speed(state, speed)
