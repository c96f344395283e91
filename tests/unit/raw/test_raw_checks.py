"""Faults put into clean counts by hand are found, counted and placed; clean ones are not."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import butter, lfilter
from scipy.stats import poisson

from gyrorig_solver.data.clocks import ClockMap, map_clock
from gyrorig_solver.data.count_columns import CountColumn
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.data.stream.count_stream import StreamFinding, poisson_tail
from gyrorig_solver.data.stream.exact_repeats import without_repeats
from gyrorig_solver.data.stream.stream_checks import check_stream
from gyrorig_solver.data.stream.stuck_axes import without_clipping

RATE_HZ, QUANTUM = 100.0, 1.5e-4
N = 12_000


def clock_of(number: np.ndarray) -> ClockMap:
    ticks = (number * 10_000).astype(np.int64)
    host_s = number / RATE_HZ + 1e-3
    return map_clock(ticks, host_s, 1e6, 64, number.astype(np.uint32))


@cache
def clean_counts(seed: int = 3, noise: float = 8.0) -> np.ndarray:
    """Trapezoids about all axes and white noise through a 25 Hz low-pass, in counts."""
    rng = np.random.default_rng(seed)
    moves = np.zeros((N, 3))
    for begin in range(300, N - 300, 400):
        axis = (begin // 400) % 3
        ramp = np.clip(np.minimum(np.arange(200) / 60.0, (199 - np.arange(200)) / 60.0), 0.0, 1.0)
        moves[begin : begin + 200, axis] = rng.choice([-1.0, 1.0]) * 7000.0 * ramp
    low = butter(2, 25.0, fs=RATE_HZ)
    rate = lfilter(*low, moves + 2.0 * noise * rng.normal(size=(N, 3)), axis=0)
    return np.rint(rate).astype(np.int16)


def samples_of(
    counts: np.ndarray, number: np.ndarray | None = None, accel: np.ndarray | None = None
) -> GyroSamples:
    number = np.arange(counts.shape[0]) if number is None else number
    clock = clock_of(number)
    return GyroSamples(
        board="B",
        metadata={},
        origin_ns=0,
        time_s=clock.time_s,
        host_s=number / RATE_HZ,
        number=number.astype(np.int64),
        segment=clock.segment,
        rate_rad_s=CountColumn(counts, QUANTUM),
        usable=np.ones(counts.shape[0], dtype=np.bool_),
        accel_m_s2=accel,
        temperature_degc=None,
        quantum_rad_s=QUANTUM,
        clock=clock,
        latency_bounds=None,
        lost=int(number[-1] + 1 - number.size),
        repeated=0,
        late=0,
    )


def findings_in(samples: GyroSamples) -> dict[str, StreamFinding]:
    return {
        finding.cause: finding for result in check_stream(samples) for finding in result.findings
    }


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("noise", [0.2, 1.0, 8.0])
def test_clean_counts_raise_no_alarm(seed: int, noise: float) -> None:
    assert findings_in(samples_of(clean_counts(seed, noise))) == {}


def test_repeats_are_counted_one_by_one() -> None:
    counts = clean_counts().copy()
    rows = np.arange(500, 11_500, 1000)
    counts[rows] = counts[rows - 1]
    (finding,) = findings_in(samples_of(counts)).values()
    assert (finding.cause, finding.count) == ("repeated_samples", rows.size)
    assert finding.times_s == pytest.approx(rows / RATE_HZ, abs=1e-3)


def test_repeats_are_detected_by_six_words_if_three_are_coarse() -> None:
    """At a noise of one count, 90 chance repeats hide 60 real ones; the accelerations do not."""
    rng = np.random.default_rng(8)
    counts = clean_counts(5, 1.0).copy()
    accel = np.rint(20.0 * rng.normal(size=counts.shape)) * 0.01
    rows = np.arange(100, 12_000, 200)
    counts[rows], accel[rows] = counts[rows - 1], accel[rows - 1]
    assert "repeated_samples" not in findings_in(samples_of(clean_counts(5, 1.0), accel=accel))
    finding = findings_in(samples_of(counts, accel=accel))["repeated_samples"]
    assert abs(finding.count - rows.size) <= 1


@pytest.mark.parametrize("bit", [10, 11, 12, 13, 14, 15])
def test_one_flipped_bit_is_enough(bit: int) -> None:
    counts = clean_counts().copy()
    word = int(counts[6100, 1]) & 0xFFFF
    counts[6100, 1] = ((word ^ (1 << bit)) ^ 0x8000) - 0x8000
    (finding,) = findings_in(samples_of(counts)).values()
    assert (finding.cause, finding.where, finding.count) == ("corrupt_samples", ("y",), 1)
    assert finding.times_s == pytest.approx((61.0,), abs=1e-3)


def test_torn_words_are_detected() -> None:
    """The high byte of the sample before, where a rest lies at a byte's edge."""
    counts = clean_counts().copy()
    counts[:, 2] = counts[:, 2] + 256
    old = np.vstack([counts[:1], counts[:-1]])
    torn = (counts & 0xFF) | (old & np.int16(-256))
    crossing = np.flatnonzero((torn[:, 2] != counts[:, 2]) & (counts[:, 2] < 400))
    rows = crossing[:: max(1, crossing.size // 40)]
    counts[rows, 2] = torn[rows, 2]
    finding = findings_in(samples_of(counts))["corrupt_samples"]
    assert finding.where == ("z",)
    assert 3 <= finding.count <= rows.size


def test_a_tap_is_not_a_damaged_word() -> None:
    """A blow through the low-pass touches several samples, and all axes."""
    counts = clean_counts().astype(np.float64)
    low = butter(2, 25.0, fs=RATE_HZ)
    blow = np.zeros((N, 3))
    blow[1000:12_000:1500] = 9000.0
    counts = np.rint(counts + lfilter(*low, blow, axis=0)).astype(np.int16)
    assert findings_in(samples_of(counts)) == {}


def test_a_stuck_axis_and_clipping_are_distinguished() -> None:
    stuck = clean_counts().copy()
    stuck[4000:9000, 0] = stuck[4000, 0]
    findings = findings_in(samples_of(stuck))
    assert findings["stuck_axis"].where == ("x",)
    assert findings["stuck_axis"].count == pytest.approx(5000, abs=5)
    assert "saturation" not in findings
    cut = np.clip(clean_counts(), -5000, 5000)
    findings = findings_in(samples_of(cut))
    assert set(findings) == {"saturation"}
    assert findings["saturation"].size == pytest.approx(5000 * QUANTUM)


def test_an_axis_without_any_change_is_stuck() -> None:
    counts = clean_counts().copy()
    counts[:, 1] = 17
    (finding,) = findings_in(samples_of(counts)).values()
    assert (finding.cause, finding.where, finding.share) == ("stuck_axis", ("y",), 1.0)


@pytest.mark.parametrize("dead", [1, 2])
def test_an_axis_sticks_beside_a_dead_one(dead: int) -> None:
    counts = clean_counts().copy()
    counts[4000:9000, 0] = counts[4000, 0]
    counts[:, dead] = 17
    findings = [f for result in check_stream(samples_of(counts)) for f in result.findings]
    stuck = {finding.where for finding in findings if finding.cause == "stuck_axis"}
    assert stuck == {("x",), ("xyz"[dead],)}


def test_missing_numbers_are_counted() -> None:
    keep = np.setdiff1d(np.arange(N), np.r_[3000:3004, 7000:7003])
    findings = findings_in(samples_of(clean_counts()[keep], keep))
    assert findings["lost_samples"].count == 7
    assert "in 2 gaps" in findings["lost_samples"].seen_as


def test_the_saturation_status_of_the_board_is_counted() -> None:
    samples = samples_of(clean_counts())
    good = samples.usable.copy()
    good[200:220] = False
    assert findings_in(replace(samples, usable=good))["saturation"].count == 20


def test_physical_values_are_not_checked_for_damaged_words() -> None:
    counts = clean_counts().astype(np.int32) * 10_000
    counts[5000, 0] += 1 << 24
    assert "corrupt_samples" not in findings_in(samples_of(counts))


@pytest.mark.parametrize(("count", "expected"), [(0, 3.0), (1, 0.02), (5, 0.5), (200, 150.0)])
def test_the_tail_is_that_of_poisson(count: int, expected: float) -> None:
    assert poisson_tail(count, expected) == pytest.approx(poisson.sf(count - 1, expected), rel=1e-6)
    assert math.isclose(poisson_tail(3, 0.0), 0.0)


def test_only_significant_repeats_are_excluded() -> None:
    counts = clean_counts().copy()
    rows = np.arange(500, 11_500, 1000)
    counts[rows] = counts[rows - 1]
    unrepeated = without_repeats(samples_of(counts))
    assert np.array_equal(np.flatnonzero(~unrepeated.usable), rows)
    assert unrepeated.repeated == rows.size
    assert unrepeated.counts.dtype == np.int16
    coarse = samples_of(clean_counts(5, 0.3))
    assert without_repeats(coarse) is coarse


def test_clipped_samples_and_their_neighbours_are_excluded() -> None:
    clean = clean_counts()
    clipped = np.clip(clean, -5000, 5000)
    usable = without_clipping(samples_of(clipped)).usable
    assert not usable[(np.abs(clipped) == 5000).any(axis=1)].any()
    # The noise decides which samples near the limit are clipped: none of them is left.
    distance = np.abs(np.abs(clean) - 5000).min(axis=1)
    on_plateau = np.abs(np.diff(clean, axis=0, append=clean[-1:])).max(axis=1) < 40
    assert not usable[(distance < 20) & on_plateau].any()
    assert usable.mean() > 0.4
    unclipped = samples_of(clean)
    assert without_clipping(unclipped) is unclipped
