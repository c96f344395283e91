"""Which part of a residual tells the noise: rests above a frequency, all of it below.

What the model of a motion lacks would pass for noise. Where there are rests enough, the
frequencies that they hold are taken from them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.noise import Periodogram
from gyrorig_solver.estimate.series import PART_BLOCKS, quick_length

SHORTEST_SPECTRUM = 256  # blocks
REST_S, ENOUGH_REST_S = 4.0, 20.0  # a rest worth a spectrum, and how much of such rest is enough
LEAST_WAVES = 2.0  # of the slowest frequency taken from a rest
SETTLE_S = 0.3  # after a move


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """The residual of one series."""

    residual: FloatArray  # (n, 3), zero where unused
    used: BoolArray  # (n,)
    moving: BoolArray  # (n,)
    parts: list[slice]


def periodograms(stretches: Sequence[Stretch], rate_hz: float) -> tuple[list[Periodogram], str]:
    """Return the residual's power, and in words which part of the recording it is of.

    Args:
        stretches: of one recording.
        rate_hz: of the block means.
    """
    whole = [
        Periodogram.of(s.residual[blocks], rate_hz, float(np.mean(s.used)))
        for s in stretches
        for blocks in s.parts
    ]
    shortest = max(SHORTEST_SPECTRUM, round(REST_S * rate_hz))
    rests = [
        s.residual[run]
        for s in stretches
        for run in _runs(s.used & ~_widened(s.moving, round(SETTLE_S * rate_hz)), shortest)
    ]
    rest_s = sum(rest.shape[0] for rest in rests) / rate_hz
    if rest_s < ENOUGH_REST_S or not any(s.moving.any() for s in stretches):
        return whole, "spectrum of the residual, whole recording"
    split_hz = LEAST_WAVES * rate_hz / shortest
    still = [Periodogram.of(rest, rate_hz).between(split_hz, np.inf) for rest in rests]
    slow = [piece.between(0.0, split_hz) for piece in whole]
    said = f"spectrum: {rest_s:.0f} s of rests above {split_hz:.1f} Hz, whole recording below"
    return [*slow, *still], said


def _runs(use: BoolArray, shortest: int) -> list[slice]:
    """Return where `use` holds for at least `shortest` rows; long runs in parts."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], use.astype(np.int8), [0]])))
    found = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        for first in range(begin, end, PART_BLOCKS):
            last = min(end, first + PART_BLOCKS)
            if last - first >= shortest:
                found.append(slice(first, first + quick_length(last - first)))
    return found


def _widened(moving: BoolArray, after: int) -> BoolArray:
    """Return the same, each stretch lasting `after` rows longer."""
    late = np.convolve(moving, np.ones(after + 1))[: moving.size]
    return np.asarray(late > 0.5, dtype=np.bool_)
