"""Means instead of the samples of a long recording: exact, and as precise as the samples."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, cont2discrete, lfilter
from tests.bench.long_recording import write_long
from tests.support.board_fits import explain_recordings

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.discover import FitExplanation
from gyrorig_solver.discover.checks.ramp_check import RAMP_STAGES
from gyrorig_solver.discover.checks.windowed_signals import group_windows
from gyrorig_solver.estimate import sample_averaging
from gyrorig_solver.estimate.sample_averaging import average_samples, averaging_factor
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.model.low_pass import delay_distribution
from gyrorig_solver.uncertainty import assess_uncertainty

BOARD = "LONG-1"


def test_a_short_recording_is_not_averaged() -> None:
    assert averaging_factor(500_000, 800.0, 110.0) == 1


def test_a_mean_lasts_a_period_of_the_bandwidth() -> None:
    assert averaging_factor(500_001, 800.0, 110.0) == 8
    assert averaging_factor(500_001, 800.0, None) == 6


@pytest.mark.parametrize("count", [500_001, 2_880_000, 23_040_000])
def test_few_means_remain(count: int) -> None:
    assert count / averaging_factor(count, 800.0, 110.0) <= sample_averaging.MAX_MEANS


def test_means_are_of_whole_groups() -> None:
    raw = np.arange(33, dtype=np.int16).reshape(11, 3)
    time_s, total, valid = average_samples(np.arange(11.0), raw, np.ones(11, np.bool_), 3)
    np.testing.assert_array_equal(time_s, [1.0, 4.0, 7.0])
    np.testing.assert_array_equal(total, raw[:9].reshape(3, 3, 3).sum(axis=1))
    assert valid.all()


def test_a_few_missing_samples_are_interpolated_and_many_are_not() -> None:
    raw = np.arange(90, dtype=np.int16).reshape(30, 3)
    good = np.ones(30, np.bool_)
    good[[4, 5, 12, 13, 14, 15, 29]] = False
    broken = np.where(good[:, None], raw, 30_000)
    _, total, valid = average_samples(np.arange(30.0), broken, good, 10)
    np.testing.assert_array_equal(valid, [True, False, False])
    np.testing.assert_array_equal(total[0], raw[:10].sum(axis=0))
    assert not average_samples(np.arange(30.0), broken, np.zeros(30, np.bool_), 10)[2].any()


def test_a_sum_of_large_counts_does_not_overflow() -> None:
    raw = np.full((100, 3), 32_767, dtype=np.int16)
    _, total, _ = average_samples(np.arange(100.0), raw, np.ones(100, np.bool_), 100)
    np.testing.assert_array_equal(total, np.full((1, 3), 3_276_700.0))


def test_delays_act_on_means_like_the_low_pass() -> None:
    """Means of a filtered jump, at all places in a mean, by SciPy's filter and by the delays."""
    bandwidth_hz, fine_hz, mean_s = 30.0, 50_000.0, 0.05
    omega = 2.0 * np.pi * bandwidth_hz
    b, a, _ = cont2discrete(butter(2, omega, analog=True), 1.0 / fine_hz, "foh")
    time_s = np.arange(0.0, 1.0, 1.0 / fine_hz)
    angle = np.maximum(time_s - 0.5, 0.0)  # of a unit jump of the rate
    filtered = lfilter(b.ravel(), a, angle)
    delays_s, weights = delay_distribution(bandwidth_hz)
    group_delay_s = np.sqrt(2.0) / omega

    def ramp(at_s: float) -> float:
        return float(weights @ np.maximum(at_s - group_delay_s - delays_s - 0.5, 0.0))

    errors = []
    for begin_s in np.arange(0.4, 0.6, 0.001):
        begin, end = round(begin_s * fine_hz), round((begin_s + mean_s) * fine_hz)
        exact = (filtered[end] - filtered[begin]) / mean_s
        errors.append((ramp(time_s[end]) - ramp(time_s[begin])) / mean_s - exact)
    assert np.abs(errors).max() < 0.004  # of the jump; a delay alone is wrong by 0.01
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert weights @ delays_s == pytest.approx(0.0, abs=1e-15)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path: Path = tmp_path_factory.mktemp("long") / "long.mcap"
    write_long(path, 90.0, seed=5)
    return read_recording(path)


@pytest.fixture(scope="module")
def explanations(recording: Recording) -> tuple[FitExplanation, FitExplanation]:
    """The fit to samples, and the fit to means of about 0.06 s."""
    exact = explain_recordings([recording], BOARD)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sample_averaging, "MAX_SERIES_SAMPLES", 10_000)
        patch.setattr(sample_averaging, "MAX_MEANS", 1_500)
        return exact, explain_recordings([recording], BOARD)


@pytest.mark.long
def test_means_give_the_values_of_the_samples(
    explanations: tuple[FitExplanation, FitExplanation],
) -> None:
    exact, averaged = (explanation.solution_extended for explanation in explanations)
    std = np.sqrt(np.diag(exact.observability.covariance))
    assert np.abs((averaged.estimate - exact.estimate) / std).max() < 0.5
    np.testing.assert_allclose(
        np.sqrt(np.diag(averaged.observability.covariance)) / std, 1.0, atol=0.1
    )


def test_means_do_not_show_what_acts_for_milliseconds(
    explanations: tuple[FitExplanation, FitExplanation],
) -> None:
    exact, averaged = (explanation.findings for explanation in explanations)
    reasons = {untestable.cause: untestable.reason for untestable in averaged.untestable}
    assert "backlash" not in {untestable.cause for untestable in exact.untestable}
    for cause in ("backlash", "base_compliance", "ringing", "lost_steps", "board_slip"):
        assert "means over" in reasons[cause]
    assert "clock_skew" not in reasons
    assert averaged.verdict == "adequate"


def test_the_total_uncertainty_contains_what_the_means_hide(
    explanations: tuple[FitExplanation, FitExplanation],
) -> None:
    exact, averaged = (
        assess_uncertainty(explanation.solution_extended) for explanation in explanations
    )
    hidden = {"backlash", "base_compliance", "base_speed_jump", "ringing", "board_slip"}
    assert hidden <= {entry.cause for entry in averaged.entries}
    np.testing.assert_allclose(averaged.std[:12] / exact.std[:12], 1.0, atol=0.1)


def test_few_windows_stay_single_and_many_form_groups() -> None:
    spans_s = np.column_stack([np.arange(1000.0), np.arange(1000.0) + 0.5])
    np.testing.assert_array_equal(group_windows(spans_s[:512]), spans_s[:512])
    groups = group_windows(spans_s[::-1])
    assert len(groups) == 500
    np.testing.assert_array_equal(groups[0], [0.0, 1.5])


def test_the_causes_of_a_ramp_are_those_of_the_speed_profile() -> None:
    """In a long recording, the replies show that the ramps differ, and nothing shows how."""
    ramp_causes = {term.cause for term in catalogue().values() if term.stage in RAMP_STAGES}
    assert ramp_causes == {"acceleration_error", "base_speed_jump", "s_curve"}
