"""The second opinion: blind to timing, and able to contradict."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import analyse_observability
from gyrorig_solver.estimate.rest_to_rest import GAIN_AND_BIAS_NAMES, BoardPath, cross_check

RAD_PER_STEP = float(np.radians(185.142857 / 3600.0))
EXACT = analyse_observability(
    np.eye(12) * 1e10, GAIN_AND_BIAS_NAMES
)  # a fit known to 1e-5 everywhere
DENSITY = 2.7e-7  # (5.2e-4 rad/s/sqrt(Hz))^2, the simulated rig's
Simulate = Callable[..., Any]


def path_of(rig: Any, late_s: float = 0.0) -> BoardPath:
    """The simulated board with exact angles at rest, and its clock late by `late_s`."""
    polled = [np.interp(rig.time_s, rig.poll_hi_s, s) * RAD_PER_STEP for s in rig.poll_steps.T]
    turning = np.abs(np.gradient(np.array(polled), axis=1)).sum(axis=0) > 1e-9
    wide = np.convolve(turning, np.ones(5), "same") > 0.5  # the lag
    used = np.ones(rig.time_s.size, np.bool_)
    return BoardPath(rig.time_s + late_s, rig.rate_rad_s, used, wide, np.array(polled))


def agreement(rig: Any, gain: FloatArray, late_s: float = 0.0) -> tuple[float, float]:
    check = cross_check([path_of(rig, late_s)], gain, rig.bias_rad_s, EXACT, DENSITY, 0.0)
    assert check is not None
    assert check.degrees_of_freedom == 9
    return check.p_value, check.largest_sigma


def test_cross_check_accepts_the_true_gain(simulate: Simulate) -> None:
    """Six boards: p-values of a right gain spread; none below 1 in 10 000."""
    agreements = [agreement(rig, rig.gain)[0] for rig in map(simulate, range(6))]
    assert min(agreements) > 1e-4
    assert max(agreements) > 0.1


def test_cross_check_rejects_a_wrong_gain(simulate: Simulate) -> None:
    rig = simulate(1)
    wrong = rig.gain.copy()
    wrong[2, 2] *= 1.005
    p_value, sigma = agreement(rig, wrong)
    assert p_value < 1e-6
    assert sigma > 5.0


def test_cross_check_ignores_time_offsets(simulate: Simulate) -> None:
    """A constant clock error changes nothing; the contents of the rests decide."""
    rig = simulate(2)
    assert agreement(rig, rig.gain, 0.5) == pytest.approx(agreement(rig, rig.gain), rel=1e-9)


def test_cross_check_needs_enough_moves(simulate: Simulate) -> None:
    path = path_of(simulate(0, tilts=(0,)))
    still = replace(path, moving=np.zeros_like(path.moving))
    assert cross_check([still], np.eye(3), np.zeros(3), EXACT, DENSITY, 0.0) is None
