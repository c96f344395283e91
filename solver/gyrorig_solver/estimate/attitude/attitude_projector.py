"""Score tests at a fit to reference attitudes, with all nuisance parameters projected out.

It is used like `nuisance_projector`, so that a search runs the same tests, with three differences.
The reference is the noisy side: its density is estimated from the residual, as a smooth model times
correction factors in bins. Only the band of the fit is used, and a series has as many values as the
band has coefficients. The noise of a camera grows with the motion, so the local scatter of the
residual weights each instant.

What to use when: `AttitudeProjector.at_attitude_fit`. Its states use the rate of the gyro,
corrected with the fitted gain and bias. The gyro's noise is negligible relative to the reference's;
functions of the noisy reference rate would be functions of that noise.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from scipy.sparse import csc_array, csr_array

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.attitude.attitude_fit import AttitudeFit
from gyrorig_solver.estimate.attitude.attitude_solver import FACTOR_CHUNK_S, MIN_CHUNKS
from gyrorig_solver.estimate.attitude.block_segments import (
    AccelerometerReadings,
    BlockSegment,
    build_block_segments,
)
from gyrorig_solver.estimate.attitude.segment_whitening import SegmentWhitener, build_whiteners
from gyrorig_solver.estimate.cascade import fitted_derivatives, total_effect
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.estimate.nuisance_basis import NuisancePrior
from gyrorig_solver.estimate.nuisance_projector import NuisanceProjector
from gyrorig_solver.estimate.observability import (
    ObservabilityAnalysis,
    analyse_scaled_observability,
)
from gyrorig_solver.estimate.parameter_layout import (
    GAIN_PARAMETERS,
    ParameterLayout,
    eliminate_parameters,
)
from gyrorig_solver.estimate.segment_signals import SignalFunction
from gyrorig_solver.estimate.series_segment import SeriesSegment
from gyrorig_solver.estimate.whitened_signals import WhitenedSignals, join_signals
from gyrorig_solver.model import RecordingContext, Signals, Term, dense_signals

CHUNK_S = 5.0  # longer than the correlation of a residual
MIN_BOARD_RATE_RAD_S = 0.05  # a faster board is in motion


class AttitudeProjector(NuisanceProjector):
    """The score-test space at a fit to attitudes; see the module."""

    def __init__(
        self,
        block_segments: Sequence[BlockSegment],
        whiteners: Sequence[SegmentWhitener],
        noise: NoiseModel,
        fitted_terms: Sequence[FittedTerm] = (),
    ) -> None:
        """Use `at_attitude_fit` instead.

        Args:
            block_segments: of all recordings.
            whiteners: one per segment.
            noise: of all segments, the basis of `whiteners`.
            fitted_terms: causes whose effect is removed, and that are part of the nuisance space.
        """
        self.block_segments, self.whiteners = tuple(block_segments), tuple(whiteners)
        self._noise = noise
        self.recording_count = 1 + max(segment.recording for segment in block_segments)
        with_lag = (segment.recording for segment in block_segments if segment.slope.any())
        self._offset_recording = max(with_lag, default=self.recording_count - 1)
        segments = [
            SeriesSegment(
                session_index=segment.recording,
                used=(np.ones(segment.block_count, dtype=np.bool_),),
                states=(segment.state,),
                exact_states=(segment.state,),
                models=(),
                residuals=(segment.residual - total_effect(fitted_terms, segment.state),),
                noise=noise,
            )
            for segment in block_segments
        ]
        columns = [self._segment_derivatives(segment, fitted_terms) for segment in block_segments]
        white_columns = [
            whitener.whiten(column)
            for whitener, column in zip(self.whiteners, columns, strict=True)
        ]
        basis = np.concatenate(white_columns, axis=1)
        local = csr_array((0, basis.shape[1]))
        super().__init__(
            segments,
            tuple(fitted_terms),
            basis,
            local,
            self._nuisance_prior(fitted_terms),
            fitted_terms,
        )

    @classmethod
    def at_attitude_fit(
        cls,
        fit: AttitudeFit,
        contexts: Sequence[RecordingContext],
        readings: "AccelerometerReadings",
    ) -> Self:
        """Return the projector at a converged fit.

        Args:
            fit: the fit.
            contexts: of each recording.
            readings: of each recording's accelerometer.
        """
        block_segments = build_block_segments(fit, contexts, readings)
        noise, whiteners = build_whiteners(block_segments, fit.band_hz)
        return cls(block_segments, whiteners, noise)

    def with_terms(self, fitted_terms: Sequence[FittedTerm]) -> "AttitudeProjector":
        """Return the projector with other causes removed from the residual and fitted."""
        return AttitudeProjector(self.block_segments, self.whiteners, self._noise, fitted_terms)

    def widen(self, factor: float) -> "AttitudeProjector":
        """Return the projector with all standard deviations multiplied by a factor."""
        widened_whiteners = [
            replace(whitener, std=whitener.std * factor) for whitener in self.whiteners
        ]
        return AttitudeProjector(
            self.block_segments, widened_whiteners, self._noise, self.fitted_terms
        )

    def whiten(self, signals: Sequence[Sequence[Signals]]) -> WhitenedSignals:
        """Return signals (k, blocks, 3) of each segment, whitened."""
        whitened_segments = [
            whitener.whiten(dense_signals(parts[0]))
            for whitener, parts in zip(self.whiteners, signals, strict=True)
        ]
        lengths = [whitener.scatter.size for whitener in self.whiteners for _ in range(3)]
        return WhitenedSignals.of_dense(np.concatenate(whitened_segments, axis=1), lengths)

    def evaluate_together(
        self, functions: Sequence[SignalFunction], count: int, term: Term | None = None
    ) -> WhitenedSignals:
        """Return `count` signals of several functions, one after the other, whitened."""
        return join_signals([self.evaluate_signals(function, term=term) for function in functions])

    def weighted_residual(self) -> list[FloatArray]:
        """Return the residual times the inverse noise covariance, (n, 3) per segment."""
        return [
            whitener.weight(white_part, segment.block_count)
            for whitener, white_part, segment in zip(
                self.whiteners,
                self._split_segments(self.residual),
                self.block_segments,
                strict=True,
            )
        ]

    def unwhiten(self, white_signal: FloatArray) -> list[FloatArray]:
        """Return a whitened signal (all,) as rates in the band, (n, 3) per segment."""
        return [
            whitener.unwhiten(white_part, segment.block_count)
            for whitener, white_part, segment in zip(
                self.whiteners, self._split_segments(white_signal), self.block_segments, strict=True
            )
        ]

    def score_inflation(self, signals: Sequence[FloatArray]) -> float:
        """Return the variance of scores over chunks of time, relative to that by the noise.

        Args:
            signals: whitened, (k, all) each, typical of causes; the result is their median.
        """
        chunks = np.concatenate(
            [
                np.tile(np.floor(times_s / CHUNK_S).astype(np.int64), 3) * self.recording_count
                + segment.recording
                for times_s, segment in zip(self._times_s(), self.block_segments, strict=True)
            ]
        )
        chunks = np.unique(chunks, return_inverse=True)[1]
        residual = self.orthogonal_component(self.residual)
        ratios = []
        for white_column in (column for group in signals for column in group):
            component = self.orthogonal_component(white_column)
            if component @ component <= 1e-6 * (white_column @ white_column):
                continue
            score = np.bincount(chunks, component * residual)
            ratios.append(float(score @ score) / float(component @ component))
        return max(1.0, float(np.median(ratios))) if ratios else 1.0

    def _times_s(self) -> list[FloatArray]:
        """Return the time of each whitened value of each segment."""
        lengths = [whitener.scatter.size for whitener in self.whiteners]
        edges = [segment.state.edges_s[[0, -1]] for segment in self.block_segments]
        return [
            begin_s + (end_s - begin_s) * (np.arange(n) + 0.5) / n
            for (begin_s, end_s), n in zip(edges, lengths, strict=True)
        ]

    def analyse_observability(self) -> ObservabilityAnalysis:
        """Return the analysis of G, the last bias, the stated time offset, and causes.

        The time offset is that of the last recording that shows it.
        """
        layout = ParameterLayout.of([self.fitted_terms], self.recording_count)
        keep = layout.index(self.recording_count - 1, offset_recording=self._offset_recording)
        information = eliminate_parameters(self._basis @ self._basis.T, keep, layout.prior_std)
        analysis = analyse_scaled_observability(information, layout.prior_std[keep])
        return analysis.widened(np.sqrt(self._variance_factors(layout.prior_std)[keep]))

    def _variance_factors(self, prior_std: FloatArray) -> FloatArray:
        """Return the ratio of each variance to that from the information, at least 1, (p,).

        It is computed as in `AttitudeSolver.variance_factors`, from the scores of chunks of time.
        """
        times_s = [np.floor(times / FACTOR_CHUNK_S) for times in self._times_s()]
        chunks = np.concatenate(
            [
                np.tile(t.astype(np.int64), 3) * self.recording_count + segment.recording
                for t, segment in zip(times_s, self.block_segments, strict=True)
            ]
        )
        chunks = np.unique(chunks, return_inverse=True)[1]
        if chunks.max() < MIN_CHUNKS:
            return np.ones(len(prior_std))
        covariance = np.linalg.inv(self._basis @ self._basis.T + np.diag(prior_std**-2.0))
        influence = covariance @ self._basis
        residual = self.residual - (influence @ self.residual) @ self._basis
        scores = np.stack([np.bincount(chunks, row * residual) for row in influence])
        ratios = np.sum(scores**2, axis=1) / np.diag(covariance)
        return np.asarray(np.maximum(ratios, 1.0), dtype=np.float64)

    def density(self, frequency_hz: FloatArray) -> FloatArray:
        """Return the smooth one-sided density of the noise, (k, 3)."""
        return self._noise.density(frequency_hz)

    @property
    def band_hz(self) -> float:
        """The highest frequency that is used."""
        segment, whitener = self.block_segments[0], self.whiteners[0]
        length_s = float(segment.state.edges_s[-1] - segment.state.edges_s[0])
        return whitener.scatter.size / (2.0 * length_s)

    @property
    def gain(self) -> FloatArray:
        """G of the fit, (3, 3)."""
        return self.block_segments[0].state.gain

    def best_step(self, removed: Sequence[int] = ()) -> FloatArray:
        """Return the step from the fit to the optimum with the causes, (unknowns,).

        Args:
            removed: numbers of causes that are left out of the model.
        """
        models = [self.drop_terms(removed)]
        products = self._subset_products(np.arange(self.residual.size), models)
        return np.asarray(self._fit_to_subset(products, models)[:, 0], np.float64)

    def residual_without(self, removed: Sequence[int] = ()) -> list[FloatArray]:
        """Return the residual of the best fit without some causes, (n, 3) per segment."""
        reduced_model = self.drop_terms(removed)
        return self.unwhiten(reduced_model.residual - self.best_step(removed) @ self._basis)

    def band_signal(self, function: SignalFunction) -> list[FloatArray]:
        """Return one signal of each state, (1, blocks, 3), in the band, (n, 3) per segment."""
        return self.unwhiten(self.evaluate_signals(function).dense()[0])

    def residual_of_model(self, gain: FloatArray, fitted_terms: Sequence[FittedTerm]) -> FloatArray:
        """Return the whitened residual for a gain and causes from another fit, (all,).

        Bias and lag are fitted by this function.

        Args:
            gain: G, shape (3, 3).
            fitted_terms: the causes of the other fit.
        """
        gain_effect = (gain - self.gain).ravel() @ self._basis[:GAIN_PARAMETERS]
        effect = self.evaluate_signals(lambda state: total_effect(fitted_terms, state)[None])
        residual = self.residual - gain_effect - effect.dense()[0]
        layout = ParameterLayout.of([()], self.recording_count)
        session_basis = self._basis[layout.session_index()]
        step = np.linalg.lstsq(session_basis.T, residual, rcond=None)[0]
        return np.asarray(residual - step @ session_basis, dtype=np.float64)

    def _split_segments(self, white_signal: FloatArray) -> list[FloatArray]:
        ends = np.cumsum([3 * whitener.scatter.size for whitener in self.whiteners])
        return np.split(white_signal, ends[:-1])

    def _segment_derivatives(
        self, segment: BlockSegment, fitted_terms: Sequence[FittedTerm]
    ) -> FloatArray:
        """Return a segment's derivatives by G, each recording's (b, tau) and the causes."""
        term_derivatives = fitted_derivatives(fitted_terms, segment.state)
        layout = ParameterLayout.of([fitted_terms], self.recording_count)
        derivatives = np.zeros((layout.size, segment.block_count, 3))
        index = layout.index(segment.recording)
        for axis in range(3):
            derivatives[index[3 * axis : 3 * axis + 3], :, axis] = segment.rate.T
            derivatives[index[GAIN_PARAMETERS + axis], :, axis] = 1.0
        # The gyro is sampled at t + tau: the lag moves y, not the model, so the sign is negative.
        derivatives[index[GAIN_PARAMETERS + 3]] = -segment.slope
        derivatives[layout.term_index()] = term_derivatives
        return derivatives

    def _nuisance_prior(self, fitted_terms: Sequence[FittedTerm]) -> NuisancePrior:
        layout = ParameterLayout.of([fitted_terms], self.recording_count)
        return NuisancePrior(
            local=csc_array((0, 0)),
            cross=np.zeros((0, layout.size)),
            shared=np.diag(layout.prior_std**-2.0),
            local_score=np.zeros(0),
            shared_score=np.zeros(layout.size),
            first_term=layout.first_term,
            board_parameters=layout.size,
        )
