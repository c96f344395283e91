"""Attitudes by others: stamps that jitter or arrive late, lost frames, and clocks that drift."""

import numpy as np
import pytest
from tests.bench.bench_reference_stamps import errors_in_sd
from tests.support.simulated_attitudes import StampSettings, simulate_attitudes
from tests.support.simulated_samples import plain_samples

from gyrorig_protocol.errors import InputError
from gyrorig_solver.estimate import GyroFit, fit_attitude
from gyrorig_solver.reference import read_attitude
from gyrorig_solver.reference.attitude_stamps import read_stamps

FREE_ERRORS = 13  # of one session: nine gains, three biases, a time offset


def errors_of(settings: StampSettings, seeds: range, camera_hz: float = 100.0) -> np.ndarray:
    sessions = [simulate_attitudes(seed, settings, camera_hz=camera_hz) for seed in seeds]
    return np.concatenate([errors_in_sd(session) for session in sessions])


def solved(settings: StampSettings) -> GyroFit:
    session = simulate_attitudes(1, settings)
    reference = read_attitude(
        session.stamp_s, session.orientation_xyzw, np.full(session.stamp_s.size, np.nan)
    )
    return fit_attitude([(plain_samples(session.gyro_time_s, session.gyro_rad_s), reference)])


@pytest.mark.long
@pytest.mark.parametrize(
    "settings",
    [
        StampSettings(1e-3, "arrival"),
        StampSettings(5e-3, "arrival", 100.0),
        StampSettings(2e-3, "exponential", 100.0),
        StampSettings(1e-3, "device"),
        StampSettings(5e-3, "device", 100.0),
    ],
    ids=["arrival 1 ms", "arrival 5 ms skewed", "exponential 2 ms", "device 1 ms", "device 5 ms"],
)
def test_jitter_of_stamps_biases_nothing(settings: StampSettings) -> None:
    """With the jittered step as the divisor, the largest error is above 15 sd in each case."""
    errors = errors_of(settings, range(3))
    # 39 errors of unit variance, correlated inside a session.
    assert np.mean(errors**2) < 2.2
    assert np.abs(errors).max() < 4.5


@pytest.mark.long
@pytest.mark.parametrize(
    "settings",
    [
        StampSettings(5e-4, drop_share=0.05),
        StampSettings(2e-3, "exponential", drop_share=0.02),
        StampSettings(5e-4, repeat_share=0.03),
        StampSettings(5e-4, outlier_share=0.01),
        StampSettings(1e-3, "arrival", lost_s=6.0),
        StampSettings(5e-4, swap=(0.0, 0.0, 1.57)),
        StampSettings(5e-4, step_s=0.01),
        StampSettings(skew_ppm=500.0),
        StampSettings(irregular_s=1e-3),
    ],
    ids=[
        "dropped",
        "dropped and late",
        "repeated",
        "outliers",
        "lost tracking",
        "swapped markers",
        "clock step",
        "skew",
        "irregular frames",
    ],
)
def test_defects_of_a_reference_bias_nothing(settings: StampSettings) -> None:
    errors = errors_of(settings, range(2))
    assert np.mean(errors**2) < 2.5
    assert np.abs(errors).max() < 4.5


def test_hidden_missing_frames_are_refused() -> None:
    with pytest.raises(InputError, match="the jitter hides which frames are missing"):
        solved(StampSettings(5e-3, drop_share=0.02))


@pytest.mark.long
def test_what_was_corrected_is_said() -> None:
    skewed = " ".join(solved(StampSettings(1e-3, "arrival", skew_ppm=100.0)).warnings)
    assert "100 ppm fast" in skewed
    assert "-10.0 ms at" in " ".join(solved(StampSettings(step_s=0.01)).warnings)
    swapped = " ".join(solved(StampSettings(swap=(0.0, 0.0, 1.57))).warnings)
    assert "another frame of the body" in swapped
    assert "turned by 90 deg" in swapped
    assert solved(StampSettings()).warnings == ()


def test_a_step_of_the_clock_makes_the_time_offset_uncertain() -> None:
    assert solved(StampSettings(step_s=0.01)).std["time_offset"] > 0.004


def test_frames_are_numbered_through_losses() -> None:
    for settings in (
        StampSettings(1e-3, drop_share=0.05),
        StampSettings(1e-3, "arrival", 0.0, 0.0, 0.1),
    ):
        session = simulate_attitudes(2, settings)
        stamps = read_stamps(session.stamp_s)
        offset = stamps.frame - session.frame
        assert np.all(offset == offset[0])
        assert stamps.missing == session.frame[-1] - session.frame[0] + 1 - session.frame.size
        assert np.std(stamps.candidates[0].time_s - session.true_time_s) < 2e-5


def test_late_stamps_are_told_from_symmetric_jitter() -> None:
    for kind, is_late in (("arrival", True), ("exponential", True), ("device", False)):
        session = simulate_attitudes(3, StampSettings(1e-3, kind))
        assert read_stamps(session.stamp_s).is_late is is_late
        assert read_stamps(session.stamp_s, "sampled").is_late is False
        assert read_stamps(session.stamp_s, "arrival").is_late is True


def test_exact_stamps_stay_as_they_are() -> None:
    time_s = 5.0 + np.arange(500) / 120.0
    stamps = read_stamps(time_s)
    assert len(stamps.candidates) == 1
    assert np.array_equal(stamps.candidates[0].time_s, time_s)
    assert stamps.missing == 0
