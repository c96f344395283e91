"""How much of a cause a finder needs to see: by the number of its sizes.

A cause with k sizes (one for each axis of the sensor, a sine and a cosine of each wave) is
found by a chi-square test of k degrees of freedom, which needs the more the more there are:
the minimal detectable non-centrality is where that test, at one false alarm in a hundred over
a family of 36 tests, has the power 80 % (Baarda 1968, A
testing procedure for use in geodetic networks: minimal detectable bias). What is a shape
and no size (an instant, a frequency, a time constant, a damping) is not counted: 1x is that of
a test that knows it.

What to use when: `detectable_of` for a cause, or a shape outside the catalogue, which counts as
one size however many it has; `SIZES` for what is counted.
"""

from functools import lru_cache

from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

ALPHA, TESTS, POWER = 0.01, 36, 0.8
_AXES, _WAVE = 3, 2  # of the sensor; sine and cosine

# Those with more than one. Gravity turns in one plane as the stage tilts: of the nine numbers of
# its matrix six can ever show. Once and twice a turn are two waves. Hum has one phase on all axes.
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


def sizes_of(name: str) -> int:
    """Return how many sizes a cause has."""
    return SIZES.get(name, 1)


def detectable_of(name: str) -> float:
    """Return the minimal detectable non-centrality of a cause."""
    return _detectable(sizes_of(name))


@lru_cache
def _detectable(sizes: int) -> float:
    bar = float(chi2.isf(ALPHA / TESTS, sizes))

    def short(noncentrality: float) -> float:
        return float(ncx2.sf(bar, sizes, noncentrality)) - POWER

    return float(brentq(short, 1.0, 1000.0))
