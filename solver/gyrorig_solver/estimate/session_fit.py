"""The state of one recording in a fit: samples, reference, bias and lag.

`likelihood_fit` has the values that several recordings of a board share (gain, terms). This module
has the state of one recording, so that recordings are processed in sequence and only sums are
combined.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.derivative_cache import DerivativeCache
from gyrorig_solver.estimate.executed_motion import follow_law
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.linear.normal_equations import NormalEquations, NormalEquationsSum
from gyrorig_solver.estimate.linear.whitening import PartModel, WhitenedPart, whiten_residual
from gyrorig_solver.estimate.motion_weights import MotionWeights
from gyrorig_solver.estimate.noise.jitter_noise import JitterNoise
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, Sampling
from gyrorig_solver.estimate.noise.relative_std import RelativeStd
from gyrorig_solver.estimate.part_model import predict_part
from gyrorig_solver.estimate.recording_series import RecordingSeries
from gyrorig_solver.estimate.reference_prediction import low_pass_delay_s
from gyrorig_solver.estimate.series import PART_BLOCKS, Series, too_short_error
from gyrorig_solver.estimate.series_state import FitValues, PredictedPart
from gyrorig_solver.estimate.signal_state_cache import SignalStateCache
from gyrorig_solver.model import (
    RecordingContext,
    SignalState,
    recording_index_of,
    value_indices,
)
from gyrorig_solver.reference import ReferenceMotion


class SessionFit(RecordingSeries):
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
        super().__init__(series)
        self.sampling = replace(
            sampling,
            differentiated=reference.is_differentiated,
            has_several_series=len(series) > 1,
        )
        self.reference = reference
        self.bias_rad_s, self.lag_s = np.zeros(3), 0.0
        self.fitted_terms: tuple[FittedTerm, ...] = ()
        self._timestamp_std_s = timestamp_std_s
        self.derivatives = DerivativeCache()
        self._signal_states = SignalStateCache(context)
        self._predicted_parts: dict[tuple[int, int], PredictedPart] = {}
        self._used_before: list[BoolArray] = []  # before the last prediction
        self.keeps_rejected = False  # whether outliers stay outliers
        self._weights = MotionWeights()

    @property
    def context(self) -> RecordingContext | None:
        """Facts that causes beyond the base model need."""
        return self._signal_states.context

    @property
    def common_std_s(self) -> float:
        """The standard deviation of a common time shift that the recording cannot determine."""
        return float(np.hypot(self.reference.common_shift_std_s, self._timestamp_std_s))

    @property
    def time_offset_s(self) -> float:
        """The total lag, including the delay of the low-pass."""
        return self.lag_s + low_pass_delay_s(self._series_states[0].series)

    def residuals(self, gain: FloatArray) -> list[FloatArray]:
        """Return measured minus modelled rates at G (3, 3), 0 where unused, (n, 3) per series."""
        return [
            series_state.residual(gain, self.bias_rad_s, with_effect=bool(self.fitted_terms))
            for series_state in self._series_states
        ]

    @property
    def relative_variances(self) -> list[FloatArray | None]:
        """The variance of the white noise relative to rest, (n, 3) per series; None: 1."""
        return self._weights.relative_variances(self._series_states)

    @property
    def jitter_noise(self) -> JitterNoise | None:
        """Jitter of the sample times as noise; None: the residual shows none."""
        return self._weights.jitter_noise

    def relative_std(self, series_index: int, blocks: slice) -> RelativeStd | None:
        """The noise of a part relative to that at rest; None: the same at all times."""
        return self._weights.relative_std(series_index, blocks)

    def whitened_residuals(self, gain: FloatArray, noise: NoiseModel) -> list[FloatArray]:
        """Return the residuals in units of their standard deviation, white, (n, 3) per series."""
        return [
            whiten_residual(
                [residual[part] for part in series.part_slices()],
                noise,
                [self.relative_std(index, part) for part in series.part_slices()],
                [used[part] for part in series.part_slices()],
            )
            for index, (series, residual, used) in enumerate(
                zip(self.series, self.residuals(gain), self.used, strict=True)
            )
        ]

    def copy(self) -> "SessionFit":
        """Return a copy of the state, for another fit."""
        other = copy(self)
        other._series_states = [series_state.copy() for series_state in self._series_states]
        other.derivatives = self.derivatives.copy(with_derivatives=False)
        other._signal_states = self._signal_states.copy()
        other._predicted_parts = {}
        return other

    def trial_copy(self) -> "SessionFit":
        """Return a copy with the same derivatives, for a step that may be rejected."""
        other = self.copy()
        other.derivatives = self.derivatives.copy(with_derivatives=True)
        return other

    def started_from(self, other: "SessionFit") -> "SessionFit":
        """Return these samples with the start values of another fit of the same recording.

        Args:
            other: has bias, lag, motion and outliers; its samples are not used.
        """
        started = self.copy()
        started.bias_rad_s, started.lag_s = other.bias_rad_s, other.lag_s
        started.reference = other.reference
        started._weights = other._weights.at_states(started._series_states)
        for state, other_state in zip(started._series_states, other._series_states, strict=True):
            state.good = other_state.good.copy()
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

    def take_motion_noise(self, other: "SessionFit") -> None:
        """Use the noise in motion and the jitter of another recording, at the present motion."""
        self._weights = other._weights.at_states(self._series_states)

    def estimate_lag(self) -> None:
        """Estimate the lag by the correlation of measured and reference speed."""
        for series_state in self._series_states:
            series_state.predict_coarsely(self.reference, 0.0)
        estimates = [series_state.correlation_lag() for series_state in self._series_states]
        self.lag_s = max(estimates, key=lambda estimate: estimate[1])[0]
        for series_state in self._series_states:
            series_state.predict_coarsely(self.reference, self.lag_s)
        if not any(series_state.used.any() for series_state in self._series_states):
            raise InputError(
                "the recording has no reference motion at the times of its samples",
                "check that the pan-tilt unit and the board were recorded at the same time",
            )

    def inlier_masks(self, gain: FloatArray) -> list[BoolArray]:
        """Return which used blocks a gain explains within the limit of an outlier."""
        return [
            series_state.inliers(gain, self.bias_rad_s, self.sampling.quantum_rad_s)
            for series_state in self._series_states
        ]

    def update_prediction(
        self, gain: FloatArray, detect_outliers: bool, new_derivatives: bool
    ) -> None:
        """Compute the prediction at the current lag and reference.

        Args:
            gain: G, shape (3, 3), for the outlier detection.
            detect_outliers: repeat the outlier detection.
            new_derivatives: also compute new derivatives.
        """
        self.predict(gain, keep_samples=detect_outliers)
        self.complete_prediction(gain, detect_outliers, new_derivatives)

    def predict(self, gain: FloatArray, keep_samples: bool = False) -> None:
        """Compute the prediction at the current lag and reference, with the current outliers.

        `keep_samples`: keep the data that an outlier detection needs.
        """
        self.reference = follow_law(self.reference, self.fitted_terms)
        self._used_before = [series_state.used.copy() for series_state in self._series_states]
        self._predicted_parts.clear()
        for series_index, series_state in enumerate(self._series_states):
            keep = keep_samples and series_state.series.block_count <= 2 * PART_BLOCKS
            for blocks in series_state.series.part_slices():
                part = self._predict_part(series_state.series, blocks, gain)
                series_state.set_block_means(blocks, part, keep_left_out=True)
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
                    part = part or self._predict_part(series_state.series, blocks, gain)
                    relative_std = self.relative_std(series_index, blocks)
                    series_state.reject_outliers(
                        blocks,
                        part,
                        self._values(gain),
                        relative_std,
                        self.sampling.quantum_rad_s,
                        self.keeps_rejected,
                        self._event_times_s(),
                    )
                    series_state.set_block_means(blocks, part, self.keeps_rejected)
        self._predicted_parts.clear()
        is_unchanged = all(
            np.array_equal(series_state.used, previous)
            for series_state, previous in zip(self._series_states, self._used_before, strict=True)
        )
        if new_derivatives or not is_unchanged:
            self.derivatives.discard()

    def normal_equations(self, gain: FloatArray, noise: NoiseModel) -> NormalEquations:
        """Return the normal equations of the recording."""
        local_count, _ = self.reference.information.size
        residuals = self.residuals(gain)
        relative_std = self.relative_std(0, slice(0, 1))
        equations = self.derivatives.equations_for(noise, relative_std)
        if equations is not None:
            return equations.at_residual(residuals[0], local_count)
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
                self.derivatives.keep_equations(part, total)
        if total is None:
            raise too_short_error(self.sampling)
        return total

    def release_caches(self) -> None:
        """Free signal states and derivatives, which can be computed again."""
        self._signal_states.clear()
        self.derivatives.release()

    def update_motion_noise(self, gain: FloatArray, noise: NoiseModel) -> bool:
        """Estimate the noise in motion and the jitter; return whether that changed the weights.

        Args:
            gain: G, shape (3, 3).
            noise: at rest.
        """
        if self.sampling.differentiated:  # the noise of the reference is larger in motion
            return False
        before = self._weights
        self._weights = before.updated(self._series_states, self.residuals(gain), gain, noise)
        return self._weights is not before

    def noise_ratios(self) -> dict[str, FloatArray]:
        """Return the white noise of each motor state relative to that at rest, (3,) each.

        The states are `in_motion` (any axis), `pan_motion` and `tilt_motion`; none if the noise is
        the same in motion.
        """
        return self._weights.mean_ratios(self._series_states)

    def _predict_part(self, series: Series, blocks: slice, gain: FloatArray) -> PredictedPart:
        state = self.signal_state(series, blocks, gain, exact=True) if self.fitted_terms else None
        return predict_part(series, blocks, self._values(gain), self.fitted_terms, state)

    def signal_state(
        self, series: Series, blocks: slice, gain: FloatArray, exact: bool = False
    ) -> SignalState:
        """Return the signal state of one part of a series; see `SignalStateCache.state`."""
        return self._signal_states.state(series, blocks, self._values(gain), exact)

    def _event_times_s(self) -> FloatArray:
        """Return when the samples show the events of the causes in this recording."""
        context = self.context
        number = None if context is None else context.recording_index
        times_s = [
            fitted_term.values[index] + self.lag_s
            for fitted_term in self.fitted_terms
            if recording_index_of(fitted_term.term) in (None, number)
            for index in value_indices(fitted_term.term, role="event")
        ]
        return np.array(times_s)

    def _values(self, gain: FloatArray) -> FitValues:
        return FitValues(self.lag_s, gain.copy(), self.bias_rad_s.copy(), self.reference)

    def _part_model(self, series_index: int, blocks: slice, gain: FloatArray) -> PartModel:
        return self.derivatives.part_model(
            self._series_states[series_index],
            blocks,
            self._values(gain),
            self.fitted_terms,
            self._signal_states,
            self.relative_std(series_index, blocks),
        )
