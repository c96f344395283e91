"""A board's samples as uniform series, and the series' own grids.

Each stretch between restarts and long gaps becomes one series. Block means bring 800 Hz
down to about 100 Hz, which keeps all that a trapezoid's ramps tell and makes a solve
cheap. Long series are worked through in parts, so that memory does not grow with them.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.fft import next_fast_len

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.columns import CountArray
from gyrorig_solver.estimate.noise import Sampling
from gyrorig_solver.samples import GyroSamples

SERIES_HZ = 100.0  # about the rate of the block means, or more where the low-pass is wide:
PER_BANDWIDTH = 2.4  # a jump of speed tells the time offset up to the bandwidth
FINE_HZ = 500.0  # at least the rate of the fine grid, and five times the bandwidth
LONGEST_GAP_S = 2.0  # a longer gap begins a new series
SHARP_STD_S = 5e-5  # a reference as a whole less well timed hides what a finer series tells
MANY_SAMPLES = 4_000_000  # above it hours tell the offset well enough, and memory counts
SHORTEST_SERIES = 64  # blocks; less is not worth a spectrum
PART_BLOCKS = 1 << 16  # about the length of a part of a long series


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One stretch of samples on a uniform grid of sample numbers."""

    time_s: FloatArray  # (n,), of every sample number, gaps filled in
    raw: CountArray  # (n, 3), counts or rates; anything where missing
    good: BoolArray  # (n,)
    block: int
    fine: int  # fine intervals to a sample, odd
    bandwidth_hz: float | None  # of the sensor's low-pass, None where unknown
    scale_rad_s: float = 1.0  # of `raw`

    @property
    def blocks(self) -> int:
        """How many block means are used: as many as transform quickly, a few less than all."""
        whole = self.time_s.size // self.block
        count = max(1, round(whole / PART_BLOCKS))
        return count * quick_length(whole // count)

    @property
    def period_s(self) -> float:
        """The sample period."""
        return float(self.time_s[-1] - self.time_s[0]) / (self.time_s.size - 1)

    def parts(self) -> list[slice]:
        """Return the series cut into parts of blocks, equally long."""
        length = self.blocks // max(1, round(self.blocks / PART_BLOCKS))
        return [slice(k, k + length) for k in range(0, self.blocks, length)]

    def samples_of(self, blocks: slice) -> slice:
        """Return the samples of a range of blocks."""
        return slice(blocks.start * self.block, blocks.stop * self.block)

    def rate_rad_s(self, samples: slice) -> FloatArray:
        """Return the measured rate of a range of samples, shape (m, 3)."""
        return np.asarray(self.raw[samples] * self.scale_rad_s, dtype=np.float64)

    def times_at(self, position: FloatArray) -> FloatArray:
        """Return times at fractional sample numbers, extended evenly beyond the ends."""
        last = self.time_s.size - 1
        first = max(0, int(position[0]))
        stop = min(last, int(position[-1]) + 1) + 1
        known = np.arange(first, stop)
        inner = np.interp(position, known, self.time_s[first:stop])
        inner = np.where(position < 0, self.time_s[0] + position * self.period_s, inner)
        beyond = self.time_s[-1] + (position - last) * self.period_s
        return np.asarray(np.where(position > last, beyond, inner), dtype=np.float64)

    def edges_s(self, samples: slice, fine: int) -> FloatArray:
        """Return the edges of `fine` intervals to a sample, shape (m * fine + 1,)."""
        count = (samples.stop - samples.start) * fine
        return self.times_at(samples.start - 0.5 + np.arange(count + 1) / fine)

    def block_edges_s(self, blocks: slice, fine: int) -> FloatArray:
        """Return the edges of `fine` intervals to a block, shape (m * fine + 1,)."""
        count = (blocks.stop - blocks.start) * fine
        position = (blocks.start + np.arange(count + 1) / fine) * self.block - 0.5
        return self.times_at(position)

    def block_times_s(self) -> FloatArray:
        """Return the middle of every block, shape (blocks,)."""
        n = self.blocks * self.block
        return np.asarray(self.time_s[:n].reshape(self.blocks, self.block).mean(axis=1))

    def means(self, values: FloatArray, use: BoolArray) -> FloatArray:
        """Return means over the used samples of each block, zero where there are none.

        Args:
            values: of whole blocks, shape (m * block, k).
            use: shape (m * block,).
        """
        if self.block == 1:
            return values if use.all() else np.where(use[:, None], values, 0.0)
        if use.all():
            total = values[:: self.block] + values[1 :: self.block]
            for k in range(2, self.block):
                total += values[k :: self.block]
            return np.asarray(total / self.block)
        shaped = values.reshape(-1, self.block, values.shape[1])
        weight = use.reshape(-1, self.block).astype(np.float64)
        count = np.maximum(weight.sum(axis=1), 1.0)
        total = np.einsum("ij,ijk->ik", weight, np.where(use.reshape(-1, self.block, 1), shaped, 0))
        return np.asarray(total / count[:, None], dtype=np.float64)

    def used(self, use: BoolArray) -> BoolArray:
        """Return which blocks have a used sample."""
        return np.asarray(use.reshape(-1, self.block).any(axis=1), dtype=np.bool_)


def quick_length(n: int) -> int:
    """Return the largest length up to n whose transform is quick (no large prime in it)."""
    while next_fast_len(n) != n:
        n -= 1
    return n


def grids(rate_hz: float, bandwidth_hz: float | None, sharp: bool = False) -> tuple[int, int]:
    """Return samples to a block and fine intervals to a sample, for samples at a rate.

    `sharp`: keep what tells the time offset up to the low-pass' bandwidth.
    """
    series_hz = max(SERIES_HZ, PER_BANDWIDTH * (bandwidth_hz or 0.0) * sharp)
    block = max(1, round(rate_hz / series_hz))
    least_hz = max(FINE_HZ, 5.0 * (bandwidth_hz or 0.0))
    fine = max(1, int(np.ceil(least_hz / rate_hz)))
    return block, fine + 1 - fine % 2


def too_short(sampling: Sampling) -> InputError:
    """Return the error of a recording without any series, with how long one has to be."""
    least_s = SHORTEST_SERIES / sampling.rate_hz
    return InputError(
        f"no stretch of samples without a gap lasts {least_s:.2g} s",
        f"record for longer; a gap above {LONGEST_GAP_S:g} s or a restart ends a stretch, and "
        "`gyrorig check` counts them",
    )


def build_series(samples: GyroSamples, common_std_s: float = 0.0) -> tuple[list[Series], Sampling]:
    """Cut the samples into series.

    Args:
        samples: of one board.
        common_std_s: what is not known of the reference's time as a whole; where that is
            much, a finer time offset is of no use.

    Returns:
        The series of at least `SHORTEST_SERIES` blocks, and how they were sampled.
    """
    period_s = samples.period_s
    rate_hz = 1.0 / period_s
    sharp = common_std_s < SHARP_STD_S and samples.number.size < MANY_SAMPLES
    block, fine = grids(rate_hz, samples.bandwidth_hz, sharp)
    jump = np.diff(samples.number)
    cut = (np.diff(samples.segment) != 0) | (jump * period_s > LONGEST_GAP_S)
    bounds = np.concatenate([[0], np.flatnonzero(cut) + 1, [samples.number.size]])
    series = []
    for begin, end in pairwise(bounds):
        inside = slice(int(begin), int(end))
        length = int(samples.number[end - 1] - samples.number[begin]) + 1
        if length < SHORTEST_SERIES * block:
            continue
        time_s, raw, good = _uniform(samples, inside, length)
        series.append(
            Series(time_s, raw, good, block, fine, samples.bandwidth_hz, samples.gyro.scale)
        )
    sampling = Sampling(
        rate_hz=rate_hz / block,
        block=block,
        bandwidth_hz=samples.bandwidth_hz,
        quantum_rad_s=samples.quantum_rad_s,
        differentiated=False,
    )
    return series, sampling


def _uniform(
    samples: GyroSamples, inside: slice, length: int
) -> tuple[FloatArray, CountArray, BoolArray]:
    """Return times, raw rates and which are good for every sample number of a stretch."""
    raw = samples.counts[inside]
    if length == raw.shape[0]:
        return samples.time_s[inside], raw, samples.good[inside]
    at = samples.number[inside] - samples.number[inside.start]
    filled = np.zeros((length, 3), dtype=raw.dtype)
    good = np.zeros(length, dtype=np.bool_)
    filled[at] = raw
    good[at] = samples.good[inside]
    time_s = np.interp(np.arange(length), at, samples.time_s[inside])
    return np.asarray(time_s, dtype=np.float64), filled, good
