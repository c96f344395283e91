"""Score tests at a fit to reference attitudes, with all nuisance parameters projected out.

It is used like `nuisance_projector`, so that a search runs the same tests, with three differences.
The reference is the noisy side: its density is estimated from the residual, as a smooth model times
correction factors in bins. Only the band of the fit is used, and a series has as many values as the
band has coefficients. And the noise of a camera grows with the motion: the local scatter of the
residual weights each moment.

What to use when: `AttitudeProjector.at_attitude_fit`. Its states use the rate of the gyro itself,
corrected with the fitted gain and bias. The gyro's noise is negligible relative to the reference's,
and functions of a noisy rate would be functions of that noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.fft import dct, idct
from scipy.sparse import csc_array, csr_array

from gyrorig_solver.data.arrays import FloatArray
from gyrorig_solver.estimate.attitude.attitude_fit import AttitudeFit
from gyrorig_solver.estimate.attitude.attitude_solver import smooth_power
from gyrorig_solver.estimate.cascade import fitted_derivatives, total_effect
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.noise.noise_model import (
    NoiseModel,
    Periodogram,
    Sampling,
    bin_spectrum,
    fit_noise_levels,
)
from gyrorig_solver.estimate.nuisance_basis import NuisancePrior
from gyrorig_solver.estimate.nuisance_projector import NuisanceProjector, SignalFunction
from gyrorig_solver.estimate.observability import (
    ObservabilityAnalysis,
    analyse_scaled_observability,
)
from gyrorig_solver.estimate.parameter_layout import (
    GAIN_PARAMETERS,
    ParameterLayout,
    eliminate_parameters,
)
from gyrorig_solver.estimate.series_segment import SeriesSegment
from gyrorig_solver.estimate.whitened_signals import WhitenedSignals, join_signals
from gyrorig_solver.model.recording_context import RecordingContext
from gyrorig_solver.model.signal_arrays import Signals, dense_signals
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import Term

MAX_STEP_S = 0.01  # steps for functions of the rates: hand motion is slower
BLOCK_RATE_PER_BAND = 8.0  # block rate over the band
MIN_SEGMENT_S = 2.0  # shorter segments have too few coefficients in the band
SCATTER_WINDOW_S, MIN_SCATTER_VALUES = (
    5.0,
    40,
)  # window of the local scatter, and its minimum length
MIN_SCATTER = 0.3  # relative to the mean: a smaller local scatter is chance
CHUNK_S = 5.0  # longer than the correlation of a residual
MIN_BOARD_RATE_RAD_S = 0.05  # a faster board is in motion


@dataclass(frozen=True, eq=False)
class AttitudeState(SignalState):
    """A signal state with the specific force that the board's accelerometer measured."""

    measured_force_m_s2: FloatArray | None = None  # (n, 3), stage frame

    @cached_property
    def specific_force_m_s2(self) -> FloatArray:
        """The reading of the accelerometer, zeros without one, shape (n, 3)."""
        return (
            np.zeros((self.interval_count, 3))
            if self.measured_force_m_s2 is None
            else self.measured_force_m_s2
        )


@dataclass(frozen=True, slots=True, eq=False)
class BlockSegment:
    """One segment as block means, with its signal state."""

    recording: int
    state: AttitudeState
    measured: FloatArray  # (blocks, 3), the gyro
    modelled: FloatArray  # (blocks, 3), G w + b of the fit
    rate: FloatArray  # (blocks, 3), of the stage, from the gyro
    slope: FloatArray  # (blocks, 3), of the gyro by the lag
    time_s: FloatArray  # (blocks,)
    in_band_count: int  # coefficients in the band

    @property
    def block_count(self) -> int:
        """The number of block means."""
        return int(self.measured.shape[0])

    @property
    def residual(self) -> FloatArray:
        """The residual of the base model, with clipped glitches, (blocks, 3)."""
        return self.measured - self.modelled


@dataclass(frozen=True, slots=True, eq=False)
class SegmentWhitener:
    """Whitens one segment and equalises its local scatter."""

    std: FloatArray  # (kept, 3), of each coefficient
    scatter: FloatArray  # (kept,), of each moment, about 1

    def whiten(self, signals: FloatArray) -> FloatArray:
        """Return signals (k, blocks, 3) in units of the noise, (k, 3 kept)."""
        spectrum = dct(signals.transpose(0, 2, 1), axis=-1, norm="ortho")
        in_band = spectrum[:, :, : self.std.shape[0]] / self.std.T
        evened = idct(in_band, axis=-1, norm="ortho") / self.scatter
        return np.asarray(evened.reshape(signals.shape[0], -1), dtype=np.float64)

    def unwhiten(self, white_signal: FloatArray, block_count: int) -> FloatArray:
        """Return the rates, (blocks, 3), of a whitened signal (3 kept,) in its band."""
        scaled = white_signal.reshape(3, -1) * self.scatter
        return self._padded(dct(scaled, axis=-1, norm="ortho") * self.std.T, block_count)

    def weight(self, white_signal: FloatArray, block_count: int) -> FloatArray:
        """Return the rates whose product with a signal equals the whitened product."""
        scaled = white_signal.reshape(3, -1) / self.scatter
        return self._padded(dct(scaled, axis=-1, norm="ortho") / self.std.T, block_count)

    def _padded(self, spectrum: FloatArray, block_count: int) -> FloatArray:
        padded = np.zeros((3, block_count))
        padded[:, : spectrum.shape[1]] = spectrum
        return np.asarray(idct(padded, axis=-1, norm="ortho").T, dtype=np.float64)


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
        block_segments = _build_block_segments(fit, contexts, readings)
        noise, whiteners = _build_whiteners(block_segments, fit.band_hz)
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

    def unwhiten(self, white_signal: FloatArray, as_if_at_rest: bool = False) -> list[FloatArray]:
        """Return a whitened signal (all,) as rates in the band, (n, 3) per segment."""
        del as_if_at_rest  # the scatter of a segment is not that of motors
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
        """Return that of G, the last recording's bias and time offset, and the causes' values."""
        layout = ParameterLayout.of([self.fitted_terms], self.recording_count)
        keep = layout.index(self.recording_count - 1)
        information = eliminate_parameters(self._basis @ self._basis.T, keep, layout.prior_std)
        return analyse_scaled_observability(information, layout.prior_std[keep])

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
        everything = np.arange(self.residual.size)
        return np.asarray(
            self._fit_to_subset(everything, [self.drop_terms(removed)])[:, 0], np.float64
        )

    def residual_without(self, removed: Sequence[int] = ()) -> list[FloatArray]:
        """Return the residual of the best fit without some causes, (n, 3) per segment."""
        reduced_model = self.drop_terms(removed)
        return self.unwhiten(reduced_model.residual - self.best_step(removed) @ self._basis)

    def band_signal(self, function: SignalFunction) -> list[FloatArray]:
        """Return one signal of each state, (1, blocks, 3), in the band, (n, 3) per segment."""
        return self.unwhiten(self.evaluate_signals(function).dense()[0])

    def residual_of_model(self, gain: FloatArray, fitted_terms: Sequence[FittedTerm]) -> FloatArray:
        """Return the whitened residual for a gain and causes from another fit, (all,).

        Bias and lag are fitted here.

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
        # y is taken at t + tau: y moves and the model does not, so the sign is negative.
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


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerReadings:
    """The accelerometer readings of each recording, None without an accelerometer."""

    readings: tuple[tuple[FloatArray, FloatArray] | None, ...]  # time (n,), force (n, 3)

    def at(self, recording: int, time_s: FloatArray) -> FloatArray | None:
        """Return the force at given times, (m, 3), by linear interpolation."""
        reading = self.readings[recording]
        if reading is None:
            return None
        return np.stack([np.interp(time_s, reading[0], axis) for axis in reading[1].T], axis=1)


def _build_block_segments(
    fit: AttitudeFit, contexts: Sequence[RecordingContext], readings: AccelerometerReadings
) -> list[BlockSegment]:
    solver = fit.solver
    inverse = np.linalg.inv(solver.gain).T
    segments = []
    for k, (segment, recording) in enumerate(
        zip(solver.segments, fit.recording_of_segment, strict=True)
    ):
        track = segment.track
        steps_per_interval = max(1, int(MAX_STEP_S / track.step_s))
        step_s = steps_per_interval * track.step_s
        intervals_per_block = max(1, int(1.0 / (BLOCK_RATE_PER_BAND * fit.band_hz * step_s)))
        block_count = track.begin_s.size // (intervals_per_block * steps_per_interval)
        if block_count * intervals_per_block * step_s < MIN_SEGMENT_S:
            continue
        cleaned = solver.clean_segment(k)
        n = block_count * intervals_per_block * steps_per_interval
        rate = _group_means((cleaned.measured[:n] - solver.bias) @ inverse, steps_per_interval)
        edges_s = np.append(track.begin_s[:n:steps_per_interval], track.end_s[n - 1])
        middle_s = (edges_s[:-1] + edges_s[1:]) / 2.0
        state = AttitudeState.build(
            edges_s,
            None,
            np.ones(block_count * intervals_per_block, dtype=np.bool_),
            instants_per_block=intervals_per_block,
            intervals_per_instant=1,
            bandwidth_hz=None,
            gain=solver.gain,
            bias_rad_s=solver.bias,
            rate_rad_s=rate,
            context=contexts[recording],
        )
        state = replace(state, measured_force_m_s2=readings.at(recording, middle_s + solver.lag_s))
        measured = _group_means(cleaned.measured[:n], intervals_per_block * steps_per_interval)
        segments.append(
            BlockSegment(
                recording=recording,
                state=state,
                measured=measured,
                modelled=measured
                - _group_means(cleaned.residual[:n], intervals_per_block * steps_per_interval),
                rate=_group_means(rate, intervals_per_block),
                slope=_group_means(cleaned.slope[:n], intervals_per_block * steps_per_interval),
                time_s=middle_s.reshape(block_count, intervals_per_block).mean(axis=1),
                in_band_count=int(2.0 * fit.band_hz * block_count * intervals_per_block * step_s),
            )
        )
    return segments


def _group_means(values: FloatArray, group_size: int) -> FloatArray:
    """Return means over groups of rows, (n / group_size, 3)."""
    return np.asarray(values.reshape(-1, group_size, 3).mean(axis=1), dtype=np.float64)


def _build_whiteners(
    segments: Sequence[BlockSegment], band_hz: float
) -> tuple[NoiseModel, list[SegmentWhitener]]:
    """Return the smooth noise model, and the whitener of each segment."""
    step_s = float(np.median([np.median(np.diff(segment.time_s)) for segment in segments]))
    rate_hz = 1.0 / step_s
    sampling = Sampling(rate_hz, 1, None, 0.0, differentiated=True)
    periodograms = [
        Periodogram.of(segment.residual, rate_hz).band(0.0, band_hz) for segment in segments
    ]
    noise = fit_noise_levels(bin_spectrum(periodograms), sampling)
    power, smooth, frequency = [], [], []
    for segment in segments:
        # The constant of a series represents all frequencies below its first coefficient.
        f = (
            np.maximum(np.arange(segment.in_band_count), 0.5)
            * rate_hz
            / (2.0 * segment.block_count)
        )
        frequency.append(f)
        smooth.append(noise.density(f) * rate_hz / 2.0)
        power.append(dct(segment.residual, axis=0, norm="ortho")[: segment.in_band_count] ** 2)
    level = smooth_power(np.concatenate(power) / np.concatenate(smooth), np.concatenate(frequency))
    ends = np.cumsum([segment.in_band_count for segment in segments])[:-1]
    whiteners = []
    for segment, segment_level, nominal_level in zip(
        segments, np.split(level, ends), smooth, strict=True
    ):
        whitener = SegmentWhitener(
            np.sqrt(segment_level * nominal_level), np.ones(segment.in_band_count)
        )
        whiteners.append(_scale_by_scatter(segment, whitener))
    return noise, whiteners


def _scale_by_scatter(segment: BlockSegment, whitener: SegmentWhitener) -> SegmentWhitener:
    """Return a whitener with the local scatter of the residual as an additional weight."""
    white = whitener.whiten(segment.residual[None]).reshape(3, -1)
    power = np.mean(white**2, axis=0)
    step_s = float(segment.time_s[-1] - segment.time_s[0]) / power.size
    width = max(round(SCATTER_WINDOW_S / step_s), MIN_SCATTER_VALUES // 3)
    scatter = np.sqrt(_running_mean(power, min(width, power.size)))
    return replace(whitener, scatter=np.maximum(scatter, MIN_SCATTER))


def _running_mean(values: FloatArray, width: int) -> FloatArray:
    """Return the centred running mean, (n,); the end values continue beyond the ends."""
    before = width // 2
    padded = np.pad(values, (before, width - 1 - before), mode="edge")
    total = np.concatenate([[0.0], np.cumsum(padded)])
    return np.asarray(np.maximum(total[width:] - total[:-width], 0.0) / width, dtype=np.float64)
