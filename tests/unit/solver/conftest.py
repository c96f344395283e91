"""A small rig of the tests' own, made of the parts of the accuracy bench.

It shares no code with the solver: trapezoids in closed form, the low-pass an analogue
second-order Butterworth applied by FFT, coloured noise white noise shaped by FFT.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.bench.accuracy.board import Board, sample, seen
from tests.bench.accuracy.noise import Levels
from tests.bench.accuracy.profile import Path as Way
from tests.bench.accuracy.profile import Trapezoid

LEVELS = Levels(white=5.2e-4, flicker=4e-5, walk=5e-6, quantum_rad_s=1.527e-4)


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
        noise_rng = np.random.default_rng([seed, 1])
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
            stand = target + float(noise_rng.uniform(-off_count, off_count))
            letter = "PT"[axis]
            exchanges.append((t, t + 0.003, f"{letter}S{speed:.0f}"))
            exchanges.append((t + 0.01, t + 0.013, f"{letter}P{target}"))
            start = t + 0.01 + float(rng.uniform(0.002, 0.006))
            moves.append(Trapezoid(axis, start, stood[axis], stand, speed, acceleration, 0.0))
            t = moves[-1].end_s + float(rng.uniform(0.3, 0.6))
            where[axis], stood[axis] = target, stand
        end = t + 8.0
        rests = [np.zeros(1 + sum(m.axis == axis for m in moves)) for axis in (0, 1)]
        way = Way(tuple(moves), (rests[0], rests[1]))
        lag = float(rng.uniform(0.005, 0.02))
        gain = np.eye(3) + rng.normal(scale=0.02, size=(3, 3))
        bias = rng.normal(scale=0.02, size=3)
        levels = Levels(
            noise * LEVELS.white, noise * LEVELS.flicker, noise * LEVELS.walk, LEVELS.quantum_rad_s
        )
        board = Board(gain, bias, lag, bandwidth, hz, (levels, levels, levels))
        count = int((end - 1.0) * hz)
        time = np.arange(count) / hz + 0.3
        y = seen(board, way, 0.3, count) @ gain.T + bias
        if noise > 0.0:
            y = sample(board, way, (0.3, 0.3 + (count + 0.5) / hz), rng).rate_rad_s
        request = np.arange(0.5, end - 0.5, 0.0135)
        lo = request + 0.00026
        width = 0.0018 + rng.exponential(0.0004, lo.size)
        instant = lo + rng.uniform(0.0, 1.0) * 0.0018 + rng.uniform(size=lo.size) * (width - 0.0018)
        polled = np.stack([np.rint(way.counted_steps(axis, instant)) for axis in (0, 1)], axis=1)
        return TestRig(
            exchanges, lo, lo + width, polled, time, y, gain, bias, lag, [m.start_s for m in moves]
        )

    return make
