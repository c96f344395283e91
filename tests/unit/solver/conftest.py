"""A small rig of the tests' own: closed forms and noise made in the frequency domain.

It shares no code with the solver: trapezoids are integrated numerically on a fine grid,
the low-pass is an analogue second-order Butterworth applied by FFT, and coloured noise
is white noise shaped by FFT.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

RAD_PER_STEP = np.radians(185.142857 / 3600.0)
FINE_HZ = 4000.0


@dataclass(frozen=True)
class TestRig:
    """One simulated recording in plain arrays."""

    __test__ = False
    exchanges: list[tuple[float, float, str]]  # request, reply, command
    poll_lo_s: np.ndarray
    poll_hi_s: np.ndarray
    poll_steps: np.ndarray
    time_s: np.ndarray
    rate_rad_s: np.ndarray
    gain: np.ndarray
    bias_rad_s: np.ndarray
    lag_s: float  # before the low-pass
    start_s: list[float]


def _axis_speed(t: np.ndarray, start: float, distance: float, v: float, a: float) -> np.ndarray:
    """Speed of a trapezoid from rest, by its definition: min of up, flat and down."""
    peak = min(v, np.sqrt(a * distance))
    length = distance / peak + peak / a
    since = t - start
    speed = np.minimum(np.minimum(a * since, peak), a * (length - since))
    return np.where((since > 0) & (since < length), np.maximum(speed, 0.0), 0.0)


def _coloured(
    rng: np.random.Generator,
    n: int,
    hz: float,
    arw: float,
    flicker: float,
    walk: float,
    bandwidth: float,
) -> np.ndarray:
    """Noise of a given one-sided density, a little longer than asked and cut."""
    m = 2 * n
    f = np.fft.rfftfreq(m, 1.0 / hz)
    f[0] = f[1]
    folded = sum(1.0 / (1.0 + (np.abs(f + k * hz) / bandwidth) ** 4) for k in range(-4, 5))
    density = arw**2 * folded + flicker**2 / (np.pi * f) + 2 * walk**2 / (2 * np.pi * f) ** 2
    white = np.fft.rfft(rng.normal(size=(m, 3)), axis=0)
    noise = np.fft.irfft(white * np.sqrt(density * hz / 2.0)[:, None], m, axis=0)[:n]
    return noise


@pytest.fixture(scope="session")
def simulate() -> Callable[..., TestRig]:
    """Return `simulate(seed, tilts, seconds_between)` -> TestRig."""

    def make(
        seed: int,
        tilts: tuple[int, ...] = (-600, 400, 0, 500, -300, 0),
        *,
        hz: float = 100.0,
        bandwidth: float = 25.0,
        noise: float = 1.0,
        pan: int = 1200,
        off_count: float = 0.0,
    ) -> TestRig:
        rng = np.random.default_rng(seed)
        # A unit that rounds what it is told to a count but stands where it was told.
        beside = np.random.default_rng([seed, 1])
        acceleration = 4000.0
        plan: list[tuple[int, int, float]] = []
        for tilt in tilts:
            plan.append((1, tilt, 600.0))
            plan += [(0, pan, 1400.0), (0, -pan, 1400.0), (0, 0, 700.0)]
        t, where, stood = 8.0, [0, 0], [0.0, 0.0]
        exchanges, moves = [], []
        for axis, target, speed in plan:
            if target == where[axis]:
                continue
            stand = target + float(beside.uniform(-off_count, off_count))
            distance = abs(stand - stood[axis])
            letter = "PT"[axis]
            exchanges.append((t, t + 0.003, f"{letter}S{speed:.0f}"))
            exchanges.append((t + 0.01, t + 0.013, f"{letter}P{target}"))
            start = t + 0.01 + rng.uniform(0.002, 0.006)
            sign = np.sign(target - where[axis])
            moves.append((axis, start, float(distance), speed, sign, target))
            peak = min(speed, np.sqrt(acceleration * distance))
            t = start + distance / peak + peak / acceleration + rng.uniform(0.3, 0.6)
            where[axis], stood[axis] = target, stand
        end = t + 8.0
        fine = np.arange(int(end * FINE_HZ)) / FINE_HZ
        rates = np.zeros((2, fine.size))
        for axis, start, length, v, sign, _ in moves:
            near = slice(int(start * FINE_HZ) - 2, int((start + length / v + 3.0) * FINE_HZ))
            rates[axis, near] += sign * _axis_speed(fine[near], start, length, v, acceleration)
        steps = np.cumsum(rates, axis=1) / FINE_HZ
        tilt = steps[1] * RAD_PER_STEP
        pan_rate, tilt_rate = rates * RAD_PER_STEP
        omega = np.stack([tilt_rate, pan_rate * np.sin(tilt), pan_rate * np.cos(tilt)])
        f = np.fft.rfftfreq(fine.size, 1.0 / FINE_HZ)
        s = 1j * f / bandwidth
        response = 1.0 / (s**2 + np.sqrt(2.0) * s + 1.0)
        lag = float(rng.uniform(0.005, 0.02))
        seen = np.fft.irfft(
            np.fft.rfft(omega, axis=1) * response * np.exp(-2j * np.pi * f * lag), fine.size, axis=1
        )
        time = np.arange(int((end - 1.0) * hz)) / hz + 0.3
        rate = np.stack([np.interp(time, fine, w) for w in seen], axis=1)
        gain = np.eye(3) + rng.normal(scale=0.02, size=(3, 3))
        bias = rng.normal(scale=0.02, size=3)
        y = rate @ gain.T + bias
        if noise > 0.0:
            y = y + noise * _coloured(rng, time.size, hz, 5.2e-4, 4e-5, 5e-6, bandwidth)
            y = np.rint(y / 1.527e-4) * 1.527e-4
        request = np.arange(0.5, end - 0.5, 0.0135)
        lo = request + 0.00026
        width = 0.0018 + rng.exponential(0.0004, lo.size)
        instant = lo + rng.uniform(0.0, 1.0) * 0.0018 + rng.uniform(size=lo.size) * (width - 0.0018)
        polled = np.stack([np.rint(np.interp(instant, fine, p)) for p in steps], axis=1)
        return TestRig(
            exchanges, lo, lo + width, polled, time, y, gain, bias, lag, [m[1] for m in moves]
        )

    return make
