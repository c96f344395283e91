"""Shapes similar to a cause of the catalogue: softer, delayed, or with more harmonics.

A right result is the cause with a reported rest, or "unexplained" with the right covariate.
"""

import math

import numpy as np
from tests.hidden.truth.outside.motion import SoftPlay
from tests.hidden.truth.outside.sensing import SlowThermal, SmoothAsymmetry, SoftDeadZone
from tests.hidden.truth.outside.shape import Shape, Site

from gyrorig_daemon.emulator.causes.backlash import Backlash
from gyrorig_daemon.emulator.causes.ringing import Ringing
from gyrorig_daemon.emulator.causes.warm_up import WarmUp
from gyrorig_daemon.emulator.emulator_settings import PtuSettings
from gyrorig_daemon.emulator.injection import Quantity
from gyrorig_daemon.emulator.physics.effects.harmonic import Harmonic
from gyrorig_daemon.emulator.physics.stepper_axis import ARCSEC_RAD

_WORM_TURNS = 17.5
_WIDTHS = (0.25, 0.75, 1.25, 1.75)  # of the gap's mean


def _make_vector(values: np.ndarray, unit: str) -> Quantity:
    return Quantity(tuple(values.tolist()), unit)


def _draw_phase(site: Site) -> float:
    return float(site.rng.uniform(-math.pi, math.pi))


def _add_soft_play(site: Site) -> dict[str, Quantity]:
    unit = site.rig.ptu or PtuSettings()
    gap_steps = site.size / (unit.resolution_arcsec * ARCSEC_RAD)
    plays = tuple(Backlash(gap_steps * width) for width in _WIDTHS)
    site.hooks.pan.step_effects.append(SoftPlay(plays))
    return {"mean_gap": Quantity(site.size, "rad")}


def _add_slow_thermal(site: Site) -> dict[str, Quantity]:
    slope = site.size * site.draw_direction()
    first_s, second_s = (float(site.rng.uniform(*span)) for span in ((20.0, 40.0), (60.0, 120.0)))
    site.hooks.board(site.board).bias_effects.append(SlowThermal(slope, first_s, second_s))
    return {"slope": _make_vector(slope, "rad/s/K"), "first_lag": Quantity(first_s, "s"),
            "second_lag": Quantity(second_s, "s")}  # fmt: skip


def _add_double_warm_up(site: Site) -> dict[str, Quantity]:
    start = site.size * site.draw_direction()
    fast_s, slow_s = (float(site.rng.uniform(*span)) for span in ((12.0, 25.0), (120.0, 240.0)))
    board = site.hooks.board(site.board)
    board.bias_effects += [WarmUp(0.6 * start, fast_s), WarmUp(0.4 * start, slow_s)]
    return {"at_power_up": _make_vector(start, "rad/s"), "fast": Quantity(fast_s, "s"),
            "slow": Quantity(slow_s, "s")}  # fmt: skip


def _add_two_waves(site: Site, first: float, second: float, share: float) -> dict[str, Quantity]:
    phases = _draw_phase(site), _draw_phase(site)
    site.hooks.pan.angle_effects += [
        Harmonic(site.size, first, phases[0]), Harmonic(share * site.size, second, phases[1])
    ]  # fmt: skip
    return {"amplitude": Quantity(site.size, "rad"), "phase": Quantity(phases[0], "rad"),
            "second_amplitude": Quantity(share * site.size, "rad"),
            "second_phase": Quantity(phases[1], "rad")}  # fmt: skip


def _add_rich_eccentricity(site: Site) -> dict[str, Quantity]:
    return _add_two_waves(site, 1.0, 3.0, 0.5)


def _add_rich_worm(site: Site) -> dict[str, Quantity]:
    return _add_two_waves(site, _WORM_TURNS, 2.0 * _WORM_TURNS, 0.6)


def _add_two_modes(site: Site) -> dict[str, Quantity]:
    low_hz, high_hz = (float(site.rng.uniform(*span)) for span in ((5.0, 8.0), (11.0, 15.0)))
    site.hooks.pan.angle_effects += [
        Ringing(site.size, low_hz, 0.05),
        Ringing(site.size, high_hz, 0.05),
    ]
    return {"share": Quantity(site.size, "1"), "low": Quantity(low_hz, "Hz"),
            "high": Quantity(high_hz, "Hz")}  # fmt: skip


def _add_soft_zone(site: Site) -> dict[str, Quantity]:
    site.hooks.board(site.board).rate_effects.append(SoftDeadZone(site.size))
    return {"width": Quantity(site.size, "rad/s")}


def _add_smooth_asymmetry(site: Site) -> dict[str, Quantity]:
    share, width = site.size * site.draw_direction(), float(site.rng.uniform(0.3, 0.8))
    site.hooks.board(site.board).rate_effects.append(SmoothAsymmetry(share, width))
    return {"share": _make_vector(share, "1"), "width": Quantity(width, "rad/s")}


_PAN = ("pan_transient", "move_gain", "move_delay")

NEARLY = {
    shape.name: shape
    for shape in (
        Shape("soft_backlash", "a gap of pan that closes gradually",
              "rad", 5e-4, (*_PAN, "pan_angle"), _add_soft_play, "backlash"),
        Shape("slow_thermal", "a bias that follows the temperature of the board through two lags",
              "rad/s/K", 1e-3, ("bias_time",), _add_slow_thermal, "thermal_bias", needs_soak=True),
        Shape("double_warm_up", "a bias that converges with two time constants",
              "rad/s", 5e-3, ("bias_time",), _add_double_warm_up, "warm_up"),
        Shape("rich_eccentricity", "one and three waves per turn of pan",
              "rad", 5e-4, ("pan_angle",), _add_rich_eccentricity, "eccentricity"),
        Shape("rich_worm", "one and two waves per turn of the worm of pan",
              "rad", 1e-4, ("pan_angle",), _add_rich_worm, "worm_error"),
        Shape("two_modes", "two modes of pan ring after every change of speed",
              "1", 2e-2, _PAN, _add_two_modes, "ringing"),
        Shape("soft_dead_zone", "the sensor measures small rates too small",
              "rad/s", 1e-2, ("own_rate", "speed", "pan_transient", "tilt_transient"),
              _add_soft_zone, "dead_zone"),
        Shape("smooth_asymmetry", "another scale in the other direction, but not near rest",
              "1", 2e-3, ("own_rate", "speed"), _add_smooth_asymmetry, "scale_asymmetry"),
    )
}  # fmt: skip
