"""Commands of the whole emulated unit: modes, resets, commands to both axes.

`run_command` is the entry point. It looks up the command here and among those of an axis, and
returns the firmware's reply to an unknown command.
"""

import re
from collections.abc import Callable

from gyrorig_daemon.emulator.emulator_settings import StepMode
from gyrorig_daemon.emulator.ptu import unit_answers as answers
from gyrorig_daemon.emulator.ptu.axis_commands import (
    DONE,
    ILLEGAL,
    Reply,
    check_position,
    check_speed,
    error_reply,
    fixed_reply,
    run_axis_command,
    value_reply,
)
from gyrorig_daemon.emulator.ptu.unit_controller import LETTERS, AxisState, Letter, UnitController

UnitHandler = Callable[[UnitController, float], Reply]

BAUDS = (600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)


def run_command(unit: UnitController, text: str, time_s: float) -> Reply:
    """Run one command, upper case and without its delimiter, at a time."""
    handler = _COMMANDS.get(text)
    if handler is not None:
        if text in _E_SERIES and unit.settings.dialect != "e46":
            return ILLEGAL
        return handler(unit, time_s)
    for pattern, parsed in _PATTERNS:
        match = pattern.fullmatch(text)
        if match is not None:
            return parsed(unit, time_s, match)
    return run_axis_command(unit, text, time_s) or ILLEGAL


def _set_echo(on: bool) -> UnitHandler:
    def handler(unit: UnitController, _time_s: float) -> Reply:
        unit.echo = on
        return DONE

    return handler


def _set_feedback(verbose: bool) -> UnitHandler:
    def handler(unit: UnitController, _time_s: float) -> Reply:
        unit.verbose = verbose
        return DONE

    return handler


def _limits_enabled(unit: UnitController, _time_s: float) -> Reply:
    unit.limits = "E"
    return DONE


def _limits_disabled(unit: UnitController, _time_s: float) -> Reply:
    unit.limits = "D"
    return DONE


def _limits_user(unit: UnitController, _time_s: float) -> Reply:
    unit.limits = "U"
    return DONE


def _immediate(unit: UnitController, time_s: float) -> Reply:
    unit.is_slaved = False
    unit.start_pending(time_s)
    return DONE


def _slaved(unit: UnitController, _time_s: float) -> Reply:
    unit.is_slaved = True
    return DONE


def _await(unit: UnitController, time_s: float) -> Reply:
    unit.start_pending(time_s)
    return Reply(done_s=unit.rests_at_s())


def _halt(letters: tuple[Letter, ...]) -> UnitHandler:
    def handler(unit: UnitController, time_s: float) -> Reply:
        for letter in letters:
            unit.halt(unit.axes[letter], time_s)
        return DONE

    return handler


def _set_velocity(on: bool) -> UnitHandler:
    def handler(unit: UnitController, time_s: float) -> Reply:
        if unit.in_velocity_mode != on:
            for state in unit.axes.values():
                unit.halt(state, time_s)
        unit.in_velocity_mode = on
        return DONE

    return handler


def _reset(letters: tuple[Letter, ...]) -> UnitHandler:
    def handler(unit: UnitController, time_s: float) -> Reply:
        return Reply(done_s=run_homing(unit, time_s, letters))

    return handler


def run_homing(unit: UnitController, time_s: float, letters: tuple[Letter, ...]) -> float:
    """Home axes one after the other and return when the last one is done."""
    for letter in letters:
        time_s = unit.home(unit.axes[letter], time_s)
    return time_s


def _power_up_reset(on: bool) -> UnitHandler:
    def handler(unit: UnitController, _time_s: float) -> Reply:
        unit.resets_at_power_up = on
        return DONE

    return handler


def _save(_unit: UnitController, _time_s: float) -> Reply:
    return DONE


def _restore(unit: UnitController, time_s: float) -> Reply:
    settings = unit.settings
    unit.in_velocity_mode = unit.is_slaved = False
    unit.limits, unit.echo, unit.verbose = "E", settings.echo, settings.verbose
    for state in unit.axes.values():
        state.speed = round(settings.speed_steps_s * state.ratio)
        state.base = round(settings.base_speed_steps_s * state.ratio)
        state.acceleration = round(settings.acceleration_steps_s2 * state.ratio)
        state.upper = round(settings.upper_speed_steps_s * state.ratio)
        state.lower = round(settings.lower_speed_steps_s * state.ratio)
        unit.apply_law(state, time_s)
    return DONE


def _monitor_off(_unit: UnitController, _time_s: float) -> Reply:
    return DONE


_COMMANDS: dict[str, UnitHandler] = {
    "E": answers.echo, "EE": _set_echo(True), "ED": _set_echo(False),
    "F": answers.feedback, "FV": _set_feedback(True), "FT": _set_feedback(False),
    "L": answers.limits, "LE": _limits_enabled, "LD": _limits_disabled, "LU": _limits_user,
    "I": _immediate, "S": _slaved, "IQ": answers.execution, "A": _await,
    "H": _halt(LETTERS), "HP": _halt(("P",)), "HT": _halt(("T",)),
    "C": answers.mode, "CI": _set_velocity(False), "CV": _set_velocity(True),
    "B": answers.motion, "BT": answers.motion_with_counter,
    "CNT": answers.counter, "CNF": answers.counter_hz,
    "R": _reset(("T", "P")), "RP": _reset(("P",)), "RT": _reset(("T",)),
    "RE": _power_up_reset(True), "RD": _power_up_reset(False), "RQ": answers.power_up_query,
    "DS": _save, "DR": _restore, "DF": _restore,
    "V": answers.version, "VV": answers.short_version, "VM": answers.model, "VS": answers.serial,
    "O": answers.power, "?": answers.menu, "MD": _monitor_off,
}  # fmt: skip
_E_SERIES = frozenset({"B", "BT", "CNT", "CNF", "IQ", "VV", "VM", "VS"})

Parsed = Callable[[UnitController, float, "re.Match[str]"], Reply]


def _set_motion(unit: UnitController, time_s: float, match: "re.Match[str]") -> Reply:
    pan, tilt, pan_speed, tilt_speed = (int(text) for text in match.groups())
    requests = ((unit.axes["P"], pan, pan_speed), (unit.axes["T"], tilt, tilt_speed))
    for state, steps, speed in requests:
        refusal = check_position(unit, state, steps) or check_speed(state, speed)
        if refusal is not None:
            return refusal
    for state, steps, speed in requests:
        state.speed = speed
        unit.request_position(state, time_s, steps)
    return DONE


def _step_mode(unit: UnitController, time_s: float, match: "re.Match[str]") -> Reply:
    state: AxisState = unit.axes["P" if match[1] == "P" else "T"]
    names: dict[str, str] = {
        "F": "FULL", "H": "HALF", "Q": "QUARTER", "E": "EIGHTH", "A": "AUTO",
    }  # fmt: skip
    if not match[2]:
        return fixed_reply(f"{state.name} step mode is {names[state.step_mode]}")
    modes: dict[str, StepMode] = {"F": "F", "H": "H", "Q": "Q", "E": "E", "A": "A"}
    # The axis recalibrates: it homes in the old steps, and counts in the new ones afterwards.
    done_s = unit.home(state, time_s)
    unit.change_step_mode(state, modes[match[2]])
    return Reply(done_s=done_s)


def _reset_at_speed(unit: UnitController, time_s: float, match: "re.Match[str]") -> Reply:
    state = unit.axes["P" if match[1] == "P" else "T"]
    speed = int(match[2])
    if speed < 1:
        return error_reply("Motor speed cannot be less than 1 pos/sec")
    return Reply(done_s=unit.home(state, time_s, speed / state.ratio))


def _baud(unit: UnitController, _time_s: float, match: "re.Match[str]") -> Reply:
    baud = int(match[1])
    if baud not in BAUDS or unit.unit_id > 0:
        return error_reply("Value is out of range")
    unit.new_baud = baud
    return DONE


def _unit_id(unit: UnitController, _time_s: float, match: "re.Match[str]") -> Reply:
    if not match[1]:
        return value_reply("Unit ID is {}", unit.unit_id)
    number = int(match[1])
    if number > 127:
        return error_reply("Value is out of range")
    unit.unit_id, unit.selected = number, number == 0 or unit.selected
    return DONE


_PATTERNS: tuple[tuple["re.Pattern[str]", Parsed], ...] = (
    (re.compile(r"B([+-]?\d{1,9}),([+-]?\d{1,9}),(\d{1,9}),(\d{1,9})"), _set_motion),
    (re.compile(r"W([PT])([FHQEA]?)"), _step_mode),
    (re.compile(r"R([PT])S(\d{1,9})"), _reset_at_speed),
    (re.compile(r"@\((\d{1,6}),\d{1,4},[TF]\)"), _baud),
    (re.compile(r"U(\d{1,3})?"), _unit_id),
)
