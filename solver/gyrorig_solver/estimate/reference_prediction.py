"""Prediction of the reference in one series: after the sensor's low-pass, as block means.

The rate passes the low-pass on a fine grid, because the residual depends on it. The derivatives by
the time offset and the reference's unknowns only determine the steps and weights of the fit, so
they use a coarser grid. All derivatives use the same grid: a shift of every start equals a shift of
the lag, and rounding must not separate the two.

What to use when: `predict_rate` for a part's rate; `predict_derivatives` for the derivatives.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.linear.packed_columns import PackedColumns, pack_columns
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.model.low_pass import LowPass, delay_distribution
from gyrorig_solver.reference import ReferenceMotion

FILTER_LEAD_S = 0.3  # a part starts this much earlier, so that the filter reaches its steady state
NOISE_MEMORY_S = 1.0  # columns of one row are twice this apart
FILTER_MEMORY_S = 0.1  # the filter still responds to an unknown interval for this time
MIN_COARSE_GRID_HZ = 250.0  # minimum rate of the derivatives' grid if the low-pass acts on it
COARSE_PER_BANDWIDTH = 3.0
TIME_STEP_S = 1e-5  # for the time derivative: ramps are linear except at their corners


@dataclass(frozen=True, slots=True, eq=False)
class SampledRate:
    """The stage's rate at the sample instants of a part."""

    rate: FloatArray  # (m, 3), after the low-pass; zero if unknown
    known: BoolArray  # (m,)


@dataclass(frozen=True, slots=True, eq=False)
class PartDerivatives:
    """Derivatives of a part's block means, stage frame."""

    time_derivative: FloatArray  # (3, n), minus the derivative by the lag
    shared: FloatArray  # (g', 3, n)
    law: FloatArray  # (q, 3, n), by the values of the motion law
    packed: PackedColumns


def predict_rate(
    series: Series, blocks: slice, reference: ReferenceMotion, lag_s: float
) -> SampledRate:
    """Evaluate the reference `lag_s` before each sample, after the low-pass.

    Without a recorded bandwidth, no filter is applied, and the lag contains its whole delay.
    """
    samples_wanted = series.samples_of_blocks(blocks)
    lead_samples = min(samples_wanted.start, int(np.ceil(FILTER_LEAD_S / series.period_s)))
    samples = slice(samples_wanted.start - lead_samples, samples_wanted.stop)
    edges = series.edges_s(samples, series.intervals_per_sample) - lag_s
    stage_rate = _stage_rate(series, reference, edges)
    all_known = bool(np.isfinite(stage_rate.sum()))
    known: BoolArray = np.ones(len(stage_rate), dtype=np.bool_)
    if not all_known:
        known = np.asarray(
            np.isfinite(stage_rate[:, 0] + stage_rate[:, 1] + stage_rate[:, 2]), np.bool_
        )
    rate = stage_rate if all_known else np.where(known[:, None], stage_rate, 0.0)
    low_pass = low_pass_of(series)
    if low_pass is not None:
        rate = low_pass.apply_to_instants(
            np.ascontiguousarray(rate.T), series.intervals_per_sample
        ).T
    else:
        rate = rate[series.intervals_per_sample // 2 :: series.intervals_per_sample]
    known = known[series.intervals_per_sample // 2 :: series.intervals_per_sample]
    if not all_known:
        reach_samples = max(1, round(FILTER_MEMORY_S / series.period_s))
        unknown_count = np.concatenate([[0], np.cumsum(~known)])
        positions = np.arange(known.size)
        unknown_nearby = (
            unknown_count[np.minimum(positions + reach_samples + 1, known.size)]
            - unknown_count[np.maximum(positions - reach_samples, 0)]
        )
        known = np.asarray(unknown_nearby == 0, dtype=np.bool_)
    return SampledRate(
        rate=rate[lead_samples:],
        known=known[lead_samples:],
    )


def _stage_rate(series: Series, reference: ReferenceMotion, edges_s: FloatArray) -> FloatArray:
    """Return the mean stage rate between edges, (n, 3).

    A series of means has no grid on which the low-pass could act. The mean of a filtered rate is
    the weighted sum of means over delayed intervals. The fitted lag contains the mean of the
    delays.
    """
    if not series.has_means or series.bandwidth_hz is None:
        return reference.evaluate(edges_s, derivatives=False).rate_rad_s
    delays_s, weights = delay_distribution(series.bandwidth_hz)
    rate = np.zeros((edges_s.size - 1, 3))
    for delay_s, weight in zip(delays_s, weights, strict=True):
        rate += weight * reference.evaluate(edges_s - delay_s, derivatives=False).rate_rad_s
    return rate


def predict_derivatives(
    series: Series,
    blocks: slice,
    reference: ReferenceMotion,
    lag_s: float,
    on_fine_grid: bool = False,
) -> PartDerivatives:
    """Return the derivatives of a part's block means by the reference's unknowns.

    Args:
        series: times of the samples.
        blocks: of the part.
        reference: the stage's motion.
        lag_s: of the samples.
        on_fine_grid: use the grid of `predict_rate` if a low-pass acts. A coarser one is faster,
            and its errors matter only next to a large misfit.
    """
    low_pass = low_pass_of(series)
    block_hz = 1.0 / (series.period_s * series.samples_per_block)
    # Above the series' rate, a low-pass is only a delay.
    delay_s = 0.0
    if low_pass is not None and series.samples_per_block > 1 and low_pass.bandwidth_hz >= block_hz:
        delay_s, low_pass = low_pass.delay_s, None
    intervals_per_block = (
        1
        if low_pass is None and (series.samples_per_block > 1 or series.has_means)
        else _intervals_per_block(series, block_hz, on_fine_grid)
    )
    edges = series.block_edges_s(blocks, intervals_per_block) - lag_s - delay_s
    evaluated = reference.evaluate(edges, derivatives=True)
    block_count = blocks.stop - blocks.start
    rate_hz = block_hz * intervals_per_block
    packed = pack_columns(
        evaluated.local,
        block_count * intervals_per_block,
        int(np.ceil(2.0 * (NOISE_MEMORY_S + FILTER_MEMORY_S) * rate_hz)),
    )
    shared, law = evaluated.shared, evaluated.law
    del evaluated  # the columns are packed now; both together need the most memory of a solve
    coarse_low_pass = None if low_pass is None else LowPass(low_pass.bandwidth_hz, rate_hz)

    def to_blocks(signals: FloatArray) -> FloatArray:
        return _to_blocks(signals, coarse_low_pass, intervals_per_block, series.samples_per_block)

    def each_to_blocks(signals: FloatArray) -> FloatArray:
        blocks = np.empty((len(signals), 3, block_count))
        for block, signal in zip(blocks, signals, strict=True):
            block[...] = to_blocks(signal.T)
        return blocks

    local_signals = to_blocks(packed.values)
    reach_blocks = int(np.ceil(NOISE_MEMORY_S * block_hz))
    return PartDerivatives(
        time_derivative=to_blocks(_time_derivative(reference, edges).T),
        shared=each_to_blocks(shared),
        law=each_to_blocks(law),
        packed=packed.resample(local_signals, intervals_per_block, reach_blocks),
    )


def low_pass_of(series: Series) -> LowPass | None:
    """Return the low-pass that `predict_rate` applies, or None."""
    if series.filter_bandwidth_hz is None:
        return None
    return LowPass(series.filter_bandwidth_hz, series.intervals_per_sample / series.period_s)


def low_pass_delay_s(series: Series) -> float:
    """Return the delay of the low-pass that `predict_rate` applies."""
    low_pass = low_pass_of(series)
    return low_pass.delay_s if low_pass else 0.0


def instants_per_block(series: Series) -> int:
    """Return the number of intervals of a coarse grid per block."""
    if series.samples_per_block == 1:
        return 1
    block_hz = 1.0 / (series.period_s * series.samples_per_block)
    return max(1, int(np.ceil(4.0 * (series.filter_bandwidth_hz or 0.0) / block_hz)))


def _intervals_per_block(series: Series, block_hz: float, on_fine_grid: bool) -> int:
    """Return the intervals per block; odd if a sample is an instant and not a mean."""
    if on_fine_grid:
        return series.samples_per_block * series.intervals_per_sample
    min_rate_hz = max(
        MIN_COARSE_GRID_HZ, COARSE_PER_BANDWIDTH * (series.filter_bandwidth_hz or 0.0)
    )
    intervals = max(1, int(np.ceil(min_rate_hz / block_hz)))
    return intervals + (1 - intervals % 2) * (series.samples_per_block == 1)


def _time_derivative(reference: ReferenceMotion, edges_s: FloatArray) -> FloatArray:
    """Return the derivative of the mean rates by a shift of the edges, zero if unknown."""
    earlier, later = (
        reference.evaluate(edges_s + shift_s, derivatives=False).rate_rad_s
        for shift_s in (-TIME_STEP_S, TIME_STEP_S)
    )
    derivative = (later - earlier) / (2.0 * TIME_STEP_S)
    return np.where(np.isfinite(derivative), derivative, 0.0)


def _to_blocks(
    signals: FloatArray, low_pass: LowPass | None, intervals_per_block: int, samples_per_block: int
) -> FloatArray:
    """Return the value of each block: a mean, or the middle if a block is an instant."""
    if low_pass is not None and samples_per_block == 1:
        return low_pass.apply_to_instants(signals, intervals_per_block)
    if low_pass is not None:
        signals = low_pass.apply_to_means(signals)
    if intervals_per_block == 1:
        return signals
    if samples_per_block == 1:
        return signals[..., intervals_per_block // 2 :: intervals_per_block]
    # Strided sums, because a mean over such a short axis is ten times slower.
    total = signals[..., ::intervals_per_block] + signals[..., 1::intervals_per_block]
    for k in range(2, intervals_per_block):
        total += signals[..., k::intervals_per_block]
    return np.asarray(total / intervals_per_block)
