"""Periodograms for the noise estimate: of rests above a frequency, of the whole residual below it.

Unmodelled motion would look like noise. If there are enough rests, the frequencies that they
resolve come from the rests only.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.noise.missing_samples import expected_densities
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.estimate.noise.residual_spectrum import Periodogram
from gyrorig_solver.estimate.series import PART_BLOCKS, fast_dct_length

MIN_SPECTRUM_BLOCKS = 256  # blocks
MIN_REST_S, MIN_TOTAL_REST_S = (
    4.0,
    20.0,
)  # the shortest rest with a spectrum, and the sufficient total rest
MIN_PERIODS = 2.0  # of the lowest frequency in a rest
SETTLING_TIME_S = 0.3  # after a move


@dataclass(frozen=True, slots=True, eq=False)
class ResidualSegment:
    """The residual of one series."""

    residual: FloatArray  # (n, 3), zero where unused
    used: BoolArray  # (n,)
    moving: BoolArray  # (n,)
    parts: list[slice]
    relative_variance: FloatArray | None = None  # (n, 3), of the white noise; None: 1
    used_samples: BoolArray | None = None  # (n, m), of each block; None: all of the used blocks

    def white_power(self, blocks: slice) -> FloatArray | None:
        """Return the mean white noise of the used blocks relative to that at rest, shape (3,)."""
        used = self.used[blocks]
        if self.relative_variance is None or not used.any():
            return None
        return np.asarray(self.relative_variance[blocks][used].mean(axis=0))

    def periodogram(self, blocks: slice, sampling: Sampling) -> Periodogram:
        """Return the periodogram of some blocks, without the noise in motion."""
        used_samples = self.used_samples
        if used_samples is None:
            used_samples = self.used[:, None]
        return Periodogram.of(
            self.residual[blocks],
            sampling.rate_hz,
            float(np.mean(self.used[blocks])),
            unit_density=expected_densities(used_samples[blocks], sampling),
        )


def noise_periodograms(
    segments: Sequence[ResidualSegment], sampling: Sampling
) -> tuple[list[Periodogram], str]:
    """Return the residual's periodograms, and a description of the part of the recording used.

    Args:
        segments: of one recording.
        sampling: of the block means.
    """
    rate_hz = sampling.rate_hz
    whole_periodograms = [
        replace(segment.periodogram(blocks, sampling), white_power=segment.white_power(blocks))
        for segment in segments
        for blocks in segment.parts
        if segment.used[blocks].any()
    ]
    shortest = max(MIN_SPECTRUM_BLOCKS, round(MIN_REST_S * rate_hz))
    rests = [
        (segment, run)
        for segment in segments
        for run in _runs(resting_blocks(segment.used, segment.moving, rate_hz), shortest)
    ]
    rest_s = sum(run.stop - run.start for _, run in rests) / rate_hz
    if rest_s < MIN_TOTAL_REST_S or not any(segment.moving.any() for segment in segments):
        return whole_periodograms, "spectrum of the residual, whole recording"
    split_hz = MIN_PERIODS * rate_hz / shortest
    rest_periodograms = [
        segment.periodogram(run, sampling).band(split_hz, np.inf) for segment, run in rests
    ]
    low_periodograms = [piece.band(0.0, split_hz) for piece in whole_periodograms]
    description = (
        f"spectrum: {rest_s:.0f} s of rests above {split_hz:.1f} Hz, whole recording below"
    )
    return [*low_periodograms, *rest_periodograms], description


def resting_blocks(used: BoolArray, moving: BoolArray, rate_hz: float) -> BoolArray:
    """Return which used blocks are at rest, after the unit has settled, (n,)."""
    return used & ~_extend_after(moving, round(SETTLING_TIME_S * rate_hz))


def _runs(mask: BoolArray, min_length: int) -> list[slice]:
    """Return where a mask is True for at least `min_length` rows; long runs in parts."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    runs = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        for first in range(begin, end, PART_BLOCKS):
            last = min(end, first + PART_BLOCKS)
            if last - first >= min_length:
                runs.append(slice(first, first + fast_dct_length(last - first)))
    return runs


def _extend_after(moving: BoolArray, extra_rows: int) -> BoolArray:
    extended = np.convolve(moving, np.ones(extra_rows + 1))[: moving.size]
    return np.asarray(extended > 0.5, dtype=np.bool_)
