"""The state of one series in a fit: block means of samples and prediction, without outliers.

What to use when: `SeriesState.empty`, then `predict_coarsely` or `set_block_means` for each part;
`reject_outliers` to determine again which samples of a part are outliers.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.initial_guess import (
    LeastSquaresSums,
    correlation_lag,
    row_norms,
)
from gyrorig_solver.estimate.noise.impulse_response_mask import axis_motions, impulse_response_mask
from gyrorig_solver.estimate.noise.outliers import find_outliers, robust_spread
from gyrorig_solver.estimate.noise.relative_std import RelativeStd
from gyrorig_solver.estimate.reference_prediction import low_pass_delay_s
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.reference import ReferenceMotion

MIN_REFERENCE_RATE_RAD_S = 0.003  # of the reference
# Samples at which an error of the time of an event is visible: before and after it, and the
# settling time of the low-pass, in periods of its bandwidth.
EVENT_MARGIN_SAMPLES, SETTLING_PERIODS = 4, 2.0


@dataclass(frozen=True, slots=True, eq=False)
class PredictedPart:
    """Samples of one part and their prediction."""

    measured: FloatArray  # (samples, 3)
    rate: FloatArray  # (samples, 3), stage
    usable: BoolArray  # (samples,), including outliers
    # Of causes beyond the base model, sensor frame; None: there are none.
    effect: FloatArray | None  # (blocks, 3)
    sample_effect: FloatArray | None  # (samples, 3)
    timing_sensitive: BoolArray | None  # (blocks,), unusable because of the causes; None: none


@dataclass(frozen=True, slots=True, eq=False)
class FitValues:
    """The values of a fit that the prediction depends on, in addition to its causes."""

    lag_s: float
    gain: FloatArray  # (3, 3)
    bias_rad_s: FloatArray  # (3,)
    reference: ReferenceMotion

    def equals(self, other: "FitValues") -> bool:
        """Return whether all values are the same."""
        return (
            self.reference is other.reference
            and self.lag_s == other.lag_s
            and np.array_equal(self.gain, other.gain)
            and np.array_equal(self.bias_rad_s, other.bias_rad_s)
        )


@dataclass(slots=True, eq=False)
class SeriesState:
    """The state of one series; block means."""

    series: Series
    good: BoolArray  # (samples,), without outliers
    measured: FloatArray  # (n, 3)
    rate: FloatArray  # (n, 3), stage
    used: BoolArray  # (n,)
    effect: FloatArray  # (n, 3), of causes beyond the base model, sensor frame
    timing_sensitive: BoolArray  # (n,), left out since the last large step
    used_samples: BoolArray  # (n, m), of each block

    @classmethod
    def empty(cls, series: Series) -> Self:
        """Return the state before any prediction."""
        n = series.block_count
        zeros = np.zeros((n, 3))
        return cls(
            series=series,
            good=series.good.copy(),
            measured=zeros,
            rate=zeros.copy(),
            used=np.zeros(n, np.bool_),
            effect=zeros.copy(),
            timing_sensitive=np.zeros(n, np.bool_),
            used_samples=np.zeros((n, series.samples_per_block), np.bool_),
        )

    def copy(self) -> Self:
        """Return a copy of the state of the same series."""
        return replace(
            self,
            good=self.good.copy(),
            measured=self.measured.copy(),
            rate=self.rate.copy(),
            used=self.used.copy(),
            effect=self.effect.copy(),
            timing_sensitive=self.timing_sensitive.copy(),
            used_samples=self.used_samples.copy(),
        )

    @property
    def moving(self) -> BoolArray:
        """Which blocks are in motion, (n,)."""
        return np.asarray(row_norms(self.rate) > MIN_REFERENCE_RATE_RAD_S)

    @property
    def outlier_count(self) -> int:
        """The number of samples rejected as outliers."""
        return int(np.sum(self.series.good & ~self.good))

    def residual(self, gain: FloatArray, bias_rad_s: FloatArray, with_effect: bool) -> FloatArray:
        """Return measured minus modelled rates, zero where unused, (n, 3)."""
        residual = self.measured - self.rate @ gain.T - bias_rad_s
        if with_effect:
            residual -= self.effect
        return residual if self.used.all() else np.where(self.used[:, None], residual, 0.0)

    def inliers(self, gain: FloatArray, bias_rad_s: FloatArray, quantum_rad_s: float) -> BoolArray:
        """Return which used blocks a gain explains within the limit of an outlier, (n,)."""
        residual = self.measured - self.rate @ gain.T - bias_rad_s
        return self.used & ~find_outliers(residual, self.used, quantum_rad_s)

    def least_squares_sums(self, mask: BoolArray) -> LeastSquaresSums:
        """Return the sums of least squares over masked blocks."""
        design = np.column_stack([self.rate, np.ones(mask.size)])[mask]
        measured = self.measured[mask]
        return LeastSquaresSums(design.T @ design, design.T @ measured, float(np.sum(measured**2)))

    def correlation_lag(self) -> tuple[float, float]:
        """Return the lag of the measured speed behind the predicted one, and their correlation."""
        return correlation_lag(self.series, self.measured, self.rate, self.used)

    def predict_coarsely(self, reference: ReferenceMotion, lag_s: float) -> None:
        """Predict block means with the low-pass as a delay."""
        series, delay_s = self.series, low_pass_delay_s(self.series)
        for blocks in series.part_slices():
            edges = series.block_edges_s(blocks, 1) - lag_s - delay_s
            rate = reference.evaluate(edges, derivatives=False).rate_rad_s
            known: BoolArray = np.asarray(np.isfinite(rate).all(axis=1), dtype=np.bool_)
            samples = series.samples_of_blocks(blocks)
            used = series.good[samples] & np.repeat(known, series.samples_per_block)
            self.rate[blocks] = np.where(known[:, None], rate, 0.0)
            self.measured[blocks] = series.block_means(series.rate_rad_s(samples), used)
            self.used[blocks] = series.used_blocks(used)
            self.used_samples[blocks] = used.reshape(-1, series.samples_per_block)

    def set_block_means(self, blocks: slice, part: PredictedPart, keep_left_out: bool) -> None:
        """Set the block means of a part without its outliers.

        `keep_left_out`: blocks that were left out because of the causes stay left out. Otherwise,
        the fit could alternate between two sets of blocks without an end.
        """
        series = self.series
        left_out = self.timing_sensitive[blocks]
        left_out &= keep_left_out
        if part.timing_sensitive is not None:
            left_out |= part.timing_sensitive
        if part.effect is not None:
            self.effect[blocks] = part.effect
        samples = series.samples_of_blocks(blocks)
        used = part.usable & self.good[samples]
        used &= ~np.repeat(left_out, series.samples_per_block)
        self.measured[blocks] = series.block_means(part.measured, used)
        self.rate[blocks] = series.block_means(part.rate, used)
        self.used[blocks] = series.used_blocks(used)
        self.used_samples[blocks] = used.reshape(-1, series.samples_per_block)

    def reject_outliers(
        self,
        blocks: slice,
        part: PredictedPart,
        values: FitValues,
        relative_std: RelativeStd | None,
        quantum_rad_s: float,
        keeps_rejected: bool,
        event_times_s: FloatArray,
    ) -> None:
        """Determine again which samples of a part are outliers.

        Args:
            blocks: of the part.
            part: its samples and their prediction.
            values: of the fit; samples that an impulse of pan or tilt explains are not outliers.
            relative_std: of the noise; None: the same at all times.
            quantum_rad_s: one count.
            keeps_rejected: outliers stay outliers.
            event_times_s: of the causes in the fit, as the samples' times. A sample next to an
                event is not an outlier, because a small error of the time leaves a large residual.
        """
        if not part.usable.any():
            return
        series = self.series
        samples = series.samples_of_blocks(blocks)
        residual = part.measured - part.rate @ values.gain.T - values.bias_rad_s
        if part.sample_effect is not None:
            residual -= part.sample_effect
        scaled = residual
        if relative_std is not None:
            std = relative_std.sample_values.T
            scaled = residual / np.repeat(std, series.samples_per_block, axis=0)
        outliers = find_outliers(scaled, part.usable, quantum_rad_s)
        if outliers.any():
            std = robust_spread(residual, part.usable, quantum_rad_s)[1]
            outliers &= ~_rig_impulse_mask(series, samples, residual, outliers, values, std)
            outliers &= ~_event_mask(series, samples, event_times_s)
        previous = self.good if keeps_rejected else series.good
        self.good[samples] = previous[samples] & ~outliers


def _event_mask(series: Series, samples: slice, event_times_s: FloatArray) -> BoolArray:
    """Return which samples contain the effect of an event, or of an error of its time."""
    mask = np.zeros(samples.stop - samples.start, dtype=np.bool_)
    bandwidth_hz = series.filter_bandwidth_hz
    settling_s = 0.0 if bandwidth_hz is None else SETTLING_PERIODS / bandwidth_hz
    margin_s = EVENT_MARGIN_SAMPLES * series.period_s
    for event_s in event_times_s:
        begin, end = np.searchsorted(
            series.time_s[samples], (event_s - margin_s, event_s + margin_s + settling_s)
        )
        mask[begin:end] = True
    return mask


def _rig_impulse_mask(
    series: Series,
    samples: slice,
    residual: FloatArray,
    outliers: BoolArray,
    values: FitValues,
    std: FloatArray,
) -> BoolArray:
    """Return which outliers an impulse of pan or tilt explains."""
    angles = getattr(values.reference, "angles_rad", None)
    bandwidth_hz = series.filter_bandwidth_hz
    if angles is None or bandwidth_hz is None:
        return np.zeros_like(outliers)
    time_s = series.time_s[samples] - values.lag_s
    axes = axis_motions(angles(time_s), values.gain)
    return impulse_response_mask(residual, outliers, time_s, axes, bandwidth_hz, std)
