"""Time series of the explain report: block means of one board, with base and extended model.

What to use when: `series_of_explanation` for findings from a unit's motion, `series_of_attitudes`
for findings from reference attitudes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.discover import FitExplanation, NamedCause
from gyrorig_solver.discover.attitude.explain_attitudes import AttitudeExplanation
from gyrorig_solver.estimate import (
    ConvergedFit,
    FittedTerm,
    Periodogram,
    SessionFit,
    bin_spectrum,
    total_effect,
)
from gyrorig_solver.estimate.session_noise import session_periodograms
from gyrorig_solver.findings import figure_key
from gyrorig_solver.model import SignalState

GAP_BETWEEN_RECORDINGS_S = 1.0  # shown between two recordings


@dataclass(frozen=True, slots=True, eq=False)
class ReportSeries:
    """All recordings of a board in sequence; nan where a block is not used."""

    time_s: FloatArray  # (n,), of all recordings in sequence
    measured_rad_s: FloatArray  # (n, 3)
    base_rad_s: FloatArray  # (n, 3), rate of the base model
    extended_rad_s: FloatArray  # (n, 3), rate of the base model with the named causes
    rate_rad_s: FloatArray  # (n, 3), of the stage
    angle_rad: FloatArray  # (2, n), pan and tilt; nan where there are none
    temperature_degc: FloatArray  # (n,)
    effects: Mapping[str, FloatArray]  # (n, 3), of each named cause alone, by key
    frequency_hz: FloatArray  # (k,)
    spectrum_base: FloatArray  # (k, 3), (rad/s)^2/Hz
    spectrum_extended: FloatArray  # (k, 3)
    spectrum_model: FloatArray  # (k, 3), the noise model
    unnamed_rad_s: FloatArray | None = None  # (n, 3), effects that were fitted without a name

    @property
    def base_residual_rad_s(self) -> FloatArray:
        """Measured minus base model."""
        return self.measured_rad_s - self.base_rad_s

    @property
    def extended_residual_rad_s(self) -> FloatArray:
        """Measured minus extended model."""
        return self.measured_rad_s - self.extended_rad_s

    @property
    def unexplained_residual_rad_s(self) -> FloatArray:
        """Measured minus the base model and the named causes."""
        residual = self.extended_residual_rad_s
        return residual if self.unnamed_rad_s is None else residual + self.unnamed_rad_s

    def residual_without(self, key: str) -> FloatArray:
        """Measured minus the extended model without one cause, (n, 3)."""
        return self.extended_residual_rad_s + self.effects[key]


@dataclass(frozen=True, slots=True, eq=False)
class _SeriesSegment:
    time_s: FloatArray
    measured: FloatArray
    base: FloatArray
    extended: FloatArray
    rate: FloatArray
    angle: FloatArray
    temperature: FloatArray
    effects: Sequence[FloatArray]


def series_of_explanation(explained: FitExplanation) -> ReportSeries:
    """Return the arrays for the figures of the findings."""
    causes = explained.findings.causes
    base, extended = explained.solution_base, explained.solution_extended
    all_segments, begin_s = [], 0.0
    for base_session, extended_session in zip(base.sessions, extended.sessions, strict=True):
        segments = _segments(base_session, extended_session, base, extended, causes, begin_s)
        all_segments += segments
        begin_s = float(segments[-1].time_s[-1]) + GAP_BETWEEN_RECORDINGS_S
    base_spectrum, extended_spectrum = (
        bin_spectrum(
            [p for session in fit.sessions for p in session_periodograms(session, fit.gain)[0]],
            fit.sessions[-1].sampling,
        )
        for fit in (base, extended)
    )
    return ReportSeries(
        time_s=np.concatenate([p.time_s for p in all_segments]),
        measured_rad_s=np.concatenate([p.measured for p in all_segments]),
        base_rad_s=np.concatenate([p.base for p in all_segments]),
        extended_rad_s=np.concatenate([p.extended for p in all_segments]),
        rate_rad_s=np.concatenate([p.rate for p in all_segments]),
        angle_rad=np.concatenate([p.angle for p in all_segments], axis=1),
        temperature_degc=np.concatenate([p.temperature for p in all_segments]),
        effects={
            figure_key(cause): np.concatenate([p.effects[k] for p in all_segments])
            for k, cause in enumerate(causes)
        },
        frequency_hz=base_spectrum.frequency_hz,
        spectrum_base=base_spectrum.density,
        spectrum_extended=_density_at(
            base_spectrum.frequency_hz, extended_spectrum.frequency_hz, extended_spectrum.density
        ),
        spectrum_model=replace(base_spectrum, white_power=None).expected_density(
            extended.noises[-1]
        ),
    )


def series_of_attitudes(explanation: AttitudeExplanation) -> ReportSeries:
    """Return the arrays for the figures of findings from reference attitudes.

    All signals are in the band of the comparison; recordings and segments are in sequence.
    """
    space, causes = explanation.space.projector(), explanation.findings.causes
    named_indices = [
        k for k, term in enumerate(space.fitted_terms) if term in explanation.findings.fitted_terms
    ]
    unnamed_terms = [term for k, term in enumerate(space.fitted_terms) if k not in named_indices]
    before, after = space.residual_without(named_indices), space.residual_without()
    effects = {
        figure_key(cause): np.concatenate(space.band_signal(partial(_term_effect, cause.extension)))
        for cause in causes
    }
    measured = np.concatenate(
        [segment.modelled + segment.effect for segment in space.block_segments]
    ) + np.concatenate(after)
    base = measured - np.concatenate(before)
    n, begin_s, time_s = base.shape[0], 0.0, []
    for segment in space.block_segments:
        time_s.append(segment.time_s - segment.time_s[0] + begin_s)
        begin_s = float(time_s[-1][-1]) + GAP_BETWEEN_RECORDINGS_S
    rate_hz = 1.0 / float(np.median(np.diff(space.block_segments[0].time_s)))
    spectra = [
        bin_spectrum([Periodogram.of(r, rate_hz).band(0.0, space.band_hz) for r in residuals])
        for residuals in (before, after)
    ]
    frequency_hz = spectra[0].frequency_hz
    return ReportSeries(
        time_s=np.concatenate(time_s),
        measured_rad_s=measured,
        base_rad_s=base,
        extended_rad_s=measured - np.concatenate(after),
        rate_rad_s=np.concatenate([segment.rate for segment in space.block_segments]),
        angle_rad=np.full((2, n), np.nan),
        temperature_degc=np.full(n, np.nan),
        effects=effects,
        frequency_hz=frequency_hz,
        spectrum_base=spectra[0].density,
        spectrum_extended=_density_at(frequency_hz, spectra[1].frequency_hz, spectra[1].density),
        spectrum_model=space.density(frequency_hz),
        unnamed_rad_s=sum(
            (
                np.concatenate(space.band_signal(partial(_term_effect, term)))
                for term in unnamed_terms
            ),
            np.zeros((n, 3)),
        ),
    )


def _term_effect(term: FittedTerm, state: SignalState) -> FloatArray:
    return total_effect((term,), state)[None]


def _segments(
    base: SessionFit,
    extended: SessionFit,
    base_solution: ConvergedFit,
    extended_solution: ConvergedFit,
    causes: Sequence[NamedCause],
    begin_s: float,
) -> list[_SeriesSegment]:
    segments: list[_SeriesSegment] = []
    first_s = float(base.series[0].time_s[0])
    base_residuals = base.residuals(base_solution.gain)
    extended_residuals = extended.residuals(extended_solution.gain)
    for k, series in enumerate(base.series):
        use, has_residual = extended.used[k], base.used[k] & extended.used[k]
        time_s = series.block_times_s()
        scenes = [
            extended.signal_state(series, part, extended_solution.gain)
            for part in series.part_slices()
        ]
        effects = [
            np.concatenate([total_effect((c.extension,), s) for s in scenes]) for c in causes
        ]
        after = extended.measured[k] - extended_residuals[k]
        # The base model has no residual where it rejected an outlier. There, the extended
        # model without the causes is used.
        before = np.where(
            has_residual[:, None], base.measured[k] - base_residuals[k], after - sum(effects)
        )
        segments.append(
            _SeriesSegment(
                time_s=time_s - first_s + begin_s,
                measured=_masked(extended.measured[k], use),
                base=_masked(before, use),
                extended=_masked(after, use),
                rate=_masked(extended.rates[k], use),
                angle=_angles(extended, time_s),
                temperature=_temperature(scenes[0], time_s),
                effects=[_masked(effect, use) for effect in effects],
            )
        )
    return segments


def _masked(values: FloatArray, use: BoolArray) -> FloatArray:
    return np.where(use[:, None], values, np.nan)


def _angles(session: SessionFit, time_s: FloatArray) -> FloatArray:
    angles_at = getattr(session.reference, "angles_rad", None)
    if angles_at is None:
        return np.full((2, time_s.size), np.nan)
    return np.asarray(angles_at(time_s - session.time_offset_s), dtype=np.float64)


def _temperature(scene: SignalState, time_s: FloatArray) -> FloatArray:
    temperature = scene.context.temperature
    if temperature is None:
        return np.full(time_s.size, np.nan)
    return np.asarray(
        temperature.die_temperature_rise(time_s) + temperature.mean_degc, dtype=np.float64
    )


def _density_at(wanted_hz: FloatArray, known_hz: FloatArray, density: FloatArray) -> FloatArray:
    """Return a density at other frequencies, interpolated in both logarithms."""
    logs = [
        np.interp(np.log(wanted_hz), np.log(known_hz), np.log(np.maximum(column, 1e-30)))
        for column in density.T
    ]
    return np.asarray(np.exp(np.stack(logs, axis=1)), dtype=np.float64)
