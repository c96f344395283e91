"""Commands of the unit as a whole: modes, resets, queries of both axes, identity.

`run_command` is the entrance: it finds the command in the tables here or among those of
an axis, and answers what the firmware answers to an unknown one.
"""

import math
import re
from collections.abc import Callable

from gyrorig_daemon.emulator.ptu.language import (
    DONE,
    ILLEGAL,
    Answer,
    always,
    check_position,
    check_speed,
    refuse,
    run_axis_command,
    value,
)
from gyrorig_daemon.emulator.ptu.unit import LETTERS, AxisState, Letter, PtuUnit
from gyrorig_daemon.emulator.settings import StepMode

UnitHandler = Callable[[PtuUnit, float], Answer]

VERSIONS = {
    "d46": "Pan-Tilt Controller v2.14.0r1(D46-C14/E), (C)1991-2006 Directed Perception, Inc., "
    "All Rights Reserved",
    "e46": "Pan-Tilt Controller v3.4.2r0(E46-C16/E), (C)1991-2014 FLIR Commercial Systems, Inc., "
    "All Rights Reserved",
}
SHORT_VERSION = "v3.4.2r0"
MODEL = "PTU-E46-17.5"
BAUDS = (600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
_MOTOR_WARM_UP_S = 600.0


def run_command(unit: PtuUnit, text: str, time_s: float) -> Answer:
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


def _echo(unit: PtuUnit, _time_s: float) -> Answer:
    return always("Echoing ON" if unit.echo else "Echoing OFF")


def _set_echo(on: bool) -> UnitHandler:
    def handler(unit: PtuUnit, _time_s: float) -> Answer:
        unit.echo = on
        return DONE

    return handler


def _feedback(unit: PtuUnit, _time_s: float) -> Answer:
    return always(f"ASCII {'verbose' if unit.verbose else 'terse'} mode")


def _set_feedback(verbose: bool) -> UnitHandler:
    def handler(unit: PtuUnit, _time_s: float) -> Answer:
        unit.verbose = verbose
        return DONE

    return handler


def _limits(unit: PtuUnit, _time_s: float) -> Answer:
    texts = {
        "E": "Limit bounds are ENABLED (soft limits enabled)",
        "D": "Limit bounds are DISABLED",
        "U": "Limit bounds are user defined bounds",
    }
    return always(texts[unit.limits])


def _limits_enabled(unit: PtuUnit, _time_s: float) -> Answer:
    unit.limits = "E"
    return DONE


def _limits_disabled(unit: PtuUnit, _time_s: float) -> Answer:
    unit.limits = "D"
    return DONE


def _limits_user(unit: PtuUnit, _time_s: float) -> Answer:
    unit.limits = "U"
    return DONE


def _immediate(unit: PtuUnit, time_s: float) -> Answer:
    unit.slaved = False
    unit.release(time_s)
    return DONE


def _slaved(unit: PtuUnit, _time_s: float) -> Answer:
    unit.slaved = True
    return DONE


def _execution(unit: PtuUnit, _time_s: float) -> Answer:
    return always("SLAVED execution mode" if unit.slaved else "IMMEDIATE execution mode")


def _await(unit: PtuUnit, time_s: float) -> Answer:
    unit.release(time_s)
    return Answer(done_s=unit.rests_at_s())


def _halt(letters: tuple[Letter, ...]) -> UnitHandler:
    def handler(unit: PtuUnit, time_s: float) -> Answer:
        for letter in letters:
            unit.halt(unit.axes[letter], time_s)
        return DONE

    return handler


def _mode(unit: PtuUnit, _time_s: float) -> Answer:
    name = "Velocity" if unit.velocity else "Independent"
    if unit.settings.dialect == "e46":
        return always(f"PTU is in {name} Mode")
    long_name = "pure velocity" if unit.velocity else "independent (default)"
    return always(f"PTU is in {long_name} speed control mode")


def _set_velocity(on: bool) -> UnitHandler:
    def handler(unit: PtuUnit, time_s: float) -> Answer:
        if unit.velocity != on:
            for state in unit.axes.values():
                unit.halt(state, time_s)
        unit.velocity = on
        return DONE

    return handler


def _motion_text(unit: PtuUnit, time_s: float) -> str:
    pan, tilt = unit.pan_tilt()
    return (
        f"P({pan.count(time_s)},{tilt.count(time_s)}) "
        f"S({pan.speed_now(time_s)},{tilt.speed_now(time_s)})"
    )


def _motion(unit: PtuUnit, time_s: float) -> Answer:
    return always(_motion_text(unit, time_s))


def _counter_value(unit: PtuUnit, time_s: float) -> int:
    return int(unit.clock.ticks(unit.to_ns(time_s)) % 2**unit.settings.counter_bits)


def _motion_with_counter(unit: PtuUnit, time_s: float) -> Answer:
    return always(f"{_motion_text(unit, time_s)} {_counter_value(unit, time_s)}")


def _counter(unit: PtuUnit, time_s: float) -> Answer:
    return always(str(_counter_value(unit, time_s)))


def _counter_hz(unit: PtuUnit, _time_s: float) -> Answer:
    return always(str(round(unit.settings.counter_hz)))


def _reset(letters: tuple[Letter, ...]) -> UnitHandler:
    def handler(unit: PtuUnit, time_s: float) -> Answer:
        return Answer(done_s=run_homing(unit, time_s, letters))

    return handler


def run_homing(unit: PtuUnit, time_s: float, letters: tuple[Letter, ...]) -> float:
    """Home axes one after the other and return when the last one is done."""
    for letter in letters:
        time_s = unit.home(unit.axes[letter], time_s)
    return time_s


def _power_up_reset(on: bool) -> UnitHandler:
    def handler(unit: PtuUnit, _time_s: float) -> Answer:
        unit.resets_at_power_up = on
        return DONE

    return handler


def _power_up_query(unit: PtuUnit, _time_s: float) -> Answer:
    return always("Reset at power up is " + ("ON" if unit.resets_at_power_up else "OFF"))


def _save(unit: PtuUnit, _time_s: float) -> Answer:
    unit.eeprom_writes += 1
    return DONE


def _restore(unit: PtuUnit, time_s: float) -> Answer:
    settings = unit.settings
    unit.velocity = unit.slaved = False
    unit.limits, unit.echo, unit.verbose = "E", settings.echo, settings.verbose
    for state in unit.axes.values():
        state.speed = round(settings.speed_steps_s * state.ratio)
        state.base = round(settings.base_speed_steps_s * state.ratio)
        state.acceleration = round(settings.acceleration_steps_s2 * state.ratio)
        state.upper = round(settings.upper_speed_steps_s * state.ratio)
        state.lower = round(settings.lower_speed_steps_s * state.ratio)
        unit.apply_law(state, time_s)
    return DONE


def _version(unit: PtuUnit, _time_s: float) -> Answer:
    return always(VERSIONS[unit.settings.dialect])


def _short_version(_unit: PtuUnit, _time_s: float) -> Answer:
    return always(SHORT_VERSION)


def _model(_unit: PtuUnit, _time_s: float) -> Answer:
    return always(MODEL)


def _serial(unit: PtuUnit, _time_s: float) -> Answer:
    return always(unit.settings.serial)


def _power(unit: PtuUnit, time_s: float) -> Answer:
    """Supply and temperatures in deg F; the motors warm the head over ten minutes."""
    warm = -math.expm1(-time_s / _MOTOR_WARM_UP_S)
    head, pan, tilt = (round(start + gain * warm) for start, gain in ((77, 9), (79, 18), (78, 16)))
    if unit.settings.dialect == "d46":
        return always(f"Input 30 VDC @ {head} degF")
    return always(f"30.0,{head},{pan},{tilt}")


def _menu(_unit: PtuUnit, _time_s: float) -> Answer:
    return always("Commands: PP TP PO TO PS TS PD TD PA TA PB TB PU TU PL TL PR TR PN TN PX TX")


def _monitor_off(_unit: PtuUnit, _time_s: float) -> Answer:
    return DONE


_COMMANDS: dict[str, UnitHandler] = {
    "E": _echo, "EE": _set_echo(True), "ED": _set_echo(False),
    "F": _feedback, "FV": _set_feedback(True), "FT": _set_feedback(False),
    "L": _limits, "LE": _limits_enabled, "LD": _limits_disabled, "LU": _limits_user,
    "I": _immediate, "S": _slaved, "IQ": _execution, "A": _await,
    "H": _halt(LETTERS), "HP": _halt(("P",)), "HT": _halt(("T",)),
    "C": _mode, "CI": _set_velocity(False), "CV": _set_velocity(True),
    "B": _motion, "BT": _motion_with_counter, "CNT": _counter, "CNF": _counter_hz,
    "R": _reset(("T", "P")), "RP": _reset(("P",)), "RT": _reset(("T",)),
    "RE": _power_up_reset(True), "RD": _power_up_reset(False), "RQ": _power_up_query,
    "DS": _save, "DR": _restore, "DF": _restore,
    "V": _version, "VV": _short_version, "VM": _model, "VS": _serial,
    "O": _power, "?": _menu, "MD": _monitor_off,
}  # fmt: skip
_E_SERIES = frozenset({"B", "BT", "CNT", "CNF", "IQ", "VV", "VM", "VS"})

Parsed = Callable[[PtuUnit, float, "re.Match[str]"], Answer]


def _set_motion(unit: PtuUnit, time_s: float, match: "re.Match[str]") -> Answer:
    pan, tilt, pan_speed, tilt_speed = (int(text) for text in match.groups())
    wanted = ((unit.axes["P"], pan, pan_speed), (unit.axes["T"], tilt, tilt_speed))
    for state, steps, speed in wanted:
        fault = check_position(unit, state, steps) or check_speed(state, speed)
        if fault is not None:
            return fault
    for state, steps, speed in wanted:
        state.speed = speed
        unit.begin(state, time_s, steps)
    return DONE


def _step_mode(unit: PtuUnit, time_s: float, match: "re.Match[str]") -> Answer:
    state: AxisState = unit.axes["P" if match[1] == "P" else "T"]
    names: dict[str, str] = {
        "F": "FULL", "H": "HALF", "Q": "QUARTER", "E": "EIGHTH", "A": "AUTO",
    }  # fmt: skip
    if not match[2]:
        return always(f"{state.name} step mode is {names[state.step_mode]}")
    modes: dict[str, StepMode] = {"F": "F", "H": "H", "Q": "Q", "E": "E", "A": "A"}
    # The axis recalibrates: it homes, in the old steps, and counts in the new ones after.
    done_s = unit.home(state, time_s)
    unit.change_step_mode(state, modes[match[2]])
    return Answer(done_s=done_s)


def _reset_at_speed(unit: PtuUnit, time_s: float, match: "re.Match[str]") -> Answer:
    state = unit.axes["P" if match[1] == "P" else "T"]
    speed = int(match[2])
    if speed < 1:
        return refuse("Motor speed cannot be less than 1 pos/sec")
    return Answer(done_s=unit.home(state, time_s, speed / state.ratio))


def _baud(unit: PtuUnit, _time_s: float, match: "re.Match[str]") -> Answer:
    baud = int(match[1])
    if baud not in BAUDS or unit.unit_id > 0:
        return refuse("Value is out of range")
    unit.new_baud = baud
    return DONE


def _unit_id(unit: PtuUnit, _time_s: float, match: "re.Match[str]") -> Answer:
    if not match[1]:
        return value("Unit ID is {}", unit.unit_id)
    number = int(match[1])
    if number > 127:
        return refuse("Value is out of range")
    unit.unit_id, unit.selected = number, number == 0 or unit.selected
    return DONE


_PATTERNS: tuple[tuple["re.Pattern[str]", Parsed], ...] = (
    (re.compile(r"B([+-]?\d{1,9}),([+-]?\d{1,9}),(\d{1,9}),(\d{1,9})"), _set_motion),
    (re.compile(r"W([PT])([FHQEA]?)"), _step_mode),
    (re.compile(r"R([PT])S(\d{1,9})"), _reset_at_speed),
    (re.compile(r"@\((\d{1,6}),\d{1,4},[TF]\)"), _baud),
    (re.compile(r"U(\d{1,3})?"), _unit_id),
)
