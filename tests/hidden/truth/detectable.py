"""Minimal detectable non-centrality of a cause, from the number of its sizes.

A chi-square test with k degrees of freedom finds a cause with k sizes: one for each axis of the
sensor, a sine and a cosine of each wave. At the minimal detectable non-centrality, this test has
the power 80 %. Its level is one false alarm in a hundred over a family of 36 tests. The level
grows with k. Source: Baarda 1968, A testing procedure for use in geodetic networks (minimal
detectable bias). Parameters of the shape (an instant, a frequency, a time constant, a damping) do
not count as sizes: 1x is the size for a test with the known shape.

What to use when: `compute_detectable` for a cause, or for a shape outside the catalogue, which
counts as one size; `SIZES` for the causes with more than one size.
"""

from functools import lru_cache

from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

ALPHA, TESTS, POWER = 0.01, 36, 0.8
_AXES, _WAVE = 3, 2  # of the sensor; sine and cosine

# Causes with more than one size. Gravity turns in one plane as the stage tilts, so only six of the
# nine numbers of its matrix are observable. Eccentricity has two waves, with one and two periods
# per turn. Hum has one phase on all axes.
SIZES = {
    **dict.fromkeys(
        ("scale_quadratic", "scale_cubic", "scale_asymmetry", "vibration_rectification",
         "thermal_scale", "motor_coupling", "thermal_bias", "warm_up", "bias_ramp", "bias_step",
         "bias_random_walk", "board_slip"),
        _AXES,
    ),
    "g_sensitivity": 2 * _AXES,
    "supply_hum": _AXES + 1,
    "eccentricity": 2 * _WAVE,
    "worm_error": _WAVE,
    "tilt_sag": _WAVE,
}  # fmt: skip


def count_sizes(name: str) -> int:
    """Return the number of sizes of a cause."""
    return SIZES.get(name, 1)


def compute_detectable(name: str) -> float:
    """Return the minimal detectable non-centrality of a cause."""
    return _solve_detectable(count_sizes(name))


@lru_cache
def _solve_detectable(sizes: int) -> float:
    bar = float(chi2.isf(ALPHA / TESTS, sizes))

    def compute_power_error(noncentrality: float) -> float:
        return float(ncx2.sf(bar, sizes, noncentrality)) - POWER

    return float(brentq(compute_power_error, 1.0, 1000.0))
