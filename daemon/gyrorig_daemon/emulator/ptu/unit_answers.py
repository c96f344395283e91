"""What the unit answers about itself: modes, positions, counter, identity, supply.

Nothing here changes the unit; `unit_commands` puts these answers behind their commands.
"""

import math

from gyrorig_daemon.emulator.ptu.language import Answer, always
from gyrorig_daemon.emulator.ptu.unit import PtuUnit

VERSIONS = {
    "d46": "Pan-Tilt Controller v2.14.0r1(D46-C14/E), (C)1991-2006 Directed Perception, Inc., "
    "All Rights Reserved",
    "e46": "Pan-Tilt Controller v3.4.2r0(E46-C16/E), (C)1991-2014 FLIR Commercial Systems, Inc., "
    "All Rights Reserved",
}
SHORT_VERSION = "v3.4.2r0"
MODEL = "PTU-E46-17.5"
_MOTOR_WARM_UP_S = 600.0


def echo(unit: PtuUnit, _time_s: float) -> Answer:
    """E: is what comes sent back?"""
    return always("Echoing ON" if unit.echo else "Echoing OFF")


def feedback(unit: PtuUnit, _time_s: float) -> Answer:
    """F: full answers or short ones?"""
    return always(f"ASCII {'verbose' if unit.verbose else 'terse'} mode")


def limits(unit: PtuUnit, _time_s: float) -> Answer:
    """L: which bounds hold?"""
    texts = {
        "E": "Limit bounds are ENABLED (soft limits enabled)",
        "D": "Limit bounds are DISABLED",
        "U": "Limit bounds are user defined bounds",
    }
    return always(texts[unit.limits])


def execution(unit: PtuUnit, _time_s: float) -> Answer:
    """IQ: do orders wait?"""
    return always("SLAVED execution mode" if unit.slaved else "IMMEDIATE execution mode")


def mode(unit: PtuUnit, _time_s: float) -> Answer:
    """C: speed by position, or by velocity?"""
    name = "Velocity" if unit.velocity else "Independent"
    if unit.settings.dialect == "e46":
        return always(f"PTU is in {name} Mode")
    long_name = "pure velocity" if unit.velocity else "independent (default)"
    return always(f"PTU is in {long_name} speed control mode")


def _motion_text(unit: PtuUnit, time_s: float) -> str:
    pan, tilt = unit.pan_tilt()
    return (
        f"P({pan.count(time_s)},{tilt.count(time_s)}) "
        f"S({pan.speed_now(time_s)},{tilt.speed_now(time_s)})"
    )


def motion(unit: PtuUnit, time_s: float) -> Answer:
    """B: positions and speeds."""
    return always(_motion_text(unit, time_s))


def _counter_value(unit: PtuUnit, time_s: float) -> int:
    return int(unit.clock.ticks(unit.to_ns(time_s)) % 2**unit.settings.counter_bits)


def motion_with_counter(unit: PtuUnit, time_s: float) -> Answer:
    """BT: positions, speeds and the counter."""
    return always(f"{_motion_text(unit, time_s)} {_counter_value(unit, time_s)}")


def counter(unit: PtuUnit, time_s: float) -> Answer:
    """CNT: the counter."""
    return always(str(_counter_value(unit, time_s)))


def counter_hz(unit: PtuUnit, _time_s: float) -> Answer:
    """CNF: its rate."""
    return always(str(round(unit.settings.counter_hz)))


def power_up_query(unit: PtuUnit, _time_s: float) -> Answer:
    """RQ: does it home by itself?"""
    return always("Reset at power up is " + ("ON" if unit.resets_at_power_up else "OFF"))


def version(unit: PtuUnit, _time_s: float) -> Answer:
    """V: the whole version."""
    return always(VERSIONS[unit.settings.dialect])


def short_version(_unit: PtuUnit, _time_s: float) -> Answer:
    """VV: its number."""
    return always(SHORT_VERSION)


def model(_unit: PtuUnit, _time_s: float) -> Answer:
    """VM: the model."""
    return always(MODEL)


def serial(unit: PtuUnit, _time_s: float) -> Answer:
    """VS: the serial number."""
    return always(unit.settings.serial)


def power(unit: PtuUnit, time_s: float) -> Answer:
    """Supply and temperatures in deg F; the motors warm the head over ten minutes."""
    warm = -math.expm1(-time_s / _MOTOR_WARM_UP_S)
    head, pan, tilt = (round(start + gain * warm) for start, gain in ((77, 9), (79, 18), (78, 16)))
    if unit.settings.dialect == "d46":
        return always(f"Input 30 VDC @ {head} degF")
    return always(f"30.0,{head},{pan},{tilt}")


def menu(_unit: PtuUnit, _time_s: float) -> Answer:
    """?: the commands."""
    return always("Commands: PP TP PO TO PS TS PD TD PA TA PB TB PU TU PL TL PR TR PN TN PX TX")
