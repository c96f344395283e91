"""Numbers of samples by their times: missing rows, pauses, merged logs, and times that jitter."""

import time
from pathlib import Path

import numpy as np
import pytest
from tests.support.handheld_session import simulate_session, write_xsens
from tests.unit.importers.test_import_measurements import BASE, archive, mapped

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.importers import import_files, import_measurements
from gyrorig_solver.importers.sample_numbers import number_sampled_rows
from gyrorig_solver.importers.stamp_kinds import count_rows

RATE_HZ = 200.0
ROWS = 40_000


def imported(folder: Path, time_s: np.ndarray, rate: np.ndarray) -> GyroSamples:
    source = archive(folder / "in.npz", t=time_s, g=rate)
    path = import_measurements(source, mapped(BASE), folder / "out.mcap").path
    return load_samples(read_recording(path), "B1")


def noise(count: int = ROWS) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(count, 3)) * 0.1


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3, 0.5])
def test_missing_rows_are_lost_samples(tmp_path: Path, share: float) -> None:
    """Before, the period contained the lost time: 10 ms instead of 5 ms for half of the rows."""
    rows = np.flatnonzero(np.random.default_rng(2).random(ROWS) >= share)
    samples = imported(tmp_path, 1.0 + rows / RATE_HZ, noise()[rows])
    assert samples.period_s == pytest.approx(1.0 / RATE_HZ, rel=1e-6)
    assert samples.lost == rows[-1] - rows[0] + 1 - rows.size
    assert np.array_equal(samples.number, rows - rows[0])


@pytest.mark.parametrize("pause_s", [0.5, 3.0, 300.0])
def test_a_gap_is_not_part_of_the_period(tmp_path: Path, pause_s: float) -> None:
    row = np.arange(ROWS)
    samples = imported(tmp_path, 1.0 + row / RATE_HZ + pause_s * (row >= ROWS // 2), noise())
    assert samples.period_s == pytest.approx(1.0 / RATE_HZ, rel=1e-6)
    assert samples.lost == (100 if pause_s == 0.5 else 0)
    assert len(samples.contiguous_slices(longest_gap=10)) == 2


def test_the_other_rows_of_a_merged_log_are_no_lost_samples(tmp_path: Path) -> None:
    """Before: "200.00 per second, lost 19999"."""
    rate = noise()
    rate[1::2] = np.nan
    samples = imported(tmp_path, 1.0 + np.arange(ROWS) / RATE_HZ, rate)
    assert samples.period_s == pytest.approx(2.0 / RATE_HZ, rel=1e-6)
    assert (samples.lost, samples.number.size) == (0, ROWS // 2)


def test_rows_without_a_rate_are_lost_samples(tmp_path: Path) -> None:
    rate = noise()
    lost = np.random.default_rng(2).random(ROWS) < 0.5
    lost[[0, -1]] = False
    rate[lost] = np.nan
    samples = imported(tmp_path, 1.0 + np.arange(ROWS) / RATE_HZ, rate)
    assert samples.period_s == pytest.approx(1.0 / RATE_HZ, rel=1e-6)
    assert samples.lost == lost.sum()


def numbers_of(time_s: np.ndarray) -> np.ndarray:
    return number_sampled_rows(time_s, np.arange(time_s.size)).number


@pytest.mark.parametrize("jitter", [0.02, 0.1, 0.2])
def test_jitter_of_the_times_loses_no_samples(jitter: float) -> None:
    row = np.arange(ROWS)
    time_s = (row + jitter * np.random.default_rng(3).normal(size=ROWS)) / RATE_HZ
    assert np.array_equal(numbers_of(np.sort(time_s)), row)


def test_late_samples_are_not_lost_ones() -> None:
    row = np.arange(ROWS)
    late = 0.8 * (np.random.default_rng(4).random(ROWS) < 0.001)
    assert np.array_equal(numbers_of((row + late) / RATE_HZ), row)


@pytest.mark.parametrize("rate_hz", [300.0, 400.0, 800.0])
def test_times_with_three_decimals_lose_no_samples(rate_hz: float) -> None:
    row = np.arange(ROWS)
    assert np.array_equal(numbers_of(np.round(row / rate_hz, 3)), row)


def test_a_period_that_changes_slowly_loses_no_samples() -> None:
    row = np.arange(ROWS)
    for change in (0.001, 0.1, 0.6):
        period_s = (1.0 + change * row / ROWS) / RATE_HZ
        assert np.array_equal(numbers_of(np.cumsum(period_s)), row)


def test_rows_that_events_trigger_have_the_numbers_of_the_rows() -> None:
    rng = np.random.default_rng(5)
    for step_s in (rng.exponential(0.01, ROWS), rng.uniform(0.004, 0.016, ROWS)):
        assert np.array_equal(numbers_of(np.cumsum(step_s)), np.arange(ROWS))
    rounded_s = np.unique(np.round(np.cumsum(rng.exponential(0.01, ROWS)), 3))
    assert np.array_equal(numbers_of(rounded_s), np.arange(rounded_s.size))


def test_gaps_between_jittering_times_are_counted() -> None:
    rng = np.random.default_rng(6)
    row = np.arange(ROWS)
    number = row + 7 * (row >= 10_000) + 30 * (row >= 25_000)
    time_s = np.sort((number + 0.12 * rng.normal(size=ROWS)) / RATE_HZ)
    assert np.array_equal(numbers_of(time_s), number)


def test_few_rows_and_one_step_are_numbered() -> None:
    assert numbers_of(np.array([0.0, 0.01])).tolist() == [0, 1]
    assert np.array_equal(numbers_of(np.arange(100) * 0.01), np.arange(100))


def test_rows_without_a_constant_rate_get_a_remark(tmp_path: Path) -> None:
    time_s = 1.0 + np.cumsum(np.random.default_rng(5).exponential(0.01, 4000))
    source = archive(tmp_path / "in.npz", t=time_s, g=noise(4000))
    (note,) = import_measurements(source, mapped(BASE), tmp_path / "out.mcap").notes
    assert note.startswith("B1: the times of the rows show no constant sample rate")


def test_arrivals_with_many_gaps_are_numbered_in_linear_time() -> None:
    """Before, each gap took the time of all samples: 240,000 samples took 25 s."""
    rng = np.random.default_rng(7)
    arrival_s = np.sort(np.arange(400_000) / RATE_HZ + rng.exponential(0.002, 400_000))
    begin_s = time.process_time()
    count_rows(arrival_s)
    assert time.process_time() - begin_s < 15.0


@pytest.mark.parametrize("fine", [True, False])
def test_the_packet_counter_of_xsens_numbers_the_samples(tmp_path: Path, fine: bool) -> None:
    session = simulate_session(7, moves=2)
    source = write_xsens(tmp_path, session, fine=fine)
    head, *rows = source.read_text().split("\n")
    first = next(k for k, row in enumerate(rows) if row.startswith("PacketCounter")) + 1
    is_lost = np.random.default_rng(4).random(len(rows)) < 0.7
    is_lost[: first + 1] = False
    is_lost[-2:] = False
    remaining = [row for row, lost in zip(rows, is_lost, strict=True) if not lost]
    source.write_text("\n".join([head, *remaining]))
    path = import_files([source], tmp_path / "out.mcap").path
    samples = load_samples(read_recording(path), "037003F8")
    assert samples.lost == is_lost.sum()
    assert samples.period_s == pytest.approx(0.01, rel=1e-4)


def test_many_pauses_are_not_part_of_the_period(tmp_path: Path) -> None:
    """A logger that wakes up for a quarter of a second, 2000 times."""
    row = np.arange(100_000)
    samples = imported(tmp_path, 1.0 + (row + 1000 * (row // 50)) / RATE_HZ, noise(row.size))
    assert samples.period_s == pytest.approx(1.0 / RATE_HZ, rel=1e-6)
    assert samples.lost == 0
