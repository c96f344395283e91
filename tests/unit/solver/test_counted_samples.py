"""Boards that read the FIFO of a sensor: the samples of one reading share a timestamp."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from tests.unit.solver.made import samples_of
from tests.unit.solver.test_times_and_gaps import LOWEST_P, fit, gain_errors

from gyrorig_daemon.cli import run
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.clocks.counted_samples import has_shared_times, map_sample_counter
from gyrorig_solver.data.samples import load_samples

ROOT = Path(__file__).resolve().parents[3]
READINGS_S, EXTRA_S = 0.08, 0.05  # between two readings of the FIFO; random addition to it
BOARD = "GY80-1"


def reading_times(sample_s: np.ndarray) -> np.ndarray:
    """Return the time at which the board reads each sample from the FIFO, at irregular times."""
    rng = np.random.default_rng(3)
    count = int(np.ptp(sample_s) / READINGS_S) + 3
    read_s = sample_s[0] + np.cumsum(READINGS_S + EXTRA_S * rng.uniform(size=count))
    return np.asarray(read_s[np.searchsorted(read_s, sample_s)])


def test_the_counter_gives_the_times_of_the_samples() -> None:
    period_s, lost = 0.0025, np.r_[4000:4040, 50000:50001]
    number = np.delete(np.arange(70000), lost)  # the counter of 16 bits starts again at zero
    true_s = number * period_s
    host_s = reading_times(true_s)
    clock = map_sample_counter((number % 2**16).astype(np.uint32), host_s)
    assert clock.segment_count == 1
    error_s = clock.time_s - true_s
    assert np.ptp(error_s) < 0.2 * period_s
    assert 0.0 <= error_s.mean() < 2.0 * period_s


def drifting_times(drift_ppm: float, count: int = 13_000) -> np.ndarray:
    """Return the sample times at 100 Hz of a sensor whose rate drifts."""
    return np.cumsum(0.01 * (1.0 + drift_ppm * 1e-6 * np.arange(count) / count))


def late_reading_times(sample_s: np.ndarray) -> np.ndarray:
    """Return the arrival times of readings that are up to 10 ms late."""
    read_s = reading_times(sample_s)
    first = np.flatnonzero(np.diff(read_s, prepend=-1.0))
    late_s = np.random.default_rng(6).uniform(0.0, 0.01, first.size)
    return np.asarray(read_s + np.repeat(late_s, np.diff(first, append=read_s.size)))


@pytest.mark.parametrize("drift_ppm", [0, 50, 500])
@pytest.mark.parametrize(
    ("times", "rms_s"), [(reading_times, 0.3e-3), (late_reading_times, 0.5e-3)]
)
def test_a_sensor_rate_that_drifts_is_followed(
    drift_ppm: float, times: Callable[[np.ndarray], np.ndarray], rms_s: float
) -> None:
    """Before, a straight line had an error of 2.5 ms at 500 ppm in 130 s."""
    true_s = drifting_times(drift_ppm)
    clock = map_sample_counter(np.arange(true_s.size, dtype=np.uint32), times(true_s))
    assert (clock.time_s - true_s).std() < rms_s
    assert clock.structure_reason == ""


def test_a_drift_is_followed_across_a_pause_and_a_restart() -> None:
    true_s = drifting_times(500)
    number, pause, restart = np.arange(true_s.size), slice(4000, 4500), 9000
    host_s = reading_times(true_s)
    true_s[restart:] += 1.3
    host_s[restart:] += 1.3
    number[restart:] -= restart
    true_s, host_s, number = (np.delete(values, pause) for values in (true_s, host_s, number))
    clock = map_sample_counter(number.astype(np.uint32), host_s)
    assert clock.segment_count == 2
    for segment in range(2):
        rows = clock.segment == segment
        assert (clock.time_s - true_s)[rows].std() < 0.5e-3


def test_few_samples_lie_on_a_straight_line() -> None:
    true_s = drifting_times(0, count=1000)
    clock = map_sample_counter(np.arange(1000, dtype=np.uint32), late_reading_times(true_s))
    steps_s = np.diff(clock.time_s)
    assert np.ptp(steps_s) < 1e-9


def test_readings_that_beat_with_the_samples_are_no_drift() -> None:
    """A reading every 0.1 s, and 100.03 samples per second: a beat of 33 s and of 10 ms."""
    true_s = np.arange(13_000) / 100.03
    host_s = np.ceil(true_s / 0.1) * 0.1
    clock = map_sample_counter(np.arange(true_s.size, dtype=np.uint32), host_s)
    assert (clock.time_s - true_s).std() < 0.3e-3


@pytest.mark.parametrize(
    ("ticks", "is_shared"),
    [
        (np.arange(1000), False),  # each sample has a time
        (np.arange(1000) * 5 // 8, False),  # a clock that is slower than the samples
        (np.zeros(1000, np.int64), False),  # no clock
        (np.arange(1000) // 8 * 80, True),
        (np.arange(1000) // 3, True),
    ],
)
def test_times_of_readings_are_recognised(ticks: np.ndarray, is_shared: bool) -> None:
    assert has_shared_times(ticks, np.arange(1000, dtype=np.uint32)) == is_shared
    assert not has_shared_times(ticks, np.zeros(1000, np.uint32))  # without a counter


def test_the_gain_is_as_uncertain_as_stated(simulate: Callable[..., Any]) -> None:
    rig = simulate(3, tilts=(-600, 400))
    number = np.arange(rig.time_s.size, dtype=np.uint32)
    clock = map_sample_counter(number, reading_times(rig.time_s))
    result = fit(rig, samples_of(rig.time_s, rig.rate_rad_s, clock))
    error, covariance = gain_errors(rig, result)
    assert stats.chi2.sf(error @ np.linalg.solve(covariance, error), 9) > LOWEST_P


@pytest.mark.long
def test_a_recording_of_a_fifo_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before, the solver refused it, because the timestamps did not give a sample rate."""
    run(
        ["record", "--config", str(ROOT / "config" / "rig.yaml"), "--out", str(tmp_path),
         "--program", str(ROOT / "config" / "programs" / "static.yaml"), "--simulated-time"]
    )  # fmt: skip
    recording = read_recording(next(tmp_path.glob("*.mcap")))
    expected = load_samples(recording, BOARD)
    columns = Recording.imu_columns

    def read_columns(self: Recording, board: BoardId) -> Any:
        raw = columns(self, board)
        last = np.minimum(np.arange(raw.sequence.size) // 8 * 8 + 7, raw.sequence.size - 1)
        return replace(raw, device_time=raw.device_time[last], host_time_ns=raw.host_time_ns[last])

    monkeypatch.setattr(Recording, "imu_columns", read_columns)
    samples = load_samples(recording, BOARD)
    assert samples.period_s == pytest.approx(expected.period_s, rel=1e-5)
    assert samples.lost == expected.lost
    assert np.ptp(samples.time_s - expected.time_s) < 0.1 * expected.period_s
