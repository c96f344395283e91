"""The reference as one series' samples see it: through the sensor's low-pass, as block means.

The rate itself is carried through the low-pass on a fine grid, because the residual
rests on it. Its derivatives, by the time offset and the reference's unknowns, only steer
the fit and weigh it: they are taken on a coarser grid. All of them on the same one: to
shift every start is to shift the lag, and what a fit may tell of the two apart must not
come from rounding.

What to use when: `predict_rate` for a part's rate; `predict_columns` for the derivatives.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.lanes import Lanes, pack
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.model.low_pass import LowPass
from gyrorig_solver.reference.motion import ReferenceMotion

LEAD_S = 0.3  # a part is begun this much earlier, until the filter has forgotten its start
REACH_S = 1.0  # the noise's memory: columns of one lane keep twice this apart
FORGET_S = 0.1  # near an unknown stretch the filter still remembers it
COARSE_HZ = 250.0  # least rate of the derivatives' grid where the low-pass acts on it
COARSE_PER_BANDWIDTH = 3.0
SHIFT_S = 1e-5  # for the derivative by time: ramps are straight but for their corners


@dataclass(frozen=True, slots=True, eq=False)
class SampledRate:
    """The stage's rate at the sample instants of a part."""

    rate: FloatArray  # (m, 3), through the low-pass; zero where unknown
    known: BoolArray  # (m,)


@dataclass(frozen=True, slots=True, eq=False)
class PartColumns:
    """Derivatives of a part's block means, stage frame."""

    slope: FloatArray  # (3, n), by time: minus that by the lag
    shared: FloatArray  # (g', 3, n)
    lanes: Lanes


def predict_rate(
    series: Series, blocks: slice, reference: ReferenceMotion, lag_s: float
) -> SampledRate:
    """Evaluate the reference `lag_s` before each sample and send it through the low-pass.

    Where no bandwidth is recorded there is no filter, and the lag holds all of its delay.
    """
    wanted = series.samples_of(blocks)
    lead = min(wanted.start, int(np.ceil(LEAD_S / series.period_s)))
    samples = slice(wanted.start - lead, wanted.stop)
    edges = series.edges_s(samples, series.fine) - lag_s
    found = reference.evaluate(edges, derivatives=False).rate_rad_s
    whole = bool(np.isfinite(found.sum()))
    known: BoolArray = np.ones(len(found), dtype=np.bool_)
    if not whole:
        known = np.asarray(np.isfinite(found[:, 0] + found[:, 1] + found[:, 2]), np.bool_)
    rate = found if whole else np.where(known[:, None], found, 0.0)
    low_pass = low_pass_of(series)
    if low_pass is not None:
        rate = low_pass.apply_to_instants(np.ascontiguousarray(rate.T), series.fine).T
    else:
        rate = rate[series.fine // 2 :: series.fine]
    known = known[series.fine // 2 :: series.fine]
    if not whole:
        reach = max(1, round(FORGET_S / series.period_s))
        lost = np.concatenate([[0], np.cumsum(~known)])
        at = np.arange(known.size)
        near = lost[np.minimum(at + reach + 1, known.size)] - lost[np.maximum(at - reach, 0)]
        known = np.asarray(near == 0, dtype=np.bool_)
    return SampledRate(
        rate=rate[lead:],
        known=known[lead:],
    )


def predict_columns(
    series: Series, blocks: slice, reference: ReferenceMotion, lag_s: float
) -> PartColumns:
    """Return how a part's block means change with the reference's unknowns."""
    low_pass = low_pass_of(series)
    block_hz = 1.0 / (series.period_s * series.block)
    # Beyond the series' own rate a low-pass is only its delay.
    delay_s = 0.0
    if low_pass is not None and series.block > 1 and low_pass.bandwidth_hz >= block_hz:
        delay_s, low_pass = low_pass.delay_s, None
    per = 1 if low_pass is None and series.block > 1 else _per_block(series, block_hz)
    edges = series.block_edges_s(blocks, per) - lag_s - delay_s
    found = reference.evaluate(edges, derivatives=True)
    n = blocks.stop - blocks.start
    rate_hz = block_hz * per
    lanes = pack(found.local, n * per, int(np.ceil(2.0 * (REACH_S + FORGET_S) * rate_hz)))
    slope = _slope(reference, edges).T[None]
    everywhere = np.concatenate([slope, found.shared.transpose(0, 2, 1)])
    coarse = None if low_pass is None else LowPass(low_pass.bandwidth_hz, rate_hz)
    everywhere, local = (
        _decimated(signals, coarse, per, series.block) for signals in (everywhere, lanes.values)
    )
    reach = int(np.ceil(REACH_S * block_hz))
    return PartColumns(
        slope=everywhere[0],
        shared=everywhere[1:],
        lanes=lanes.coarser(local, per, reach),
    )


def low_pass_of(series: Series) -> LowPass | None:
    """Return the low-pass that `predict_rate` puts in, None where it puts in none."""
    if series.bandwidth_hz is None:
        return None
    return LowPass(series.bandwidth_hz, series.fine / series.period_s)


def low_pass_delay_s(series: Series) -> float:
    """Return the delay of the low-pass that `predict_rate` puts in."""
    low_pass = low_pass_of(series)
    return low_pass.delay_s if low_pass else 0.0


def instants_per_block(series: Series) -> int:
    """Return how many intervals of a coarse grid stand for a block's samples."""
    if series.block == 1:
        return 1
    block_hz = 1.0 / (series.period_s * series.block)
    return max(1, int(np.ceil(4.0 * (series.bandwidth_hz or 0.0) / block_hz)))


def _per_block(series: Series, block_hz: float) -> int:
    """Return intervals to a block; odd where a sample is an instant and not a mean."""
    least_hz = max(COARSE_HZ, COARSE_PER_BANDWIDTH * (series.bandwidth_hz or 0.0))
    per = max(1, int(np.ceil(least_hz / block_hz)))
    return per + (1 - per % 2) * (series.block == 1)


def _slope(reference: ReferenceMotion, edges_s: FloatArray) -> FloatArray:
    """Return how the mean rates between edges change as the edges move, zero where unknown."""
    early, late = (
        reference.evaluate(edges_s + by, derivatives=False).rate_rad_s for by in (-SHIFT_S, SHIFT_S)
    )
    slope = (late - early) / (2.0 * SHIFT_S)
    return np.where(np.isfinite(slope), slope, 0.0)


def _decimated(signals: FloatArray, low_pass: LowPass | None, per: int, block: int) -> FloatArray:
    """Return the value of each block: a mean, or the middle where a block is an instant."""
    if low_pass is not None and block == 1:
        return low_pass.apply_to_instants(signals, per)
    if low_pass is not None:
        signals = low_pass.apply_to_means(signals)
    if per == 1:
        return signals
    if block == 1:
        return signals[..., per // 2 :: per]
    # Strided sums: a mean over so short an axis takes ten times as long.
    total = signals[..., ::per] + signals[..., 1::per]
    for k in range(2, per):
        total += signals[..., k::per]
    return np.asarray(total / per)
