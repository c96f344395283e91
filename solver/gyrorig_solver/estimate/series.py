"""Uniform series of a board's samples, and their grids.

Each segment between resets and long gaps becomes one series. Block means reduce 800 Hz to about 100
Hz, which keeps the information in a trapezoid's ramps and makes a solve fast. A long recording is
averaged further (`sample_averaging`). Long series are processed in parts, so that memory does not
grow with their length.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.fft import next_fast_len

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.count_columns import CountArray
from gyrorig_solver.data.link_remedies import WRONG_COUNTER
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.estimate.sample_averaging import average_samples, averaging_factor

SERIES_RATE_HZ = 100.0  # approximate rate of the block means; more for a wide low-pass:
SERIES_RATE_PER_BANDWIDTH = 2.4  # a speed jump shows the time offset up to the bandwidth
MIN_FINE_GRID_HZ = 500.0  # minimum rate of the fine grid; also five times the bandwidth
MAX_GAP_S = 2.0  # a longer gap starts a new series
MAX_SHARP_STD_S = 5e-5  # with a larger common shift, a finer series adds no information
MIN_GRID_SAMPLES = 1_000_000  # a grid of this length costs 40 MB
MAX_GRID_RATIO = 4  # of the grid's length to the samples in it
MIN_SERIES_BLOCKS = 64  # fewer give no useful spectrum
PART_BLOCKS = 1 << 16  # approximate length of a part of a long series


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One segment of samples on a uniform grid of sample numbers."""

    time_s: FloatArray  # (n,), of every sample number, including gaps
    raw: CountArray  # (n, 3), counts or rates; undefined for missing samples
    good: BoolArray  # (n,)
    samples_per_block: int
    intervals_per_sample: int  # odd
    bandwidth_hz: float | None  # of the sensor's low-pass; None if unknown
    scale_rad_s: float = 1.0  # per unit of `raw`
    has_means: bool = False  # each sample is a mean over its period, not an instant

    @property
    def filter_bandwidth_hz(self) -> float | None:
        """The bandwidth of the low-pass on the samples' grid; None if it does not filter there."""
        return None if self.has_means else self.bandwidth_hz

    @property
    def block_count(self) -> int:
        """The number of block means used: slightly fewer than all, for a fast transform."""
        whole = self.time_s.size // self.samples_per_block
        count = max(1, round(whole / PART_BLOCKS))
        return count * fast_dct_length(whole // count)

    @property
    def period_s(self) -> float:
        """The sample period."""
        return float(self.time_s[-1] - self.time_s[0]) / (self.time_s.size - 1)

    def part_slices(self) -> list[slice]:
        """Return the blocks of each part; all parts have the same length."""
        length = self.block_count // max(1, round(self.block_count / PART_BLOCKS))
        return [slice(k, k + length) for k in range(0, self.block_count, length)]

    def samples_of_blocks(self, blocks: slice) -> slice:
        """Return the samples of a range of blocks."""
        return slice(blocks.start * self.samples_per_block, blocks.stop * self.samples_per_block)

    def rate_rad_s(self, samples: slice) -> FloatArray:
        """Return the measured rate of a range of samples, shape (m, 3)."""
        return np.asarray(self.raw[samples] * self.scale_rad_s, dtype=np.float64)

    def times_at(self, position: FloatArray) -> FloatArray:
        """Return times at fractional sample numbers, extrapolated evenly beyond the ends."""
        last = self.time_s.size - 1
        first = max(0, int(position[0]))
        stop = min(last, int(position[-1]) + 1) + 1
        numbers = np.arange(first, stop)
        inner = np.interp(position, numbers, self.time_s[first:stop])
        inner = np.where(position < 0, self.time_s[0] + position * self.period_s, inner)
        after_end = self.time_s[-1] + (position - last) * self.period_s
        return np.asarray(np.where(position > last, after_end, inner), dtype=np.float64)

    def edges_s(self, samples: slice, intervals_per_sample: int) -> FloatArray:
        """Return the edges of `intervals_per_sample` intervals per sample, shape (m * k + 1,)."""
        count = (samples.stop - samples.start) * intervals_per_sample
        return self.times_at(samples.start - 0.5 + np.arange(count + 1) / intervals_per_sample)

    def block_edges_s(self, blocks: slice, intervals_per_block: int) -> FloatArray:
        """Return the edges of `intervals_per_block` intervals per block, shape (m * k + 1,)."""
        count = (blocks.stop - blocks.start) * intervals_per_block
        position = (
            blocks.start + np.arange(count + 1) / intervals_per_block
        ) * self.samples_per_block - 0.5
        return self.times_at(position)

    def block_times_s(self) -> FloatArray:
        """Return the middle of every block, shape (blocks,)."""
        n = self.block_count * self.samples_per_block
        return np.asarray(
            self.time_s[:n].reshape(self.block_count, self.samples_per_block).mean(axis=1)
        )

    def block_means(self, values: FloatArray, used: BoolArray) -> FloatArray:
        """Return means over the used samples of each block, zero without used samples.

        Args:
            values: of whole blocks, shape (m * samples_per_block, k).
            used: shape (m * samples_per_block,).
        """
        if self.samples_per_block == 1:
            return values if used.all() else np.where(used[:, None], values, 0.0)
        if used.all():
            total = values[:: self.samples_per_block] + values[1 :: self.samples_per_block]
            for offset in range(2, self.samples_per_block):
                total += values[offset :: self.samples_per_block]
            return np.asarray(total / self.samples_per_block)
        shaped = values.reshape(-1, self.samples_per_block, values.shape[1])
        weight = used.reshape(-1, self.samples_per_block).astype(np.float64)
        count = np.maximum(weight.sum(axis=1), 1.0)
        total = np.einsum(
            "ij,ijk->ik", weight, np.where(used.reshape(-1, self.samples_per_block, 1), shaped, 0)
        )
        return np.asarray(total / count[:, None], dtype=np.float64)

    def used_blocks(self, used_samples: BoolArray) -> BoolArray:
        """Return which blocks have a used sample."""
        return np.asarray(
            used_samples.reshape(-1, self.samples_per_block).any(axis=1), dtype=np.bool_
        )


def fast_dct_length(n: int) -> int:
    """Return the largest length up to n with a fast transform (small prime factors only)."""
    while next_fast_len(n) != n:
        n -= 1
    return n


def choose_grids(
    rate_hz: float, bandwidth_hz: float | None, resolve_time_offset: bool = False
) -> tuple[int, int]:
    """Return samples per block and fine intervals per sample for a sample rate.

    `resolve_time_offset`: keep the frequencies up to the low-pass' bandwidth, which show the time
    offset.
    """
    series_hz = max(
        SERIES_RATE_HZ, SERIES_RATE_PER_BANDWIDTH * (bandwidth_hz or 0.0) * resolve_time_offset
    )
    samples_per_block = max(1, round(rate_hz / series_hz))
    min_fine_hz = max(MIN_FINE_GRID_HZ, 5.0 * (bandwidth_hz or 0.0))
    intervals_per_sample = max(1, int(np.ceil(min_fine_hz / rate_hz)))
    return samples_per_block, intervals_per_sample + 1 - intervals_per_sample % 2


def too_short_error(sampling: Sampling) -> InputError:
    """Return the error for a recording without any series, with the minimum duration."""
    min_duration_s = MIN_SERIES_BLOCKS / sampling.rate_hz
    return InputError(
        f"the recording has no {min_duration_s:.2g} s of samples without an interruption",
        f"record for longer. Interruptions are resets of the board and gaps above {MAX_GAP_S:g} s; "
        "`gyrorig check` counts them",
    )


def _sparse_samples_error(length: int, count: int, link: str) -> InputError:
    return InputError(
        f"the recording has only {count} of {length} samples in a row, so their times are not "
        "those of a gyroscope",
        WRONG_COUNTER.for_link(link),
    )


def build_series(samples: GyroSamples, common_std_s: float = 0.0) -> tuple[list[Series], Sampling]:
    """Divide the samples into uniform series.

    Args:
        samples: of one board.
        common_std_s: uncertainty of a common shift of the reference's time; if it is large, a more
            accurate time offset is useless.

    Returns:
        The series of at least `MIN_SERIES_BLOCKS` blocks, and their sampling.
    """
    period_s = samples.period_s
    rate_hz = 1.0 / period_s
    averaging = averaging_factor(samples.number.size, rate_hz, samples.bandwidth_hz)
    grids = (
        choose_grids(rate_hz, samples.bandwidth_hz, common_std_s < MAX_SHARP_STD_S)
        if averaging == 1
        else (1, 1)
    )
    block_size = grids[0] * averaging
    number_step = np.diff(samples.number)
    is_break = (np.diff(samples.segment) != 0) | (number_step * period_s > MAX_GAP_S)
    bounds = np.concatenate([[0], np.flatnonzero(is_break) + 1, [samples.number.size]])
    series = []
    for begin, end in pairwise(bounds):
        inside = slice(int(begin), int(end))
        length = int(samples.number[end - 1] - samples.number[begin]) + 1
        if length < MIN_SERIES_BLOCKS * block_size:
            continue
        if length > max(MIN_GRID_SAMPLES, MAX_GRID_RATIO * int(end - begin)):
            raise _sparse_samples_error(length, int(end - begin), samples.link)
        series.append(_uniform_series(samples, inside, length, grids, averaging))
    sampling = Sampling(
        rate_hz=rate_hz / block_size,
        samples_per_block=block_size,
        bandwidth_hz=samples.bandwidth_hz,
        quantum_rad_s=samples.quantum_rad_s,
        differentiated=False,
    )
    return series, sampling


def _uniform_series(
    samples: GyroSamples, inside: slice, length: int, grids: tuple[int, int], averaging: int
) -> Series:
    """Return the series of a segment, with means instead of samples if `averaging` is not 1."""
    time_s, raw, good = _fill_gaps(samples, inside, length)
    scale = samples.gyro.scale
    if averaging == 1:
        return Series(time_s, raw, good, *grids, samples.bandwidth_hz, scale)
    means = average_samples(time_s, raw, good, averaging)
    return Series(*means, *grids, samples.bandwidth_hz, scale / averaging, has_means=True)


def _fill_gaps(
    samples: GyroSamples, segment: slice, length: int
) -> tuple[FloatArray, CountArray, BoolArray]:
    """Return times, raw rates and validity for every sample number of a segment."""
    raw = samples.counts[segment]
    positions = samples.number[segment] - samples.number[segment.start]
    sample_time_s = _increasing_times(samples.time_s[segment], positions, samples.period_s)
    if length == raw.shape[0]:
        return sample_time_s, raw, samples.usable[segment]
    filled = np.zeros((length, 3), dtype=raw.dtype)
    good = np.zeros(length, dtype=np.bool_)
    filled[positions] = raw
    good[positions] = samples.usable[segment]
    time_s = np.interp(np.arange(length), positions, sample_time_s)
    return np.asarray(time_s, dtype=np.float64), filled, good


def _increasing_times(time_s: FloatArray, number: IntArray, period_s: float) -> FloatArray:
    """Return times without repeats, which a clock with slow ticks gives, shape (n,).

    The first of equal times stays, and the others are interpolated to the next larger time.

    Args:
        time_s: not decreasing, (n,).
        number: of each sample, increasing, (n,).
        period_s: of the samples, for times after the last larger one.
    """
    is_new = np.concatenate([[True], np.diff(time_s) > 0.0])
    if is_new.all():
        return time_s
    last = int(np.flatnonzero(is_new)[-1])
    spread_s = np.interp(number, number[is_new], time_s[is_new])
    spread_s[last + 1 :] = time_s[last] + (number[last + 1 :] - number[last]) * period_s
    return np.asarray(spread_s, dtype=np.float64)
