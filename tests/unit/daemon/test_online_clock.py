"""The online clock map, tested against device clocks whose truth is known."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrorig_daemon.clocks import CounterUnwrapper, OnlineClock

ODR_HZ = 104.3  # not the nominal 100: a rate must never serve as a clock


def arrivals(
    seed: int, seconds: float, skew: float, mean_latency_s: float, start_ticks: int = 0
) -> Iterator[tuple[float, int, int]]:
    """Yield (true time in s, ticks as sent, arrival in ns): exponential latency and stalls."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(1.0, seconds, 1.0 / ODR_HZ)
    arrival_s = time_s + 50e-6 + rng.exponential(mean_latency_s, time_s.size)
    for begin_s in rng.uniform(0.0, seconds, int(seconds / 20)):  # one stall in 20 s
        end_s = begin_s + rng.uniform(0.005, 0.2)
        stalled = (arrival_s > begin_s) & (arrival_s < end_s)
        arrival_s[stalled] = end_s
    arrival_s = np.maximum.accumulate(arrival_s)
    ticks = np.round((time_s * (1.0 + skew)) * 1e6).astype(np.int64) + start_ticks
    yield from zip(
        time_s.tolist(),
        (int(t) % 2**32 for t in ticks),
        (round(a * 1e9) for a in arrival_s.tolist()),
        strict=True,
    )


@pytest.mark.parametrize("skew", [-640e-6, 5e-6, 50e-6])
@pytest.mark.parametrize("start_ticks", [0, 2**32 - 20_000_000])
def test_map_is_good_to_microseconds(skew: float, start_ticks: int) -> None:
    clock = OnlineClock(1e6, 32)
    errors = []
    for sequence, (true_s, ticks, arrival_ns) in enumerate(
        arrivals(3, 75.0, skew, 300e-6, start_ticks)
    ):
        mapped_ns = clock.observe(ticks, arrival_ns, 0, sequence & 0xFFFF)
        if true_s > 10.0:
            errors.append(mapped_ns * 1e-9 - true_s - 50e-6)
    assert float(np.sqrt(np.mean(np.square(errors)))) < 10e-6
    assert clock.report().restarts == 0
    # the host's rate against the device's
    assert clock.report().skew_ppm == pytest.approx(-skew * 1e6, abs=2.0)


def test_arrival_times_are_used_before_the_first_window() -> None:
    clock = OnlineClock(1e6, 32)
    assert clock.observe(1_000, 5_000_000, 0, 0) == 5_000_000
    assert not clock.report().mapped
    assert math.isinf(clock.report().sigma_s)


def test_a_sample_is_never_later_than_its_arrival() -> None:
    clock = OnlineClock(1e6, 32)
    for sequence, (_, ticks, arrival_ns) in enumerate(arrivals(7, 20.0, 5e-6, 300e-6)):
        assert clock.observe(ticks, arrival_ns, 0, sequence & 0xFFFF) <= arrival_ns


def test_late_windows_do_not_move_the_map() -> None:
    clock = OnlineClock(1e6, 32)
    stream = list(arrivals(5, 60.0, 5e-6, 100e-6))
    before = 0.0
    for sequence, (true_s, ticks, arrival_ns) in enumerate(stream):
        late_ns = 20_000_000 if 30.0 < true_s < 35.0 else 0  # the path is longer for 5 s
        mapped_ns = clock.observe(ticks, arrival_ns + late_ns, 0, sequence & 0xFFFF)
        if true_s < 30.0:
            before = mapped_ns * 1e-9 - true_s
    after = mapped_ns * 1e-9 - stream[-1][0]
    assert clock.report().late_windows >= 4
    assert abs(after - before) < 20e-6


def test_a_decreasing_minimum_latency_is_an_alarm() -> None:
    clock = OnlineClock(1e6, 32)
    for sequence, (true_s, ticks, arrival_ns) in enumerate(arrivals(5, 60.0, 5e-6, 100e-6)):
        step_ns = 30_000_000 if true_s < 30.0 else 0
        clock.observe(ticks, arrival_ns + step_ns, 0, sequence & 0xFFFF)
    assert clock.report().early_windows >= 1
    assert clock.report().steps == 1


@pytest.mark.parametrize("boot_ticks", [0, 40_000_000, 3_000_000_000])
def test_a_restart_starts_a_new_count(boot_ticks: int) -> None:
    clock = OnlineClock(1e6, 32)
    for sequence, (_, ticks, arrival_ns) in enumerate(arrivals(5, 30.0, 5e-6, 100e-6, boot_ticks)):
        clock.observe(ticks, arrival_ns, 0, sequence & 0xFFFF)
    for sequence, (_, ticks, arrival_ns) in enumerate(arrivals(6, 5.0, 5e-6, 100e-6)):
        mapped_ns = clock.observe(ticks - 900_000, arrival_ns + 31_000_000_000, 0, sequence)
    assert clock.report().restarts == 1
    assert abs(mapped_ns - arrival_ns - 31_000_000_000) < 5_000_000


def test_a_gap_of_hours_is_not_a_restart() -> None:
    unwrap = CounterUnwrapper(1e6, 32)
    hours_s = 3 * 3600.0
    for at in range(500):
        unwrap.feed(at * 10_000, at * 10_000_000, at & 0xFFFF)
    ticks = round((4.99 + hours_s) * 1e6)
    after = unwrap.feed(ticks % 2**32, round((4.99 + hours_s) * 1e9), 77)
    assert not after.restarted
    assert after.ticks == ticks


def test_swapped_frames_are_not_a_restart() -> None:
    unwrap = CounterUnwrapper(1e6, 32)
    for at in (*range(100), 101, 100, 102):
        assert unwrap.feed(at * 10_000, at * 10_000_000, at).restarted == (at == 0)


@settings(max_examples=200, deadline=None)
@given(
    stamps=st.lists(st.tuples(st.integers(0, 2**64 - 1), st.integers(0, 2**40)), max_size=50),
    sequences=st.lists(st.integers(0, 2**16 - 1), max_size=50),
)
def test_arbitrary_timestamps_raise_no_error(
    stamps: list[tuple[int, int]], sequences: list[int]
) -> None:
    clock = OnlineClock(1e6, 32)
    arrival_ns = 0
    for (ticks, wait_ns), sequence in zip(stamps, sequences, strict=False):
        arrival_ns += wait_ns
        assert clock.observe(ticks, arrival_ns, 0, sequence) <= arrival_ns
    clock.report()


def test_a_stopped_clock_uses_no_memory() -> None:
    clock = OnlineClock(1e6, 32)
    for at in range(10_000):
        assert clock.observe(77, at * 10_000_000, 0, 0) <= at * 10_000_000
    assert len(clock._floor._first_samples) <= 4096


def test_pings_bracket_the_truth() -> None:
    clock = OnlineClock(1e6, 32)
    rng = np.random.default_rng(1)
    for sequence, (true_s, ticks, arrival_ns) in enumerate(arrivals(9, 30.0, 5e-6, 100e-6)):
        clock.observe(ticks, arrival_ns, 0, sequence & 0xFFFF)
        if sequence % 20 == 0:
            sent_ns = round((true_s - 80e-6 - rng.exponential(1e-4)) * 1e9)
            received_ns = round((true_s + 50e-6 + rng.exponential(1e-4)) * 1e9)
            clock.observe_two_way(sent_ns, ticks, ticks, received_ns)
    report = clock.report()
    assert report.two_way_low_s is not None
    assert report.two_way_high_s is not None
    # the map lies one latency floor (50 us) behind the truth
    assert report.two_way_low_s <= -50e-6 + 20e-6
    assert report.two_way_high_s >= -50e-6 - 20e-6


def test_a_send_timestamp_bounds_the_clock_from_above() -> None:
    """The device reads 1 s; frames take 3 ms, pings 2 ms each way, the stamp of a sending 1 ms."""
    tick_hz, begin_ns = 1e6, 10_000_000_000
    reports = []
    for with_sendings in (False, True):
        clock = OnlineClock(tick_hz, 32)
        for number in range(400):
            ticks, now_ns = 10_000 * number, begin_ns + 10_000_000 * number
            clock.observe(ticks, now_ns + 3_000_000, 0, number)
            if number % 20 == 10:
                clock.observe_two_way(now_ns - 2_000_000, ticks, ticks, now_ns + 2_000_000)
                if with_sendings:
                    clock.observe_one_way(ticks + 5_000, now_ns + 5_000_000 + 1_000_000)
        reports.append(clock.report())
    highs = [report.two_way_high_s for report in reports]
    lows = [report.two_way_low_s for report in reports]
    assert highs == [pytest.approx(-1e-3, abs=2e-5), pytest.approx(-2e-3, abs=2e-5)]
    assert lows == [pytest.approx(-5e-3, abs=2e-5)] * 2
