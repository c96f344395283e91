"""Causes in the sensor: its curve, what else it feels, its filter.

Sizes: rig discovery survey, section 2; boards survey, section 1.1 (L3G4200D, I3G4250D).
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    SENSOR_AXES,
    Cause,
    Draw,
    Hidden,
    Quantity,
    axes_of,
    board_of,
)
from gyrorig_daemon.emulator.physics.effects.crosstalk import (
    GSensitivity,
    MotorCoupling,
    Rectification,
    ThermalScale,
)
from gyrorig_daemon.emulator.physics.effects.hooks import RigHooks
from gyrorig_daemon.emulator.physics.effects.nonlinear import Asymmetry, DeadZone, Power


def _low_pass(draw: Draw) -> dict[str, Quantity]:
    return {"cutoff_change": Quantity(draw.size, "1")}


def _hang_low_pass(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).bandwidth_factor *= 1.0 + hidden.number("cutoff_change")


def _quadratic(draw: Draw) -> dict[str, Quantity]:
    return {"coefficient": draw.by_axis("s/rad")}


def _hang_quadratic(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).rates.append(Power(hidden.array("coefficient"), 2))


def _cubic(draw: Draw) -> dict[str, Quantity]:
    return {"coefficient": draw.by_axis("s^2/rad^2")}


def _hang_cubic(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).rates.append(Power(hidden.array("coefficient"), 3))


def _asymmetry(draw: Draw) -> dict[str, Quantity]:
    return {"share": draw.by_axis("1")}


def _hang_asymmetry(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).rates.append(Asymmetry(hidden.array("share")))


def _limit(draw: Draw) -> dict[str, Quantity]:
    return {"limit": Quantity(draw.size, "rad/s")}


def _hang_limit(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board = board_of(hidden, hooks)
    inside = np.full(3, np.inf) if board.limit_rad_s is None else board.limit_rad_s
    here = [axis in axes_of(hidden) for axis in SENSOR_AXES]
    board.limit_rad_s = np.where(here, np.minimum(inside, hidden.number("limit")), inside)


def _dead_zone(draw: Draw) -> dict[str, Quantity]:
    return {"width": Quantity(draw.size, "rad/s")}


def _hang_dead_zone(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    here = np.array([float(axis in axes_of(hidden)) for axis in SENSOR_AXES])
    board_of(hidden, hooks).rates.append(DeadZone(here * hidden.number("width")))


def _gravity(draw: Draw) -> dict[str, Quantity]:
    """Each output axis feels gravity along a direction of its own."""
    rows = draw.rng.standard_normal((3, 3))
    rows = draw.size * rows / np.linalg.norm(rows, axis=1, keepdims=True)
    if draw.place:
        rows *= (np.array(SENSOR_AXES) == draw.place)[:, None]
    names = [f"{out}{along}" for out in SENSOR_AXES for along in SENSOR_AXES]
    unit = "(rad/s)/(m/s^2)"
    return {n: Quantity(v, unit) for n, v in zip(names, rows.ravel().tolist(), strict=True)}


def _hang_gravity(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    rows = [[hidden.number(f"{out}{along}") for along in SENSOR_AXES] for out in SENSOR_AXES]
    board_of(hidden, hooks).rates.append(GSensitivity(np.array(rows)))


def _hang_rectification(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).rates.append(Rectification(hidden.array("coefficient")))


def _thermal_scale(draw: Draw) -> dict[str, Quantity]:
    return {"share_per_k": draw.by_axis("1/K")}


def _hang_thermal_scale(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).rates.append(ThermalScale(hidden.array("share_per_k")))


def _coupling(draw: Draw) -> dict[str, Quantity]:
    return {"bias": draw.by_axis("rad/s")}


def _hang_coupling(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).rates.append(MotorCoupling(hidden.array("bias")))


CAUSES = (
    Cause(
        "low_pass_lag", "relative error of the low-pass cut-off, which moves its lag",
        "sensor", "1", 0.3, 0.1, 0.5, 0.9, _low_pass, _hang_low_pass,
    ),
    Cause(
        "scale_quadratic", "largest coefficient q of q u^2",
        "sensor", "s/rad", 1e-3, 3e-4, 5e-3, 0.1, _quadratic, _hang_quadratic,
        places=SENSOR_AXES, together=True,
    ),
    Cause(
        "scale_cubic", "largest coefficient c of c u^3",
        "sensor", "s^2/rad^2", 1e-3, 3e-4, 1e-2, 0.5, _cubic, _hang_cubic,
        places=SENSOR_AXES, together=True,
    ),
    Cause(
        "scale_asymmetry", "largest share a of a |u|",
        "sensor", "1", 2e-3, 5e-4, 1e-2, 0.2, _asymmetry, _hang_asymmetry,
        places=SENSOR_AXES, together=True,
    ),
    Cause(
        "saturation", "rate that is never exceeded",
        "sensor", "rad/s", 1.2, 0.8, 1.7, 100.0, _limit, _hang_limit,
        places=SENSOR_AXES, together=True, signed=False, least=0.01, neutral=100.0,
    ),
    Cause(
        "dead_zone", "rate below which nothing is felt",
        "sensor", "rad/s", 8e-3, 2e-3, 3e-2, 0.5, _dead_zone, _hang_dead_zone,
        places=SENSOR_AXES, together=True, signed=False,
    ),
    Cause(
        "g_sensitivity", "what gravity adds to each axis, per acceleration",
        "sensor", "(rad/s)/(m/s^2)", 1.8e-4, 3e-5, 1e-3, 0.1,
        _gravity, _hang_gravity, places=SENSOR_AXES, together=True,
    ),
    Cause(
        "vibration_rectification", "largest coefficient v of v times the axes' speed squared",
        "sensor", "s/rad", 1e-3, 2e-4, 5e-3, 0.1,
        _quadratic, _hang_rectification, places=SENSOR_AXES, together=True,
    ),
    Cause(
        "thermal_scale", "largest relative change of the gain with the temperature",
        "sensor", "1/K", 3e-4, 1e-4, 2e-3, 0.05,
        _thermal_scale, _hang_thermal_scale, places=SENSOR_AXES, together=True,
    ),
    Cause(
        "motor_coupling", "largest bias while a motor turns",
        "sensor", "rad/s", 6e-4, 2e-4, 2e-3, 0.1, _coupling, _hang_coupling,
        places=SENSOR_AXES, together=True,
    ),
)  # fmt: skip
