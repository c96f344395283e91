"""Simulated device clocks and links with known true times, for tests and benchmarks.

What to use when: `device_clock` and one of the links to measure the error of a clock map;
`fault_trial` to test the classification of clock faults. The clock and link models are those
of docs/clocks.md. All draws come from the given generator or seed.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_faults import CounterArray
from gyrorig_solver.data.clocks.clock_map import ClockMap
from gyrorig_solver.data.clocks.latency_bounds import (
    LatencyBounds,
    NearestSamples,
    PingExchanges,
    estimate_latency_bounds,
)
from gyrorig_solver.data.clocks.tick_unwrapping import counter_modulus, samples_since

TICK_HZ = 1e6
WRAP = 2**32
USB_FRAME_S = 1e-3


def device_clock(
    true_s: FloatArray,
    rng: np.random.Generator,
    skew: float,
    walk: float,
    warm_up: float = 0.0,
    warm_up_s: float = 600.0,
) -> FloatArray:
    """Return what a device's clock shows at true times, s.

    Args:
        true_s: not decreasing, shape (n,).
        rng: draws the frequency's random walk.
        skew: of its frequency at the end of warming up.
        walk: of its frequency, per sqrt(s): 1e-8 is a crystal on a desk.
        warm_up: of its frequency, decaying.
        warm_up_s: time constant of that.
    """
    step_s = np.diff(true_s, prepend=true_s[0])
    frequency = skew + np.cumsum(rng.normal(size=true_s.size) * np.sqrt(step_s)) * walk
    clock_s = true_s + np.cumsum(frequency * step_s)
    if warm_up:
        clock_s += warm_up * warm_up_s * -np.expm1(-(true_s - true_s[0]) / warm_up_s)
    return clock_s


def add_stalls(host_s: FloatArray, rng: np.random.Generator, longest_s: float = 0.2) -> FloatArray:
    """Return arrivals at a host that stops every 20 s for 5 ms to `longest_s`."""
    out = host_s.copy()
    begins = np.cumsum(rng.exponential(20.0, int((host_s[-1] - host_s[0]) / 10.0) + 5)) + host_s[0]
    lengths = rng.uniform(0.005, longest_s, begins.size)
    order = np.maximum.accumulate(out)
    for begin, length in zip(begins, lengths, strict=True):
        a, b = np.searchsorted(order, [begin, begin + length])
        out[a:b] = np.maximum(out[a:b], begin + length)
    return np.maximum.accumulate(out)


def uart_arrivals(true_s: FloatArray, rng: np.random.Generator, mean_s: float) -> FloatArray:
    """Return arrivals late by an exponential jitter, with stalls."""
    return add_stalls(true_s + rng.exponential(mean_s, true_s.size), rng)


def usb_arrivals(true_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return arrivals by USB: the next 1 ms frame, then the host's wake-up, with stalls."""
    frame_s = (np.floor(true_s / USB_FRAME_S) + 1.0) * USB_FRAME_S
    return add_stalls(frame_s + rng.exponential(50e-6, true_s.size), rng)


def random_instants(seconds: float, rate_hz: float, rng: np.random.Generator) -> FloatArray:
    """Return instants near a grid, each anywhere in its cell: no transport beats with them."""
    count = int(seconds * rate_hz)
    return np.asarray((np.arange(count) + rng.uniform(0.0, 1.0, count)) / rate_hz, np.float64)


def raw_ticks(device_s: FloatArray, first: int = 0) -> IntArray:
    """Return a 32-bit microsecond counter's readings."""
    return np.asarray((np.floor(device_s * TICK_HZ).astype(np.int64) + first) % WRAP, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class PingTrial:
    """A stream and two-way exchanges over one link, and the stream's true times."""

    true_s: FloatArray
    ticks: IntArray
    host_s: FloatArray
    send_s: FloatArray
    receive_s: FloatArray
    device_receive: IntArray
    device_send: IntArray


def ping_trial(
    link: str, seed: int, seconds: float = 75.0, skew: float = 50e-6, rate_hz: float = 100.0
) -> PingTrial:
    """Return a timer-driven stream with pings at random moments, five a second.

    Args:
        link: `uart`, `usb` (1 ms frames both ways) or `ftdi` (16 ms latency timer).
        seed: everything follows from it.
        seconds: its length.
        skew: of the device's clock, which also times the stream.
        rate_hz: of the stream.
    """
    rng = np.random.default_rng([seed, len(link)])
    phase_s = rng.uniform(0.0, 0.016)

    def framed(at_s: FloatArray, frame_s: float, phase_s: float = 0.0) -> FloatArray:
        due_s = (np.floor((at_s + phase_s) / frame_s) + 1.0) * frame_s - phase_s
        # The wire, the interrupt and the copy take some time even at best.
        return np.asarray(due_s + 50e-6 + rng.exponential(50e-6, at_s.size), np.float64)

    def travel(at_s: FloatArray, down: bool) -> FloatArray:
        if link == "uart":
            return np.asarray(at_s + 5e-4 + rng.exponential(3e-4, at_s.size), np.float64)
        if link == "ftdi" and down:
            return framed(at_s, 0.016, phase_s)
        return framed(at_s, USB_FRAME_S)

    true_s = np.arange(int(seconds * rate_hz)) / rate_hz / (1.0 + skew)
    send_s = random_instants(seconds, 5.0, rng)
    device_receive_s = travel(send_s, down=False)
    device_send_s = device_receive_s + 50e-6 + rng.exponential(1e-3, send_s.size)
    receive_s = travel(device_send_s, down=True)
    delayed = rng.uniform(size=send_s.size) < 0.01
    receive_s[delayed] += rng.uniform(0.005, 0.2, int(delayed.sum()))
    all_times_s = np.concatenate([true_s, device_receive_s, device_send_s])
    order = np.argsort(all_times_s)
    clock_s = np.empty(all_times_s.size)
    clock_s[order] = device_clock(all_times_s[order], rng, skew, 1e-8)
    stamps = np.floor(clock_s * TICK_HZ).astype(np.int64)
    n, p = true_s.size, send_s.size
    return PingTrial(
        true_s, stamps[:n] % WRAP, add_stalls(travel(true_s, down=True), rng),
        send_s, receive_s, stamps[n : n + p], stamps[n + p :],
    )  # fmt: skip


FAULTS = (
    "none",
    "wrap",
    "swapped",
    "repeated",
    "lost",
    "gap",
    "stall",
    "reset",
    "early reset",
    "clock step",
)


@dataclass(frozen=True, slots=True, eq=False)
class FaultTrial:
    """One stream with one fault, and what a perfect judge would say."""

    ticks: IntArray
    host_s: FloatArray
    sequence: IntArray
    segment_starts: tuple[int, ...]  # first samples of new segments after the first one
    is_step: bool
    late: tuple[int, ...]
    wraps: int


def fault_trial(fault: str, seed: int, seconds: float = 60.0, rate_hz: float = 100.0) -> FaultTrial:
    """Return a stream of `seconds` with one of `FAULTS`, drawn at random."""
    rng = np.random.default_rng([seed, FAULTS.index(fault)])
    n = int(seconds * rate_hz)
    at = int(rng.integers(n // 4, 3 * n // 4))
    rate = rate_hz * (1.0 + rng.uniform(-0.04, 0.04))
    # The sensor's own oscillator is not the board's: its period drifts.
    true_s = np.cumsum(np.full(n, 1.0 / rate) * (1.0 + 1e-5 * np.cumsum(rng.normal(size=n)) / 30.0))
    counted = np.arange(n)
    uptime_s = float(rng.choice([rng.uniform(1.0, 60.0), rng.uniform(60.0, 4000.0)]))
    if fault == "wrap":
        uptime_s = WRAP / TICK_HZ - true_s[at]
    elif fault == "early reset":
        at = int(rng.integers(10, int(3.5 * rate)))
        uptime_s = rng.uniform(0.0, 0.4)
    elif fault == "gap":
        gap_s = float(np.exp(rng.uniform(0.0, np.log(10_800.0))))
        true_s[at:] += gap_s
        counted[at:] += round(gap_s * rate)
    skew = rng.uniform(-100e-6, 100e-6)
    device_s = uptime_s + device_clock(true_s, rng, skew, 1e-8)
    sequence = counted + round(uptime_s * rate)
    begins: tuple[int, ...] = ()
    if fault in {"reset", "early reset"}:
        off_s = rng.uniform(0.05, 3.0)
        true_s[at:] += off_s
        device_s[at:] += rng.uniform(0.0, 0.5) - device_s[at]
        sequence[at:] -= sequence[at]
        begins = (at,)
    elif fault == "clock step":
        size_s = float(np.exp(rng.uniform(np.log(5e-3), np.log(100.0))))
        device_s[at:] += size_s * (1.0 if device_s[at] < size_s else rng.choice([-1.0, 1.0]))
        begins = (at,)
    host_s = uart_arrivals(true_s, rng, 0.3e-3)
    if fault == "stall":
        begin_s, length_s = true_s[at], rng.uniform(0.2, 8.0)
        host_s[(host_s > begin_s) & (host_s < begin_s + length_s)] = begin_s + length_s
    total = np.floor(device_s * TICK_HZ).astype(np.int64)
    order, late = _order(fault, at, n, rng)
    wraps = 0 if begins and fault != "clock step" else int(total[-1] // WRAP - total[0] // WRAP)
    return FaultTrial(
        total[order] % WRAP, host_s if order.size == n else np.sort(host_s[order]),
        sequence[order] % 65_536, begins, fault == "clock step", late, wraps,
    )  # fmt: skip


def _order(
    fault: str, at: int, n: int, rng: np.random.Generator
) -> tuple[IntArray, tuple[int, ...]]:
    """Return which sample arrives when, and which of the arrivals are late ones."""
    order = np.arange(n)
    if fault == "swapped":
        order[[at, at + 1]] = at + 1, at
        return order, (at + 1,)
    if fault == "repeated":
        return np.insert(order, at, at - 1), ()
    if fault == "lost":
        return np.delete(order, np.arange(at, at + int(rng.integers(1, 40)))), ()
    return order, ()


def is_misclassified(
    trial: FaultTrial, segment_starts: tuple[int, ...], steps: int, late: IntArray
) -> bool:
    """Return whether a judgement of a trial is not the perfect one."""
    is_correct = segment_starts == trial.segment_starts and steps == int(trial.is_step)
    return not (is_correct and tuple(late.tolist()) == trial.late)


def latency_bounds_of_samples(
    pings: PingExchanges,
    ticks: IntArray,
    host_s: FloatArray,
    clock: ClockMap,
    tick_hz: float,
    counter_bits: int,
) -> LatencyBounds | None:
    """Return the bounds of the least latency from all samples of a stream.

    Args:
        pings: the exchanges.
        ticks: of the samples, as sent, shape (n,).
        host_s: arrivals of the samples, shape (n,), not decreasing.
        clock: the one-way times of the samples.
        tick_hz: of the board's clock.
        counter_bits: width of the tick counter.
    """
    nearest_samples = NearestSamples.of(pings, ticks, host_s)
    return estimate_latency_bounds(pings, nearest_samples, clock, tick_hz, counter_bits)


def unwrap_counter(sequence: CounterArray, expected: FloatArray) -> IntArray:
    """Return a sample counter without wraps, shape (n,).

    Args:
        sequence: as sent, shape (n,).
        expected: samples since the first one by the clock, shape (n,).
    """
    if sequence.size == 0:
        return sequence.astype(np.int64)
    return samples_since(int(sequence[0]), sequence, expected, counter_modulus(sequence))
