"""A gyro that is rounded to coarse counts, in fits to reference attitudes with a rest."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import fit_attitude
from gyrorig_solver.estimate.rest_mean import mean_std_by_rounding
from gyrorig_solver.reference import AttitudeReference, read_attitude

GYRO_HZ, REFERENCE_HZ, MOTION_S, REST_S = 100.0, 60.0, 50.0, 30.0
COUNT_RAD_S = float(np.radians(1.0))
QUIET_COUNTS, LOUD_COUNTS = 0.06, 0.8  # noise of a sample
Maker = Callable[..., GyroSamples]
Tumbler = Callable[[int], object]


def session(
    motion: object, make: Maker, gain: FloatArray, bias_rad_s: FloatArray, noise_counts: float
) -> tuple[GyroSamples, AttitudeReference]:
    """A rest and a motion, rounded."""
    rng = np.random.default_rng(8)
    time_s = np.arange(int((MOTION_S + REST_S) * GYRO_HZ)) / GYRO_HZ
    at_s = np.arange(0.1, MOTION_S + REST_S - 0.1, 1.0 / REFERENCE_HZ)
    true = motion.rate_rad_s(time_s - REST_S)  # type: ignore[attr-defined]
    true[time_s < REST_S] = 0.0
    rate = true @ gain.T + bias_rad_s + rng.normal(size=true.shape) * noise_counts * COUNT_RAD_S
    rate = np.rint(rate / COUNT_RAD_S) * COUNT_RAD_S
    noise = Rotation.from_rotvec(rng.normal(size=(at_s.size, 3)) * 2e-4)
    attitude = motion.attitude(np.maximum(at_s - REST_S, 0.0))  # type: ignore[attr-defined]
    reference = read_attitude(at_s, (attitude * noise).as_quat(), np.zeros(at_s.size))
    return replace(make(time_s, rate), quantum_rad_s=COUNT_RAD_S), reference


@pytest.mark.parametrize("count_share", [0.35, -0.35])
def test_a_rest_of_a_rounded_gyro_has_the_error_of_a_count(
    tumble: Tumbler, samples_of: Maker, true_gain: FloatArray, count_share: float
) -> None:
    """Before, the bias differed by more than 6 standard uncertainties from the true one."""
    bias_rad_s = np.full(3, count_share * COUNT_RAD_S)
    pair = session(tumble(2), samples_of, true_gain, bias_rad_s, QUIET_COUNTS)
    fit = fit_attitude([pair])
    std_rad_s = np.array([fit.std[f"bias.{axis}"] for axis in "xyz"])
    assert np.abs((fit.bias_rad_s - bias_rad_s) / std_rad_s).max() < 2.5
    rest_share = REST_S / (REST_S + MOTION_S)
    assert std_rad_s == pytest.approx(rest_share * COUNT_RAD_S / np.sqrt(12.0), rel=0.15)
    assert np.abs((fit.gain - true_gain) / fit.gain_std).max() < 4.5


def test_noise_or_motion_over_several_counts_adds_nothing(
    tumble: Tumbler, samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    loud, _ = session(tumble(2), samples_of, true_gain, true_bias_rad_s, LOUD_COUNTS)
    assert not mean_std_by_rounding(loud).any()
    quiet, _ = session(tumble(2), samples_of, true_gain, true_bias_rad_s, QUIET_COUNTS)
    moving = replace(quiet, usable=quiet.usable & (quiet.time_s >= REST_S))
    assert mean_std_by_rounding(moving).max() < 0.01 * COUNT_RAD_S
    few = replace(quiet, usable=quiet.usable & (quiet.time_s < 0.5))
    assert not mean_std_by_rounding(few).any()
