"""The state of one recording in a fit: samples, reference, bias and lag.

`likelihood_fit` holds what several recordings of a board have in common (gain, terms). Everything
that belongs to one recording is here, so that recordings are processed one after the other and only
sums are combined.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.cascade import (
    fitted_derivatives,
    pass_through_of,
    timing_sensitive_mask,
    total_effect,
)
from gyrorig_solver.estimate.executed_motion import (
    executed_motion,
    follow_law,
    replace_law_derivatives,
)
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.initial_guess import LeastSquaresSums, correlation_lag, row_norms
from gyrorig_solver.estimate.linear.normal_equations import (
    NormalEquations,
    NormalEquationsSum,
    score_of_residual,
)
from gyrorig_solver.estimate.noise.impulse_response_mask import axis_motions, impulse_response_mask
from gyrorig_solver.estimate.noise.motion_noise import (
    MotionNoise,
    MotionResidual,
    estimate_motion_noise,
)
from gyrorig_solver.estimate.noise.noise_estimation import (
    ResidualSegment,
    noise_periodograms,
    resting_blocks,
)
from gyrorig_solver.estimate.noise.noise_model import (
    NoiseModel,
    Periodogram,
    Sampling,
    Spectrum,
    bin_spectrum,
    fit_noise_levels,
)
from gyrorig_solver.estimate.noise.outliers import find_outliers, robust_spread
from gyrorig_solver.estimate.noise.relative_std import RelativeStd
from gyrorig_solver.estimate.noise.rest_noise import RestDifferences, limit_to_rest
from gyrorig_solver.estimate.noise.whitening import PartModel, WhitenedPart, whiten_residual
from gyrorig_solver.estimate.reference_prediction import (
    instants_per_block,
    low_pass_delay_s,
    predict_derivatives,
    predict_rate,
)
from gyrorig_solver.estimate.series import PART_BLOCKS, Series, too_short_error
from gyrorig_solver.model.signal_state import RecordingContext, SignalState
from gyrorig_solver.reference.reference_motion import ReferenceMotion

MAX_LOG_WEIGHT_CHANGE = 0.03  # smaller changes keep the old weights
MIN_REFERENCE_RATE_RAD_S = 0.003  # of the reference


@dataclass(slots=True, eq=False)
class _SeriesState:
    """The state of one series; block means."""

    series: Series
    good: BoolArray  # (samples,), without outliers
    measured: FloatArray  # (n, 3)
    rate: FloatArray  # (n, 3), stage
    used: BoolArray  # (n,)
    effect: FloatArray  # (n, 3), of causes beyond the base model, sensor frame


@dataclass(frozen=True, slots=True, eq=False)
class _PredictedPart:
    """Samples of one part and their prediction."""

    measured: FloatArray  # (samples, 3)
    rate: FloatArray  # (samples, 3), stage
    usable: BoolArray  # (samples,), outliers included


@dataclass(frozen=True, slots=True, eq=False)
class _CachedNormalEquations:
    """A recording's normal equations, for later iterations with small changes."""

    part: WhitenedPart
    normal: NormalEquations
    noise: NoiseModel

    def is_valid_for(self, noise: NoiseModel, relative_std: RelativeStd | None) -> bool:
        """Return whether the weights of another noise are the same within a few percent."""
        if relative_std is not self.part.relative_std:
            return False
        n = self.part.std.shape[0]
        ratio = noise.dct_variance(n)[1:] / self.part.std[1:] ** 2
        return bool(np.all(np.abs(np.log(ratio)) < MAX_LOG_WEIGHT_CHANGE))

    def at_residual(self, residual: FloatArray, local_count: int) -> NormalEquations:
        """Return the equations for another residual, shape (n, 3)."""
        return NormalEquations(
            self.normal.matrix, score_of_residual(self.part, residual, local_count)
        )


@dataclass(frozen=True, slots=True, eq=False)
class _StateKey:
    """Everything that a signal state depends on."""

    lag_s: float
    gain: FloatArray
    bias_rad_s: FloatArray
    reference: ReferenceMotion

    def equals(self, other: "_StateKey") -> bool:
        return (
            self.reference is other.reference
            and self.lag_s == other.lag_s
            and np.array_equal(self.gain, other.gain)
            and np.array_equal(self.bias_rad_s, other.bias_rad_s)
        )


@dataclass(frozen=True, slots=True, eq=False)
class SessionNoise:
    """The noise of one recording, and its origin."""

    noise: NoiseModel
    spectrum: Spectrum  # of the residual
    source: str  # the part of the recording that was used


class SessionFit:
    """One recording's part of a fit."""

    def __init__(
        self,
        series: Sequence[Series],
        sampling: Sampling,
        reference: ReferenceMotion,
        timestamp_std_s: float = 0.0,
        context: RecordingContext | None = None,
    ) -> None:
        """Start without any estimate.

        Args:
            series: of one board and recording, from `build_series`.
            sampling: how they were sampled.
            reference: the stage's motion on the same time axis.
            timestamp_std_s: uncertainty of a common shift of the samples' times.
            context: facts that causes beyond the base model need.

        Raises:
            InputError: there is no series.
        """
        if not series:
            raise too_short_error(sampling)
        self.sampling = replace(sampling, differentiated=reference.is_differentiated)
        self.reference = reference
        self.bias_rad_s, self.lag_s = np.zeros(3), 0.0
        self.fitted_terms: tuple[FittedTerm, ...] = ()
        self._timestamp_std_s, self._context = timestamp_std_s, context
        self._series_states = [_empty_state(series_of_recording) for series_of_recording in series]
        self._models: dict[tuple[int, int], PartModel] = {}
        self._signal_states: dict[tuple[int, int, bool], tuple[_StateKey, SignalState]] = {}
        self._cached_equations: _CachedNormalEquations | None = None
        self._predicted_parts: dict[tuple[int, int], _PredictedPart] = {}
        self._used_before: list[BoolArray] = []  # of the last prediction but one
        self.has_new_derivatives = True  # whether they belong to the current values
        self.equation_noise: NoiseModel | None = None  # of the last normal equations
        self.motion_noise: MotionNoise | None = None  # None: the noise is the same in motion
        self._relative_stds: dict[tuple[int, int], RelativeStd] = {}

    # ---- current state

    @property
    def series(self) -> list[Series]:
        """The series, in the order of time."""
        return [series_state.series for series_state in self._series_states]

    @property
    def context(self) -> RecordingContext | None:
        """Facts that causes beyond the base model need."""
        return self._context

    @property
    def common_std_s(self) -> float:
        """The standard deviation of a common time shift that the recording cannot show."""
        return float(np.hypot(self.reference.common_shift_std_s, self._timestamp_std_s))

    @property
    def time_offset_s(self) -> float:
        """The whole lag, including the delay of the low-pass."""
        return self.lag_s + low_pass_delay_s(self._series_states[0].series)

    @property
    def measured(self) -> list[FloatArray]:
        """Measured block means, (n, 3) per series."""
        return [series_state.measured for series_state in self._series_states]

    @property
    def cause_effects(self) -> list[FloatArray]:
        """The effect of causes beyond the base model, sensor frame, (n, 3) per series."""
        return [series_state.effect for series_state in self._series_states]

    @property
    def rates(self) -> list[FloatArray]:
        """Stage rates, (n, 3) per series."""
        return [series_state.rate for series_state in self._series_states]

    @property
    def used(self) -> list[BoolArray]:
        """Which blocks are used, (n,) per series."""
        return [series_state.used for series_state in self._series_states]

    @property
    def moving(self) -> list[BoolArray]:
        """Which blocks are in motion, (n,) per series."""
        return [
            np.asarray(row_norms(series_state.rate) > MIN_REFERENCE_RATE_RAD_S)
            for series_state in self._series_states
        ]

    @property
    def outliers(self) -> int:
        """The number of samples rejected as outliers."""
        return sum(
            int(np.sum(series_state.series.good & ~series_state.good))
            for series_state in self._series_states
        )

    def residuals(self, gain: FloatArray) -> list[FloatArray]:
        """Return measured minus modelled rates, zero where unused, (n, 3) per series.

        Args:
            gain: G, shape (3, 3).
        """
        residuals = []
        for series_state in self._series_states:
            residual = series_state.measured - series_state.rate @ gain.T - self.bias_rad_s
            if self.fitted_terms:
                residual -= series_state.effect
            residuals.append(
                residual
                if series_state.used.all()
                else np.where(series_state.used[:, None], residual, 0.0)
            )
        return residuals

    @property
    def relative_variances(self) -> list[FloatArray | None]:
        """The variance of the noise relative to that at rest, (n, 3) per series; None: 1."""
        if self.motion_noise is None:
            return [None] * len(self._series_states)
        return [
            np.concatenate(
                [
                    self._relative_stds[series_index, blocks.start].values.T ** 2
                    for blocks in series_state.series.part_slices()
                ]
            )
            for series_index, series_state in enumerate(self._series_states)
        ]

    def relative_std(self, series_index: int, blocks: slice) -> RelativeStd | None:
        """The noise of a part relative to that at rest; None: the same everywhere."""
        return self._relative_stds.get((series_index, blocks.start))

    def whitened_residuals(self, gain: FloatArray, noise: NoiseModel) -> list[FloatArray]:
        """Return the residuals in units of their standard deviation, white, (n, 3) per series.

        Args:
            gain: G, shape (3, 3).
            noise: at rest.
        """
        return [
            whiten_residual(
                [residual[part] for part in series.part_slices()],
                noise,
                None if variance is None else np.sqrt(variance),
            )
            for series, residual, variance in zip(
                self.series, self.residuals(gain), self.relative_variances, strict=True
            )
        ]

    def copy(self) -> "SessionFit":
        """Return a copy of the state, for another fit."""
        other = copy(self)
        other._series_states = [
            replace(
                series_state,
                good=series_state.good.copy(),
                measured=series_state.measured.copy(),
                rate=series_state.rate.copy(),
                used=series_state.used.copy(),
                effect=series_state.effect.copy(),
            )
            for series_state in self._series_states
        ]
        other._models, other._signal_states, other._cached_equations = (
            {},
            self._signal_states.copy(),
            None,
        )
        other._predicted_parts = {}
        other.has_new_derivatives = True
        return other

    def trial_copy(self) -> "SessionFit":
        """Return a copy with the same derivatives, for a step that may be rejected."""
        other = self.copy()
        other._models, other._cached_equations = self._models.copy(), self._cached_equations
        other.has_new_derivatives = False
        return other

    def started_from(self, other: "SessionFit") -> "SessionFit":
        """Return these samples, started at the end of another fit of the same recording.

        Args:
            other: provides bias, lag, motion and outliers, but not the samples.
        """
        started = self.copy()
        started.bias_rad_s, started.lag_s = other.bias_rad_s, other.lag_s
        started.reference = other.reference
        started._set_motion_noise(other.motion_noise)
        for own_state, other_state in zip(
            started._series_states, other._series_states, strict=True
        ):
            own_state.good = other_state.good.copy()
        return started

    def iter_derivatives(
        self, gain: FloatArray
    ) -> Iterator[tuple[int, slice, PartModel, SignalState, SignalState]]:
        """Yield each part's series, blocks, derivatives, and its coarse and exact signal state.

        Args:
            gain: G, shape (3, 3).
        """
        for series_index, series_state in enumerate(self._series_states):
            for blocks in series_state.series.part_slices():
                model = self._part_model(series_index, blocks, gain)
                coarse_state = self.signal_state(series_state.series, blocks, gain)
                exact_state = self.signal_state(series_state.series, blocks, gain, exact=True)
                yield series_index, blocks, model, coarse_state, exact_state

    # ---- steps of a fit

    def estimate_lag(self) -> None:
        """Estimate the lag by the correlation of measured and reference speed."""
        self._predict_coarsely(0.0)
        self.lag_s = max(
            (
                correlation_lag(
                    series_state.series, series_state.measured, series_state.rate, series_state.used
                )
                for series_state in self._series_states
            ),
            key=lambda x: x[1],
        )[0]
        self._predict_coarsely(self.lag_s)
        if not any(series_state.used.any() for series_state in self._series_states):
            raise InputError(
                "the recording has no reference motion at the times of its samples",
                "check that the pan-tilt unit and the board were recorded at the same time",
            )

    def inlier_masks(self, gain: FloatArray) -> list[BoolArray]:
        """Return which used blocks a gain explains, within the limit of an outlier."""
        quantum = self.sampling.quantum_rad_s
        return [
            series_state.used
            & ~find_outliers(
                series_state.measured - series_state.rate @ gain.T - self.bias_rad_s,
                series_state.used,
                quantum,
            )
            for series_state in self._series_states
        ]

    def least_squares_sums(self, masks: Sequence[BoolArray]) -> LeastSquaresSums:
        """Return the sums of least squares over masked blocks of each series."""
        gram, moment, square = np.zeros((4, 4)), np.zeros((4, 3)), 0.0
        for series_state, mask in zip(self._series_states, masks, strict=True):
            design = np.column_stack([series_state.rate, np.ones(mask.size)])[mask]
            gram += design.T @ design
            measured = series_state.measured[mask]
            moment += design.T @ measured
            square += float(np.sum(measured**2))
        return LeastSquaresSums(gram, moment, square)

    def update_prediction(
        self, gain: FloatArray, detect_outliers: bool, new_derivatives: bool
    ) -> None:
        """Compute the prediction at the current lag and reference.

        Args:
            gain: G, shape (3, 3), for the outlier detection.
            detect_outliers: repeat the outlier detection.
            new_derivatives: compute new derivatives too.
        """
        self.predict(gain, keep_samples=detect_outliers)
        self.complete_prediction(gain, detect_outliers, new_derivatives)

    def predict(self, gain: FloatArray, keep_samples: bool = False) -> None:
        """Compute the prediction at the current lag and reference, with the outliers as they are.

        Args:
            gain: G, shape (3, 3).
            keep_samples: keep what an outlier detection needs.
        """
        self.reference = follow_law(self.reference, self.fitted_terms)
        self._used_before = [series_state.used.copy() for series_state in self._series_states]
        self._predicted_parts.clear()
        for series_index, series_state in enumerate(self._series_states):
            keep = keep_samples and series_state.series.block_count <= 2 * PART_BLOCKS
            for blocks in series_state.series.part_slices():
                part = self._predict_part(series_state, blocks, gain)
                self._set_block_means(series_state, blocks, part)
                if keep:
                    self._predicted_parts[(series_index, blocks.start)] = part

    def complete_prediction(
        self, gain: FloatArray, detect_outliers: bool, new_derivatives: bool
    ) -> None:
        """Detect outliers and discard derivatives after `predict`; arguments as above."""
        if detect_outliers:
            for series_index, series_state in enumerate(self._series_states):
                for blocks in series_state.series.part_slices():
                    part = self._predicted_parts.get((series_index, blocks.start))
                    part = part or self._predict_part(series_state, blocks, gain)
                    relative_std = self._relative_stds.get((series_index, blocks.start))
                    self._detect_outliers(series_state, blocks, part, gain, relative_std)
                    self._set_block_means(series_state, blocks, part)
        self._predicted_parts.clear()
        is_unchanged = all(
            np.array_equal(series_state.used, previous)
            for series_state, previous in zip(self._series_states, self._used_before, strict=True)
        )
        if new_derivatives or not is_unchanged:
            self.discard_derivatives()

    def discard_derivatives(self) -> None:
        """Discard the derivatives; the next normal equations need new ones."""
        self._cached_equations = None
        self._models.clear()
        self.has_new_derivatives = True

    def normal_equations(self, gain: FloatArray, noise: NoiseModel) -> NormalEquations:
        """Return the normal equations of the recording."""
        local_count, _ = self.reference.information.size
        residuals = self.residuals(gain)
        if self._cached_equations is not None and self._cached_equations.is_valid_for(
            noise, self._relative_stds.get((0, 0))
        ):
            self.equation_noise = self._cached_equations.noise
            return self._cached_equations.at_residual(residuals[0], local_count)
        self.equation_noise = noise
        total: NormalEquations | None = None
        for series_index, (series_state, residual) in enumerate(
            zip(self._series_states, residuals, strict=True)
        ):
            parts = series_state.series.part_slices()
            sums: NormalEquationsSum | None = None
            for blocks in parts:
                part = WhitenedPart.of(self._part_model(series_index, blocks, gain), gain, noise)
                sums = sums or NormalEquationsSum(noise, local_count, part.size)
                sums.add(part, residual[blocks], is_whole_series=len(parts) == 1)
            if sums is not None:
                total = sums.total() if total is None else total + sums.total()
            if len(residuals) == len(parts) == 1 and total is not None:
                self._cached_equations = _CachedNormalEquations(part, total, noise)
        if total is None:
            raise too_short_error(self.sampling)
        return total

    def release_equations(self) -> None:
        """Free the normal equations: only further iterations would need them."""
        self._cached_equations = None

    def noise_periodograms(self, gain: FloatArray) -> tuple[list[Periodogram], str]:
        """Return the residual's periodograms, and a description of the part they use.

        Unmodelled motion would look like noise. If there are enough rests, the frequencies that
        they resolve come from the rests only.
        """
        residuals = self.residuals(gain)
        segments = [
            ResidualSegment(
                residual,
                series_state.used,
                moving,
                series_state.series.part_slices(),
                relative_variance,
            )
            for series_state, residual, moving, relative_variance in zip(
                self._series_states, residuals, self.moving, self.relative_variances, strict=True
            )
        ]
        return noise_periodograms(segments, self.sampling.rate_hz)

    def fit_noise(
        self, gain: FloatArray, sampling: Sampling, initial_levels: FloatArray | None = None
    ) -> SessionNoise:
        """Estimate the noise at rest from the residual's spectrum.

        Args:
            gain: G, shape (3, 3).
            sampling: how the residual was sampled.
            initial_levels: (3, 4), from a previous fit.
        """
        periodograms, source = self.noise_periodograms(gain)
        spectrum = bin_spectrum(periodograms)
        noise = fit_noise_levels(spectrum, sampling, initial_levels)
        at_rest = [
            resting_blocks(used, moving, self.sampling.rate_hz)
            for used, moving in zip(self.used, self.moving, strict=True)
        ]
        differences = RestDifferences.of(self.residuals(gain), at_rest)
        return SessionNoise(limit_to_rest(noise, differences), spectrum, source)

    def update_motion_noise(self, gain: FloatArray, noise: NoiseModel) -> bool:
        """Estimate the noise in motion; return whether that changed the weights.

        Args:
            gain: G, shape (3, 3).
            noise: at rest.
        """
        if self.sampling.differentiated:  # the reference's own noise is larger in motion
            return False
        estimate = estimate_motion_noise(
            [
                MotionResidual(
                    residual,
                    series_state.rate,
                    series_state.used,
                    series_state.series.part_slices(),
                )
                for series_state, residual in zip(
                    self._series_states, self.residuals(gain), strict=True
                )
            ],
            noise,
        )
        if not self._changes_weights(estimate):
            return False
        self._set_motion_noise(estimate)
        return True

    def noise_ratios(self) -> dict[str, FloatArray]:
        """Return the white noise of each motor state relative to that at rest, (3,) each.

        The states are `in_motion` (any axis), `pan_motion` and `tilt_motion`; none if the noise is
        the same in motion.
        """
        if self.motion_noise is None:
            return {}
        used_rates = np.concatenate(
            [series_state.rate[series_state.used] for series_state in self._series_states]
        )
        return self.motion_noise.mean_ratios(used_rates)

    def _changes_weights(self, motion_noise: MotionNoise | None) -> bool:
        if motion_noise is None or self.motion_noise is None:
            return motion_noise is not self.motion_noise
        return any(
            bool(
                np.any(
                    np.abs(
                        np.log(
                            motion_noise.relative_variance(series_state.rate)
                            / self.motion_noise.relative_variance(series_state.rate)
                        )
                    )
                    > MAX_LOG_WEIGHT_CHANGE
                )
            )
            for series_state in self._series_states
        )

    def _set_motion_noise(self, motion_noise: MotionNoise | None) -> None:
        """Use a noise in motion from now on, at the current motion."""
        self.motion_noise, self._relative_stds = motion_noise, {}
        if motion_noise is None:
            return
        for series_index, series_state in enumerate(self._series_states):
            parts = series_state.series.part_slices()
            for blocks in parts:
                variance = motion_noise.relative_variance(series_state.rate[blocks])
                self._relative_stds[series_index, blocks.start] = RelativeStd(
                    np.ascontiguousarray(np.sqrt(variance).T), keeps_constant=len(parts) > 1
                )

    # ---- details

    def _predict_coarsely(self, lag_s: float) -> None:
        """Predict block means with the low-pass as a delay."""
        for series_state in self._series_states:
            delay_s = low_pass_delay_s(series_state.series)
            for blocks in series_state.series.part_slices():
                edges = series_state.series.block_edges_s(blocks, 1) - lag_s - delay_s
                rate = self.reference.evaluate(edges, derivatives=False).rate_rad_s
                known: BoolArray = np.asarray(np.isfinite(rate).all(axis=1), dtype=np.bool_)
                samples = series_state.series.samples_of_blocks(blocks)
                used = series_state.series.good[samples] & np.repeat(
                    known, series_state.series.samples_per_block
                )
                series_state.rate[blocks] = np.where(known[:, None], rate, 0.0)
                series_state.measured[blocks] = series_state.series.block_means(
                    series_state.series.rate_rad_s(samples), used
                )
                series_state.used[blocks] = series_state.series.used_blocks(used)

    def _predict_part(
        self, series_state: _SeriesState, blocks: slice, gain: FloatArray
    ) -> _PredictedPart:
        """Return the prediction of a part's samples, and set the causes' effect."""
        series = series_state.series
        samples = series.samples_of_blocks(blocks)
        predicted = predict_rate(series, blocks, self.reference, self.lag_s)
        usable = series.good[samples] & predicted.known
        timing_sensitive = None
        if self.fitted_terms:
            state = self.signal_state(series, blocks, gain, exact=True)
            series_state.effect[blocks] = total_effect(self.fitted_terms, state)
            timing_sensitive = timing_sensitive_mask(self.fitted_terms, state)
            if timing_sensitive is not None:
                usable = usable & ~np.repeat(timing_sensitive, series.samples_per_block)
        return _PredictedPart(series.rate_rad_s(samples), predicted.rate, usable)

    def _set_block_means(
        self, series_state: _SeriesState, blocks: slice, part: _PredictedPart
    ) -> None:
        """Set the block means of a part, without the outliers."""
        series = series_state.series
        used = part.usable & series_state.good[series.samples_of_blocks(blocks)]
        series_state.measured[blocks] = series.block_means(part.measured, used)
        series_state.rate[blocks] = series.block_means(part.rate, used)
        series_state.used[blocks] = series.used_blocks(used)

    def _detect_outliers(
        self,
        series_state: _SeriesState,
        blocks: slice,
        part: _PredictedPart,
        gain: FloatArray,
        relative_std: RelativeStd | None,
    ) -> None:
        """Decide again which samples of a part are outliers."""
        if not part.usable.any():
            return
        series = series_state.series
        samples = series.samples_of_blocks(blocks)
        residual = part.measured - part.rate @ gain.T - self.bias_rad_s
        if self.fitted_terms:
            residual -= np.repeat(series_state.effect[blocks], series.samples_per_block, axis=0)
        scaled = residual
        if relative_std is not None:
            scaled = residual / np.repeat(relative_std.values.T, series.samples_per_block, axis=0)
        outliers = find_outliers(scaled, part.usable, self.sampling.quantum_rad_s)
        if outliers.any():
            outliers &= ~self._rig_impulse_mask(
                series, samples, residual, part.usable, outliers, gain
            )
        series_state.good[samples] = series.good[samples] & ~outliers

    def _rig_impulse_mask(
        self,
        series: Series,
        samples: slice,
        residual: FloatArray,
        used: BoolArray,
        outliers: BoolArray,
        gain: FloatArray,
    ) -> BoolArray:
        """Return which outliers an impulse of pan or tilt explains."""
        angles = getattr(self.reference, "angles_rad", None)
        if angles is None or series.bandwidth_hz is None:
            return np.zeros_like(outliers)
        time_s = series.time_s[samples] - self.lag_s
        axes = axis_motions(angles(time_s), gain)
        std = robust_spread(residual, used, self.sampling.quantum_rad_s)[1]
        return impulse_response_mask(residual, outliers, time_s, axes, series.bandwidth_hz, std)

    def signal_state(
        self, series: Series, blocks: slice, gain: FloatArray, exact: bool = False
    ) -> SignalState:
        """Return the signal state of one part of a series.

        `exact`: if a block is one sample, use the samples' own fine grid, on which corners of a few
        milliseconds are visible. Otherwise use a coarse grid, good for derivatives. The latest
        states of a series of moderate length are cached, because fit, derivatives and search all
        need them.
        """
        state_key = _StateKey(self.lag_s, gain.copy(), self.bias_rad_s.copy(), self.reference)
        key = id(series), blocks.start, exact
        if key in self._signal_states and self._signal_states[key][0].equals(state_key):
            return self._signal_states[key][1]
        built_state = self._build_signal_state(series, blocks, gain, exact)
        if series.block_count * series.intervals_per_sample <= 2 * PART_BLOCKS:
            self._signal_states[key] = state_key, built_state
        return built_state

    def _build_signal_state(
        self, series: Series, blocks: slice, gain: FloatArray, exact: bool
    ) -> SignalState:
        instants, intervals_per_instant = instants_per_block(series), 1
        if exact and series.samples_per_block == 1:
            intervals_per_instant = series.intervals_per_sample
        edges = series.block_edges_s(blocks, instants * intervals_per_instant) - self.lag_s
        angles = getattr(self.reference, "angles_rad", None)
        return SignalState.build(
            edges,
            None if angles is None else angles(edges),
            np.ones((blocks.stop - blocks.start) * instants, dtype=np.bool_),
            instants_per_block=instants,
            intervals_per_instant=intervals_per_instant,
            bandwidth_hz=series.bandwidth_hz,
            gain=gain,
            bias_rad_s=self.bias_rad_s,
            rate_rad_s=self.reference.evaluate(edges, derivatives=False).rate_rad_s,
            context=self._current_context(),
        )

    def _current_context(self) -> RecordingContext | None:
        """Return the context with the motion profiles of the current fit."""
        profiles = getattr(self.reference, "profiles", None)
        if self._context is None or profiles is None or self._context.motion_profiles is profiles:
            return self._context
        return replace(self._context, motion_profiles=profiles)

    def _part_model(self, series_index: int, blocks: slice, gain: FloatArray) -> PartModel:
        series_state, key = self._series_states[series_index], (series_index, blocks.start)
        relative_std = self._relative_stds.get(key)
        if key in self._models:
            model = self._models[key]
            if model.relative_std is not relative_std:
                model = self._models[key] = replace(model, relative_std=relative_std)
            return model
        cause_derivatives, pass_through = np.zeros((0, blocks.stop - blocks.start, 3)), None
        if any(fitted_term.free_indices.size for fitted_term in self.fitted_terms):
            state = self.signal_state(series_state.series, blocks, gain, exact=True)
            cause_derivatives = fitted_derivatives(self.fitted_terms, state)
            pass_through = pass_through_of(self.fitted_terms, state)
        columns = predict_derivatives(
            series_state.series, blocks, executed_motion(self.reference), self.lag_s
        )
        share = None if pass_through is None else pass_through.at_stage("profile")
        replace_law_derivatives(cause_derivatives, self.fitted_terms, columns.law, gain, share)
        model = PartModel(
            rate=series_state.rate[blocks].copy(),
            used=series_state.used[blocks].copy(),
            cause_derivatives=cause_derivatives,
            columns=columns,
            pass_through=pass_through,
            relative_std=relative_std,
        )
        # The parts of a long series are computed again when needed, to save memory.
        if series_state.series.block_count <= 2 * PART_BLOCKS:
            self._models[key] = model
        return model


def _empty_state(series: Series) -> _SeriesState:
    n = series.block_count
    zeros = np.zeros((n, 3))
    return _SeriesState(
        series=series,
        good=series.good.copy(),
        measured=zeros,
        rate=zeros.copy(),
        used=np.zeros(n, np.bool_),
        effect=zeros.copy(),
    )
