"""Queries of the emulated unit: modes, positions, counter, identity, supply.

Nothing here changes the unit; `unit_commands` maps the commands to these replies.
"""

import math

from gyrorig_daemon.emulator.ptu.axis_commands import Reply, fixed_reply
from gyrorig_daemon.emulator.ptu.unit_controller import UnitController

VERSIONS = {
    "d46": "Pan-Tilt Controller v2.14.0r1(D46-C14/E), (C)1991-2006 Directed Perception, Inc., "
    "All Rights Reserved",
    "e46": "Pan-Tilt Controller v3.4.2r0(E46-C16/E), (C)1991-2014 FLIR Commercial Systems, Inc., "
    "All Rights Reserved",
}
SHORT_VERSION = "v3.4.2r0"
_MOTOR_WARM_UP_S = 600.0


def echo(unit: UnitController, _time_s: float) -> Reply:
    """E: echo mode."""
    return fixed_reply("Echoing ON" if unit.echo else "Echoing OFF")


def feedback(unit: UnitController, _time_s: float) -> Reply:
    """F: verbose or terse replies."""
    return fixed_reply(f"ASCII {'verbose' if unit.verbose else 'terse'} mode")


def limits(unit: UnitController, _time_s: float) -> Reply:
    """L: limits in force."""
    texts = {
        "E": "Limit bounds are ENABLED (soft limits enabled)",
        "D": "Limit bounds are DISABLED",
        "U": "Limit bounds are user defined bounds",
    }
    return fixed_reply(texts[unit.limits])


def execution(unit: UnitController, _time_s: float) -> Reply:
    """IQ: immediate or slaved execution."""
    return fixed_reply("SLAVED execution mode" if unit.is_slaved else "IMMEDIATE execution mode")


def mode(unit: UnitController, _time_s: float) -> Reply:
    """C: position or velocity mode."""
    name = "Velocity" if unit.in_velocity_mode else "Independent"
    if unit.settings.dialect == "e46":
        return fixed_reply(f"PTU is in {name} Mode")
    long_name = "pure velocity" if unit.in_velocity_mode else "independent (default)"
    return fixed_reply(f"PTU is in {long_name} speed control mode")


def _motion_text(unit: UnitController, time_s: float) -> str:
    pan, tilt = unit.pan_tilt()
    return (
        f"P({pan.count(time_s)},{tilt.count(time_s)}) "
        f"S({pan.speed_now(time_s)},{tilt.speed_now(time_s)})"
    )


def motion(unit: UnitController, time_s: float) -> Reply:
    """B: positions and speeds."""
    return fixed_reply(_motion_text(unit, time_s))


def _counter_value(unit: UnitController, time_s: float) -> int:
    return int(unit.clock.ticks(unit.to_ns(time_s)) % 2**unit.settings.counter_bits)


def motion_with_counter(unit: UnitController, time_s: float) -> Reply:
    """BT: positions, speeds and the counter."""
    return fixed_reply(f"{_motion_text(unit, time_s)} {_counter_value(unit, time_s)}")


def counter(unit: UnitController, time_s: float) -> Reply:
    """CNT: the counter."""
    return fixed_reply(str(_counter_value(unit, time_s)))


def counter_hz(unit: UnitController, _time_s: float) -> Reply:
    """CNF: frequency of the counter."""
    return fixed_reply(str(round(unit.settings.counter_hz)))


def power_up_query(unit: UnitController, _time_s: float) -> Reply:
    """RQ: homing at power-up."""
    return fixed_reply("Reset at power up is " + ("ON" if unit.resets_at_power_up else "OFF"))


def version(unit: UnitController, _time_s: float) -> Reply:
    """V: the full version text."""
    return fixed_reply(unit.settings.version or VERSIONS[unit.settings.dialect])


def short_version(_unit: UnitController, _time_s: float) -> Reply:
    """VV: the version number."""
    return fixed_reply(SHORT_VERSION)


def model(unit: UnitController, _time_s: float) -> Reply:
    """VM: the model."""
    return fixed_reply(unit.settings.model)


def serial(unit: UnitController, _time_s: float) -> Reply:
    """VS: the serial number."""
    return fixed_reply(unit.settings.serial)


def power(unit: UnitController, time_s: float) -> Reply:
    """O: supply, and temperatures in deg F; the motors heat the head over ten minutes."""
    warmed_share = -math.expm1(-time_s / _MOTOR_WARM_UP_S)
    head, pan, tilt = (
        round(start + gain * warmed_share) for start, gain in ((77, 9), (79, 18), (78, 16))
    )
    if unit.settings.dialect == "d46":
        return fixed_reply(f"Input 30 VDC @ {head} degF")
    return fixed_reply(f"30.0,{head},{pan},{tilt}")


def menu(_unit: UnitController, _time_s: float) -> Reply:
    """?: list of commands."""
    return fixed_reply(
        "Commands: PP TP PO TO PS TS PD TD PA TA PB TB PU TU PL TL PR TR PN TN PX TX"
    )
