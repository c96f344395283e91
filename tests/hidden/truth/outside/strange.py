"""Effects outside the catalogue. The solver must report: unexplained, depends on X.

`groups` are the covariates that the effect physically depends on. The solver must report one of
them first.
"""

import numpy as np
from tests.hidden.truth.outside.motion import Creep, StickSlip, WornBearing
from tests.hidden.truth.outside.sensing import (
    CrossProduct,
    GainDip,
    Magnet,
    RateDelay,
    Settling,
    Telegraph,
    TwistedCable,
)
from tests.hidden.truth.outside.shape import Shape, Site

from gyrorig_daemon.emulator.injection import Quantity

_DEG = np.pi / 180.0


def _make_vector(values: np.ndarray, unit: str) -> Quantity:
    return Quantity(tuple(values.tolist()), unit)


def _add_settling(site: Site) -> dict[str, Quantity]:
    constant_s = float(site.rng.uniform(0.15, 0.5))
    site.hooks.board(site.board).rate_effects.append(Settling(site.size, constant_s))
    return {"share": Quantity(site.size, "1"), "time_constant": Quantity(constant_s, "s")}


def _add_magnet(site: Site) -> dict[str, Quantity]:
    bias, phase = site.size * site.draw_direction(), float(site.rng.uniform(-np.pi, np.pi))
    site.hooks.board(site.board).rate_effects.append(Magnet(bias, phase))
    return {"bias": _make_vector(bias, "rad/s"), "phase": Quantity(phase, "rad")}


def _add_bearing(site: Site) -> dict[str, Quantity]:
    phase = float(site.rng.uniform(-np.pi, np.pi))
    period_s = float(site.rng.uniform(15.0, 30.0))
    site.hooks.pan.angle_effects.append(WornBearing(site.size, 3.0, phase, 0.2, period_s))
    return {"amplitude": Quantity(site.size, "rad"), "phase": Quantity(phase, "rad"),
            "modulation_period": Quantity(period_s, "s")}  # fmt: skip


def _add_dip(site: Site) -> dict[str, Quantity]:
    at, width = float(site.rng.uniform(-45.0, 30.0)) * _DEG, float(site.rng.uniform(5, 12)) * _DEG
    site.hooks.board(site.board).rate_effects.append(GainDip(site.size, at, width))
    return {"depth": Quantity(site.size, "1"), "at": Quantity(at, "rad"),
            "width": Quantity(width, "rad")}  # fmt: skip


def _add_creep(site: Site) -> dict[str, Quantity]:
    site.hooks.pan.angle_effects.append(Creep(site.size, 2.0))
    return {"share": Quantity(site.size, "1"), "time_constant": Quantity(2.0, "s")}


def _add_delay(site: Site) -> dict[str, Quantity]:
    site.hooks.board(site.board).rate_effects.append(RateDelay(site.size))
    return {"delay_per_rate": Quantity(site.size, "s^2")}


def _add_stick(site: Site) -> dict[str, Quantity]:
    below = float(site.rng.uniform(15.0, 30.0)) * _DEG
    pitch = float(site.rng.uniform(0.5, 1.5)) * _DEG
    site.hooks.pan.angle_effects.append(StickSlip(site.size, pitch, below))
    return {"amplitude": Quantity(site.size, "rad"), "pitch": Quantity(pitch, "rad"),
            "below": Quantity(below, "rad/s")}  # fmt: skip


def _add_cable(site: Site) -> dict[str, Quantity]:
    bias = site.size * site.draw_direction()
    site.hooks.board(site.board).rate_effects.append(TwistedCable(bias))
    return {"bias": _make_vector(bias, "rad/s")}


def _add_telegraph(site: Site) -> dict[str, Quantity]:
    begin_s, end_s = site.rig.session_s
    waits = site.rng.exponential((end_s - begin_s) / 8.0, 200)
    bias = site.size * site.draw_direction()
    site.hooks.board(site.board).bias_effects.append(Telegraph(bias, np.cumsum(waits)))
    return {"half_jump": _make_vector(bias, "rad/s"),
            "mean_dwell": Quantity((end_s - begin_s) / 8.0, "s")}  # fmt: skip


def _add_product(site: Site) -> dict[str, Quantity]:
    coefficient = site.size * site.draw_direction()
    site.hooks.board(site.board).rate_effects.append(CrossProduct(coefficient))
    return {"coefficient": _make_vector(coefficient, "s/rad")}


_MOVES = ("pan_transient", "tilt_transient", "move_gain")

OUTSIDE = {
    shape.name: shape
    for shape in (
        Shape("settling_gain", "the gain is wrong for a short time after a move begins",
              "1", 1e-3, _MOVES, _add_settling),
        Shape("magnet", "a bias that depends on the pan angle",
              "rad/s", 1e-3, ("bias_pan",), _add_magnet),
        Shape("worn_bearing", "three waves per turn of pan, with an amplitude that varies by 20 %",
              "rad", 1e-4, ("pan_angle",), _add_bearing),
        Shape("gain_dip", "the gain drops near one tilt",
              "1", 1e-2, ("tilt_angle",), _add_dip, needs_tilted_pan=True),
        Shape("creep", "pan moves a part of each distance late, within 2 s",
              "1", 1e-3, ("pan_transient", "move_gain", "bias_time"), _add_creep),
        Shape("rate_delay", "the delay of the sensor grows with the rate",
              "s^2", 1e-4, ("pan_transient", "tilt_transient", "move_delay", "speed"), _add_delay),
        Shape("stick_slip", "pan sticks and jumps at low speed",
              "rad", 1e-3, ("pan_transient", "speed", "moving"), _add_stick),
        Shape("twisted_cable", "a bias if the stage is turned and tilted",
              "rad/s", 1e-3, ("bias_pan", "bias_tilt"), _add_cable,
              needs_tilted_pan=True),
        Shape("telegraph", "a bias that jumps between two values",
              "rad/s", 1e-3, ("bias_time",), _add_telegraph),
        Shape("cross_product", "each axis measures a part of the product of the two others",
              "s/rad", 1e-3, ("tilt_angle", "speed", "own_rate"), _add_product,
              needs_tilted_pan=True),
    )
}  # fmt: skip
