"""A board's samples and a reference brought onto one uniform series of block means.

Each stretch between restarts and long gaps becomes one series. A fine grid, an odd
number of intervals to a sample so that one is centred on it, carries the reference
through the sensor's low-pass; block means bring 800 Hz down to about 100 Hz, which keeps
all that a trapezoid's ramps tell and makes a solve cheap.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.noise import Sampling
from gyrorig_solver.model.low_pass import LowPass
from gyrorig_solver.reference.motion import LocalColumn, ReferenceMotion
from gyrorig_solver.samples import GyroSamples

SERIES_HZ = 100.0  # about the rate of the block means
FINE_HZ = 500.0  # at least the rate of the fine grid, and five times the bandwidth
LONGEST_GAP_S = 2.0  # a longer gap begins a new series
SHORTEST_SERIES = 64  # blocks; less is not worth a spectrum


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One stretch of samples on a uniform grid of sample numbers."""

    time_s: FloatArray  # (n,), of every sample number, gaps filled in
    rate_rad_s: FloatArray  # (n, 3), zero where missing
    good: BoolArray  # (n,)
    block: int
    fine: int  # fine intervals to a sample, odd
    bandwidth_hz: float | None  # of the sensor's low-pass, None where unknown

    @property
    def blocks(self) -> int:
        """How many whole block means there are."""
        return self.time_s.size // self.block

    def edges_s(self, lag_s: float) -> FloatArray:
        """Return the edges of the fine intervals, `lag_s` earlier, shape (n * fine + 1,)."""
        n = self.time_s.size
        position = (np.arange(n * self.fine + 1) - self.fine / 2.0) / self.fine
        inner = np.interp(position, np.arange(n), self.time_s)
        step = (self.time_s[-1] - self.time_s[0]) / (n - 1)
        inner = np.where(position < 0, self.time_s[0] + position * step, inner)
        last = position > n - 1
        inner = np.where(last, self.time_s[-1] + (position - (n - 1)) * step, inner)
        return np.asarray(inner - lag_s, dtype=np.float64)

    def at_samples(self, fine: FloatArray) -> FloatArray:
        """Return the fine values at the sample instants, shape (..., n, 3)."""
        return fine[..., self.fine // 2 :: self.fine, :]

    def block_means(self, values: FloatArray, use: BoolArray) -> tuple[FloatArray, BoolArray]:
        """Return means over the used samples of each block, and which blocks have any."""
        n = self.blocks * self.block
        weight = use[:n].reshape(self.blocks, self.block).astype(np.float64)
        count = weight.sum(axis=1)
        shaped = values[..., :n, :].reshape(*values.shape[:-2], self.blocks, self.block, 3)
        clean = np.where(weight[:, :, None] > 0.0, shaped, 0.0)
        mean = clean.sum(axis=-2) / np.maximum(count, 1.0)[:, None]
        return mean, count > 0.5


def grids(rate_hz: float, bandwidth_hz: float | None) -> tuple[int, int]:
    """Return samples to a block and fine intervals to a sample, for samples at a rate."""
    block = max(1, round(rate_hz / SERIES_HZ))
    least_hz = max(FINE_HZ, 5.0 * (bandwidth_hz or 0.0))
    fine = max(1, int(np.ceil(least_hz / rate_hz)))
    return block, fine + 1 - fine % 2


def build_series(samples: GyroSamples) -> tuple[list[Series], Sampling]:
    """Cut the samples into series.

    Returns:
        The series of at least `SHORTEST_SERIES` blocks, and how they were sampled.
    """
    period_s = samples.period_s
    rate_hz = 1.0 / period_s
    block, fine = grids(rate_hz, samples.bandwidth_hz)
    step = np.diff(samples.number) * period_s
    cut = (np.diff(samples.segment) != 0) | (step > LONGEST_GAP_S)
    bounds = np.concatenate([[0], np.flatnonzero(cut) + 1, [samples.number.size]])
    series = []
    for begin, end in pairwise(bounds):
        at = samples.number[begin:end] - samples.number[begin]
        length = int(at[-1]) + 1
        if length < SHORTEST_SERIES * block:
            continue
        rate = np.zeros((length, 3))
        good = np.zeros(length, dtype=np.bool_)
        rate[at] = samples.rate_rad_s[begin:end]
        good[at] = samples.good[begin:end]
        time_s = np.interp(np.arange(length), at, samples.time_s[begin:end])
        series.append(Series(time_s, rate, good, block, fine, samples.bandwidth_hz))
    sampling = Sampling(
        rate_hz=rate_hz / block,
        block=block,
        bandwidth_hz=samples.bandwidth_hz,
        quantum_rad_s=samples.quantum_rad_s,
        differentiated=False,
    )
    return series, sampling


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """The reference as one series' samples would see it, through the low-pass."""

    rate: FloatArray  # (n, 3), stage rate at the sample instants; zero where unknown
    slope: FloatArray  # (n, 3), its time derivative
    shared: FloatArray  # (g, n, 3)
    local: tuple[LocalColumn, ...]  # at the sample instants
    known: BoolArray  # (n,)


def predict(
    series: Series, reference: ReferenceMotion, lag_s: float, derivatives: bool = True
) -> Predicted:
    """Evaluate the reference `lag_s` before each sample and send it through the low-pass.

    Where no bandwidth is recorded there is no filter, and the lag holds all of its delay.
    """
    edges = series.edges_s(lag_s)
    found = reference.evaluate(edges, derivatives)
    step_s = float(edges[-1] - edges[0]) / (edges.size - 1)
    known_fine = np.all(np.isfinite(found.rate_rad_s), axis=1)
    rate = np.where(known_fine[:, None], found.rate_rad_s, 0.0)
    shared, local = found.shared, found.local
    low_pass = _low_pass(series)
    if low_pass is not None:
        together = low_pass.apply(np.concatenate([rate, *shared], axis=1))
        rate, *rest = np.split(together, 1 + len(shared), axis=1)
        shared = np.stack(rest) if rest else shared
        local = tuple(_filtered(column, low_pass, rate.shape[0]) for column in local)
    slope = np.gradient(rate, step_s, axis=0)
    known = known_fine[series.fine // 2 :: series.fine]
    if not known.all():
        # Near an unknown stretch the filter still remembers it.
        reach = max(1, round(0.1 / (series.fine * step_s)))
        known = np.convolve(~known, np.ones(2 * reach + 1), "same") < 0.5
    return Predicted(
        rate=series.at_samples(rate),
        slope=series.at_samples(slope),
        shared=series.at_samples(shared),
        local=tuple(_at_samples(column, series) for column in local),
        known=np.asarray(known, dtype=np.bool_),
    )


def low_pass_delay_s(series: Series) -> float:
    """Return the delay of the low-pass that `predict` puts in, 0 where it puts in none."""
    low_pass = _low_pass(series)
    return low_pass.delay_s if low_pass else 0.0


def _low_pass(series: Series) -> LowPass | None:
    if series.bandwidth_hz is None:
        return None
    step_s = (series.time_s[-1] - series.time_s[0]) / (series.time_s.size - 1) / series.fine
    return LowPass(series.bandwidth_hz, 1.0 / float(step_s))


def _filtered(column: LocalColumn, low_pass: LowPass, length: int) -> LocalColumn:
    tail = int(np.ceil(3.0 * low_pass.rate_hz / low_pass.bandwidth_hz))
    tail = max(0, min(tail, length - column.first - column.values.shape[0]))
    padded = np.concatenate([column.values, np.zeros((tail, 3))])
    return LocalColumn(column.first, low_pass.apply(padded) if padded.size else padded)


def _at_samples(column: LocalColumn, series: Series) -> LocalColumn:
    """Keep a local column's values at the sample instants."""
    centre, fine = series.fine // 2, series.fine
    first = max(0, -(-(column.first - centre) // fine))
    begin = first * fine + centre - column.first
    return LocalColumn(first, column.values[begin::fine])
