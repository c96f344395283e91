"""Measure the accuracy of the offline clock maps on simulated clocks with known true times.

Each line of the table is one accuracy limit of docs/clocks.md. "Wander" is the rms of the time
error (estimated minus true time) without its mean; one-way timestamps do not determine the mean.
e* = (mu/f)^0.6 q^0.4 is the error of an ideal envelope. All data are simulated from seeds.

Run: python tests/bench/bench_clocks.py [--quick]
"""

import argparse
import resource
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from numpy.typing import NDArray
from tests.support import simulated_clocks as sim
from tests.support.simulated_clocks import latency_bounds_of_samples

from gyrorig_solver.data.clocks import map_clock, unwrap_ticks
from gyrorig_solver.data.clocks.clock_smoother import smooth_clock
from gyrorig_solver.data.clocks.latency_bounds import PingExchanges
from gyrorig_solver.data.clocks.latency_floor import find_latency_floor, wander_bound_s
from gyrorig_solver.data.clocks.lower_envelope import hull_line

FloatArray = NDArray[np.float64]
US_PER_S = 1e6
Row = tuple[str, str, str, bool]


def compute_wander_us(estimated_s: FloatArray, true_s: FloatArray) -> tuple[float, float]:
    """Return the rms and the largest time error without its mean, us."""
    error_us = (estimated_s - true_s) * US_PER_S
    error_us -= error_us.mean()
    return float(np.sqrt(np.mean(error_us**2))), float(np.abs(error_us).max())


def measure_grid(quick: bool) -> Iterator[Row]:
    """Measure 18 combinations of jitter, rate and wander over half an hour, in units of e*."""
    envelopes, smoothers = [], []
    seconds = 600.0 if quick else 1800.0
    for mean_s in (1e-4, 3e-4, 1e-3):
        for rate_hz in (100.0, 400.0):
            for walk in (1e-9, 1e-8, 1e-7):
                rng = np.random.default_rng(
                    [round(mean_s * US_PER_S), int(rate_hz), round(walk * 1e9)]
                )
                true_s = np.arange(int(seconds * rate_hz)) / rate_hz
                x = sim.device_clock(true_s, rng, 50e-6, walk)
                y = sim.uart_arrivals(true_s, rng, mean_s) - x
                best_us = wander_bound_s(mean_s, 1.0 / rate_hz, walk) * US_PER_S
                floor = find_latency_floor(x, y)
                if floor.method != "envelope" or floor.structure_reason:
                    raise SystemExit(f"{mean_s} {rate_hz} {walk}: {floor.method}")
                smoothed = smooth_clock(x, y, hull_line(x, y), mean_s)
                envelopes.append(
                    compute_wander_us(x + floor.envelope.delay_at(x), true_s)[0] / best_us
                )
                if smoothed is not None:
                    smoothers.append(
                        compute_wander_us(x + smoothed.floor.delay_at(x), true_s)[0] / best_us
                    )
    for name, ratios, goal in (("envelope", envelopes, 0.8), ("smoother", smoothers, 2.0)):
        yield (
            f"exp. jitter, wander, {seconds / 60:.0f} min, grid of 18: {name}",
            f"<= {goal} e*",
            f"{min(ratios):.2f} to {max(ratios):.2f} e*",
            max(ratios) <= goal,
        )


def measure_line(quick: bool) -> Iterator[Row]:
    """Measure the error of the lower envelope line of 30000 points."""
    errors = []
    for seed in range(20 if quick else 200):
        rng = np.random.default_rng(seed)
        x = np.arange(30_000) / 400.0
        y = 20e-6 * x + rng.exponential(3e-4, x.size)
        errors.append(compute_wander_us(hull_line(x, y).delay_at(x), 20e-6 * x)[0])
    unit_us = 3e-4 / 30_000 * US_PER_S
    rms = float(np.sqrt(np.mean(np.square(errors)))) / unit_us
    yield "75 s line, n = 30000", "<= 3 mu/n", f"{rms:.2f} mu/n rms of {len(errors)}", rms <= 3.0


def measure_usb_frames(quick: bool) -> Iterator[Row]:
    """Measure 20 Hz clock frames that have a random phase relative to 1 ms USB frames."""
    for seconds in (75.0, 600.0):
        results = []
        for skew in (0.5e-6, 5e-6, 50e-6):
            for seed in range(3 if quick else 10):
                rng = np.random.default_rng([seed, int(seconds), round(skew * 1e7)])
                true_s = sim.random_instants(seconds, 20.0, rng)
                ticks = sim.raw_ticks(sim.device_clock(true_s, rng, skew, 1e-8))
                clock = map_clock(ticks, sim.usb_arrivals(true_s, rng), sim.TICK_HZ, 32)
                results.append(compute_wander_us(clock.time_s, true_s)[0])
        rms = float(np.sqrt(np.mean(np.square(results))))
        yield (
            f"USB 1 ms, random clock frames, 0.5 to 50 ppm, {seconds:.0f} s",
            "<= 10 us",
            f"{rms:.1f} us rms of {len(results)} runs, the worst {max(results):.1f}",
            rms <= 10.0,
        )


def measure_long_sessions(quick: bool) -> Iterator[Row]:
    """Measure sessions of eight hours with a warm-up drift of 5 ppm."""
    hours = 1.0 if quick else 8.0
    for name, rate_hz, goal_us in (
        ("UART 100 Hz", 100.0, 0.5), ("UART 800 Hz", 800.0, 0.5),
        ("USB 100 Hz", 100.0, 10.0), ("USB clock frames", 20.0, 10.0),
    ):  # fmt: skip
        rng = np.random.default_rng(3)
        n = int(hours * 3600.0 * rate_hz)
        true_s = np.arange(n) / rate_hz
        if name == "USB clock frames":
            true_s = sim.random_instants(hours * 3600.0, rate_hz, rng)
        elif name.startswith("USB"):
            # The oscillator of the sensor is a few percent off, and it wanders.
            walk = np.cumsum(rng.normal(size=n)) / np.sqrt(rate_hz)
            true_s = np.cumsum(rng.uniform(0.97, 1.03) / rate_hz * (1.0 + 1e-6 * walk))
        device_s = sim.device_clock(true_s, rng, 50e-6, 1e-8, 5e-6)
        ticks = sim.raw_ticks(device_s, sim.WRAP - 10_000_000)
        del device_s
        host_s = (
            sim.uart_arrivals(true_s, rng, 3e-4)
            if name.startswith("UART")
            else sim.usb_arrivals(true_s, rng)
        )
        sequence = np.arange(n) % 65_536
        before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        start_s = time.process_time()
        clock = map_clock(ticks, host_s, sim.TICK_HZ, 32, sequence)
        took_s = time.process_time() - start_s
        added_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3 - before_mb
        rms, largest = compute_wander_us(clock.time_s, true_s)
        yield (
            f"{hours:.0f} h, warm-up 5 ppm, q 1e-8: {name}",
            f"<= {goal_us} us, max <= 50",
            f"{rms:.2f} us, max {largest:.0f} ({clock.method}, {took_s:.1f} s, {added_mb:+.0f} MB)",
            rms <= goal_us and largest <= 50.0 and not clock.faults,
        )


def measure_faults(quick: bool) -> Iterator[Row]:
    """Count the wrong and false detections of faults in streams of one minute."""
    trials = 60 if quick else 300
    wrong = false = 0
    for fault in sim.FAULTS:
        for seed in range(trials):
            trial = sim.fault_trial(fault, seed)
            clock = unwrap_ticks(trial.ticks, trial.host_s, sim.TICK_HZ, 32, trial.sequence)
            detected = tuple(fault.index for fault in clock.faults)
            is_wrong = sim.is_misclassified(
                trial, detected, clock.steps, np.flatnonzero(clock.late_mask)
            )
            is_wrong |= clock.wraps != trial.wraps
            wrong += is_wrong and bool(trial.segment_starts)
            false += is_wrong and not trial.segment_starts
    yield (
        f"faults: {', '.join(sim.FAULTS[1:])}; {len(sim.FAULTS)} x {trials}",
        "0 wrong, 0 false",
        f"{wrong} wrong, {false} false",
        wrong == false == 0,
    )


def measure_two_way(quick: bool) -> Iterator[Row]:
    """Count the samples whose true latency is outside the certified interval."""
    for link in ("uart", "usb", "ftdi"):
        missed = samples = 0
        widths, errors, wanders = [], [], []
        for seconds in (75.0, 600.0):
            for seed in range(5 if quick else 40):
                trial = sim.ping_trial(link, seed, seconds)
                clock = map_clock(trial.ticks, trial.host_s, sim.TICK_HZ, 32)
                pings = PingExchanges(
                    trial.send_s, trial.receive_s, trial.device_receive, trial.device_send
                )
                floor = latency_bounds_of_samples(
                    pings, trial.ticks, trial.host_s, clock, sim.TICK_HZ, 32
                )
                if floor is None:
                    raise SystemExit(f"{link} {seconds} {seed}: no interval")
                low, high = floor.bounds_at(clock.time_s)
                latency = clock.time_s - trial.true_s
                # The timestamps of the stream and of the pings are rounded down to a tick of 1 us.
                missed += int(np.sum((latency < low - 2e-6) | (latency > high + 2e-6)))
                samples += latency.size
                widths.append(float(np.mean(high - low)) * 1e3)
                middle_s = clock.time_s - floor.midpoint_at(clock.time_s)
                errors.append(float(np.mean(middle_s - trial.true_s)) * US_PER_S)
                wanders.append(compute_wander_us(middle_s, trial.true_s)[0])
        yield (
            f"two-way interval, {link}, 375 pings and more",
            "holds the truth",
            f"{missed} of {samples} outside; {np.mean(widths):.2f} ms wide, midpoint "
            f"{np.sqrt(np.mean(np.square(errors))):.1f} us off, wander {np.mean(wanders):.1f} us",
            missed == 0,
        )


def main() -> int:
    """Print the table; return 1 if a row misses its goal."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--quick", action="store_true", help="fewer seeds, shorter sessions")
    quick = parser.parse_args().quick
    parts: tuple[Callable[[bool], Iterator[Row]], ...] = (
        measure_grid, measure_line, measure_usb_frames, measure_long_sessions, measure_faults,
        measure_two_way,
    )  # fmt: skip
    missed = 0
    print("| item | goal | measured | |\n|---|---|---|---|")  # noqa: T201
    for part in parts:
        for item, goal, measured, reached in part(quick):
            verdict = "yes" if reached else "NO"
            print(f"| {item} | {goal} | {measured} | {verdict} |", flush=True)  # noqa: T201
            missed += not reached
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
