"""Each cause between the sensor and the file changes the rows of the recording as it should."""

from typing import Any

import numpy as np
import pytest
from tests.bench.rigs.recording_file import answered_counts
from tests.bench.rigs.rig import SimulatedRig


def test_clocks(plain: SimulatedRig, record: Any) -> None:
    host_s = plain.stream.host_s
    span_s = (0.4, plain.session.end_s - 0.4)
    skewed = record({"clock_skew": {"size": 1e-3}}).stream.host_s
    assert skewed - host_s == pytest.approx(1e-3 * (host_s - np.mean(span_s)), abs=1e-6)
    stepped = record({"clock_step": {"size": 0.02, "at": 0.5}}).stream.host_s
    late = host_s >= np.mean(span_s)
    assert stepped - host_s == pytest.approx(np.where(late, 0.02, 0.0))


def test_lost_samples_leave_a_gap_in_the_counter(plain: SimulatedRig, record: Any) -> None:
    other = record({"lost_samples": {"size": 0.2}}).stream
    lost = plain.stream.number.size - other.number.size
    assert lost / plain.stream.number.size == pytest.approx(0.2, abs=0.05)
    assert np.sum(np.diff(other.number) - 1) == lost


def test_repeated_samples_have_the_counts_before(plain: SimulatedRig, record: Any) -> None:
    other = record({"repeated_samples": {"size": 0.3}}, is_noisy=True)
    gyro = other.stream.gyro
    share = np.mean(np.all(gyro[1:] == gyro[:-1], axis=1))
    assert share == pytest.approx(0.3, abs=0.06)
    # Each sample is older by 0.3 + 0.3^2 + ... periods on average.
    older_s = other.truth[12] - plain.truth[12]
    assert older_s * other.gyroscope.odr_hz == pytest.approx(0.3 / 0.7, abs=0.1)


def test_corrupt_samples_have_one_other_bit(plain: SimulatedRig, record: Any) -> None:
    changed = record({"corrupt_samples": {"size": 0.1}}).stream.gyro ^ plain.stream.gyro
    words = changed[changed != 0]
    assert words.size / plain.stream.gyro.shape[0] == pytest.approx(0.1, abs=0.04)
    assert np.all(words & (words - 1) == 0)


def test_jitter_moves_the_instants(plain: SimulatedRig, record: Any) -> None:
    other = record({"sample_jitter": {"size": 1e-3}})
    rate = plain.stream_truth.clean_rad_s[:, 2]
    slope = np.gradient(rate, plain.stream_truth.sample_s)
    changed = other.stream_truth.clean_rad_s[:, 2] - rate
    steep = np.abs(slope) > 2.0
    assert steep.sum() > 20
    assert np.std(changed[steep] / slope[steep]) == pytest.approx(1e-3, rel=0.3)


def test_replies_tell_the_count_and_not_the_angle(record: Any) -> None:
    other = record({"backlash": {"pan": 0.01, "face": 1.0}, "tilt_zero": {"size": 0.1}})
    assert answered_counts(other, 1)[-1] == other.session.moves[1].end_steps
    assert answered_counts(other, 0)[-1] == 0
