"""Gaps of the gyroscope's samples in a fit to reference attitudes: memory, and the first lag."""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import fit_attitude
from gyrorig_solver.estimate.attitude.attitude_matching import coarse_lag_s, match_segments
from gyrorig_solver.reference import AttitudeReference, read_attitude

GYRO_HZ, REFERENCE_HZ, SPAN_S = 200.0, 120.0, 90.0
REST_S = 25.0  # longer than each part of the motion between two gaps
LAG_S = 0.121
GAP_PERIOD_S, GAP_S = 3.0, 0.05
Maker = Callable[..., GyroSamples]
Tumbler = Callable[[int], object]


def session(
    motion: object, make: Maker, gain: FloatArray, bias_rad_s: FloatArray
) -> tuple[GyroSamples, AttitudeReference]:
    """A rest and a motion."""
    rng = np.random.default_rng(5)
    time_s = np.arange(int(SPAN_S * GYRO_HZ)) / GYRO_HZ
    at_s = np.arange(0.1, SPAN_S - 0.1, 1.0 / REFERENCE_HZ)
    moving_s = time_s - LAG_S - REST_S
    true = motion.rate_rad_s(moving_s) * (moving_s > 0.0)[:, None]  # type: ignore[attr-defined]
    rate = true @ gain.T + bias_rad_s + rng.normal(size=true.shape) * 1e-3
    noise = Rotation.from_rotvec(rng.normal(size=(at_s.size, 3)) * 2e-4)
    attitude = motion.attitude(np.maximum(at_s - REST_S, 0.0))  # type: ignore[attr-defined]
    return make(time_s, rate), read_attitude(
        at_s, (attitude * noise).as_quat(), np.zeros(at_s.size)
    )


def with_gaps(samples: GyroSamples) -> GyroSamples:
    """Return samples with a gap just before the motion, and one in every few seconds of it."""
    since_s = samples.time_s - (REST_S - 0.2)
    in_gap = (since_s > 0.0) & (since_s % GAP_PERIOD_S < GAP_S)
    return replace(samples, usable=samples.usable & ~in_gap)


def peak_bytes(samples: GyroSamples, reference: AttitudeReference) -> int:
    """Return the largest memory of the segments, in which the fit is repeated many times."""
    tracemalloc.start()
    segments = match_segments(samples, reference)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert segments
    return peak


def test_gaps_need_little_memory(
    tumble: Tumbler, samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    samples, reference = session(tumble(2), samples_of, true_gain, true_bias_rad_s)
    complete_bytes = peak_bytes(samples, reference)
    # Before, each part had its own rates of all attitudes: 4 times the memory.
    assert peak_bytes(with_gaps(samples), reference) < 1.2 * complete_bytes


def test_the_first_lag_is_that_of_the_motion_and_not_of_the_longest_part(
    tumble: Tumbler, samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    samples, reference = session(tumble(2), samples_of, true_gain, true_bias_rad_s)
    gapped = with_gaps(samples)
    segments = match_segments(gapped, reference)
    longest = max(segments, key=lambda segment: segment.track.begin_s.size)
    assert longest.track.end_s[-1] < REST_S
    assert abs(coarse_lag_s(segments) - LAG_S) < 0.01
    fit = fit_attitude([(gapped, reference)])
    assert fit.identified
    assert abs(fit.time_offset_s - LAG_S) < 1e-3
    assert np.abs((fit.gain - true_gain) / fit.gain_std).max() < 4.5


def test_too_few_samples_without_a_gap_are_refused(
    tumble: Tumbler, samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    """Before, the fit of the times ended with an error of NumPy."""
    samples, reference = session(tumble(2), samples_of, true_gain, true_bias_rad_s)
    first_s = REST_S + 10.0
    is_kept = (samples.time_s > first_s) & (samples.time_s < first_s + 1.2)
    short = replace(samples, usable=samples.usable & is_kept)
    with pytest.raises(InputError, match="too short for a fit"):
        fit_attitude([(short, reference)])
    fit = fit_attitude([(short, reference), (samples, reference)])
    assert np.abs((fit.gain - true_gain) / fit.gain_std).max() < 4.5
