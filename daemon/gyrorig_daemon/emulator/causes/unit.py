"""Causes in the pan-tilt unit: its controller, its gears, what carries it.

Sizes: pan-tilt survey, section 7; rig discovery survey, section 2.
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    UNIT_AXES,
    Cause,
    Draw,
    Hidden,
    Quantity,
    axes_of,
)
from gyrorig_daemon.emulator.physics.effects.angles import Harmonic, Offset
from gyrorig_daemon.emulator.physics.effects.compliance import Compliance
from gyrorig_daemon.emulator.physics.effects.hooks import AxisHooks, RigHooks
from gyrorig_daemon.emulator.physics.effects.ringing import Ringing
from gyrorig_daemon.emulator.physics.effects.slip import Slip

WORM_TURNS = 17.5  # motor turns in a turn of the axis: pan-tilt survey, section 4
_QUARTER_TURN = 0.5 * np.pi


def _axes(hidden: Hidden, hooks: RigHooks) -> list[AxisHooks]:
    return [hooks.axis(name) for name in axes_of(hidden)]


def _gap(draw: Draw) -> dict[str, Quantity]:
    return {"gap": Quantity(draw.size, "rad")}


def _hang_gap(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    for axis in _axes(hidden, hooks):
        axis.gap_rad += hidden.number("gap")


def _lost(draw: Draw) -> dict[str, Quantity]:
    return {"steps": Quantity(draw.size, "steps"), "after": Quantity(draw.event_s(), "s")}


def _hang_lost(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    for axis in _axes(hidden, hooks):
        axis.slip = Slip(hidden.number("steps"), hidden.number("after"))


def _eccentricity(draw: Draw) -> dict[str, Quantity]:
    """An eccentric gear, and one that is somewhat oval too."""
    second = draw.size * float(draw.rng.uniform(0.0, 0.5))
    return {
        "first": Quantity(draw.size, "rad"),
        "first_phase": Quantity(draw.phase_rad(), "rad"),
        "second": Quantity(second, "rad"),
        "second_phase": Quantity(draw.phase_rad(), "rad"),
    }


def _hang_eccentricity(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    for axis in _axes(hidden, hooks):
        for order, name in ((1.0, "first"), (2.0, "second")):
            harmonic = Harmonic(hidden.number(name), order, hidden.number(f"{name}_phase"))
            axis.angles.append(harmonic)


def _periodic(draw: Draw) -> dict[str, Quantity]:
    return {"amplitude": Quantity(draw.size, "rad"), "phase": Quantity(draw.phase_rad(), "rad")}


def _hang_worm(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    harmonic = Harmonic(hidden.number("amplitude"), WORM_TURNS, hidden.number("phase"))
    for axis in _axes(hidden, hooks):
        axis.angles.append(harmonic)


def _sag(draw: Draw) -> dict[str, Quantity]:
    # The payload's centre of mass lies above the tilt axis, up to 45 deg fore or aft.
    phase = float(draw.rng.uniform(-0.5, 0.5)) * _QUARTER_TURN
    return {"amplitude": Quantity(draw.size, "rad"), "phase": Quantity(phase, "rad")}


def _hang_sag(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    harmonic = Harmonic(hidden.number("amplitude"), 1.0, hidden.number("phase"))
    hooks.tilt.angles.append(harmonic)


def _angle(draw: Draw) -> dict[str, Quantity]:
    return {"angle": Quantity(draw.size, "rad")}


def _hang_nonorthogonality(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    hooks.tilt_axis_error_rad += hidden.number("angle")


def _hang_zero(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    hooks.tilt.angles.append(Offset(hidden.number("angle")))


def _ratio(draw: Draw) -> dict[str, Quantity]:
    return {"relative_error": Quantity(draw.size, "1")}


def _hang_resolution(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    for axis in _axes(hidden, hooks):
        axis.scale_error += hidden.number("relative_error")


def _hang_acceleration(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    for axis in _axes(hidden, hooks):
        axis.acceleration_error += hidden.number("relative_error")


def _window(draw: Draw) -> dict[str, Quantity]:
    return {"window": Quantity(draw.size, "s")}


def _hang_s_curve(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    for axis in _axes(hidden, hooks):
        axis.s_curve_s += hidden.number("window")


def _base_speed(draw: Draw) -> dict[str, Quantity]:
    return {"added": Quantity(draw.size, "rad/s")}


def _hang_base_speed(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    for axis in _axes(hidden, hooks):
        axis.base_speed_added_rad_s += hidden.number("added")


def _ringing(draw: Draw) -> dict[str, Quantity]:
    return {
        "share": Quantity(draw.size, "1"),
        "frequency": Quantity(float(draw.rng.uniform(5.0, 15.0)), "Hz"),
        "damping": Quantity(float(draw.rng.uniform(0.025, 0.1)), "1"),
    }


def _hang_ringing(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    for axis in _axes(hidden, hooks):
        told = (hidden.number(name) for name in ("share", "frequency", "damping"))
        axis.angles.append(Ringing(*told))


def _compliance(draw: Draw) -> dict[str, Quantity]:
    return {"compliance": Quantity(draw.size, "s^2")}


def _hang_compliance(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    for axis in _axes(hidden, hooks):
        axis.angles.append(Compliance(hidden.number("compliance")))


CAUSES = (
    Cause(
        "backlash", "gap between motor and gear",
        "ptu", "rad", 9e-4, 2e-4, 2.5e-3, 0.05, _gap, _hang_gap,
        places=UNIT_AXES, signed=False,
    ),
    Cause(
        "lost_steps", "steps lost in one move, of the mode at power-up",
        "ptu", "steps", 8.0, 1.0, 16.0, 1000.0, _lost, _hang_lost,
        places=UNIT_AXES, sizes=(1.0, 2.0, 4.0, 8.0, 16.0), whole=True,
    ),
    Cause(
        "eccentricity", "amplitude once a turn, with up to half of it twice a turn",
        "ptu", "rad", 9e-4, 3.5e-4, 1.7e-3, 0.05,
        _eccentricity, _hang_eccentricity, places=UNIT_AXES, signed=False,
    ),
    Cause(
        "worm_error", "amplitude once a turn of the worm, 17.5 in a turn",
        "ptu", "rad", 2e-4, 9e-5, 5e-4, 0.02, _periodic, _hang_worm,
        places=UNIT_AXES, signed=False,
    ),
    Cause(
        "axis_nonorthogonality", "by how much the axes are not square to each other",
        "ptu", "rad", 3.5e-3, 1.7e-3, 9e-3, 0.1,
        _angle, _hang_nonorthogonality, places=("tilt",),
    ),
    Cause(
        "tilt_zero", "by how much the zero of tilt is wrong",
        "ptu", "rad", 3e-3, 9e-4, 1e-2, 0.2, _angle, _hang_zero, places=("tilt",),
    ),
    Cause(
        "step_resolution", "relative error of the angle of a step",
        "ptu", "1", 2e-3, 1e-4, 1e-2, 0.5, _ratio, _hang_resolution,
        places=UNIT_AXES,
    ),
    Cause(
        "acceleration_error", "relative error of the acceleration",
        "ptu", "1", 5e-3, 5e-4, 2e-2, 0.5, _ratio, _hang_acceleration,
        places=UNIT_AXES, together=True,
    ),
    Cause(
        "s_curve", "time over which the planned motion is averaged",
        "ptu", "s", 0.03, 0.01, 0.1, 1.0, _window, _hang_s_curve,
        places=UNIT_AXES, together=True, signed=False,
    ),
    Cause(
        "base_speed_jump", "by how much the axes start and stop faster than told",
        "ptu", "rad/s", 0.05, 0.01, 0.15, 1.0, _base_speed, _hang_base_speed,
        places=UNIT_AXES, together=True, signed=False,
    ),
    Cause(
        "ringing", "share of the load that swings",
        "ptu", "1", 0.05, 0.02, 0.12, 0.5, _ringing, _hang_ringing,
        places=UNIT_AXES, signed=False,
    ),
    Cause(
        "tilt_sag", "amplitude of the payload's sag with the sine of tilt",
        "ptu", "rad", 2e-3, 9e-4, 5e-3, 0.1, _sag, _hang_sag, places=("tilt",),
    ),
    Cause(
        "base_compliance", "twist of the base per acceleration",
        "ptu", "s^2", 5e-5, 1.5e-5, 1.5e-4, 1e-2, _compliance, _hang_compliance,
        places=("pan",), signed=False,
    ),
)  # fmt: skip
