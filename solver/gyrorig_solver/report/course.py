"""What an explain report draws from: one board's block means beside both models.

What to use when: `course_of` on what a search for causes found, `course_of_attitudes` on one
beside reference attitudes; `course_of_fit` on a fit that no cause was looked for in.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.discover.attitude import AttitudeExplained
from gyrorig_solver.discover.result import Explained, NamedCause
from gyrorig_solver.estimate.chain import effect_of
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.noise import Periodogram, binned
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.estimate.session import SessionFit
from gyrorig_solver.findings.build import figure_key
from gyrorig_solver.model.terms.scene import Scene

BETWEEN_S = 1.0  # drawn between two recordings


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """All recordings of a board one after the other; nan where a block is not used."""

    time_s: FloatArray  # (n,), of all recordings, one after the other
    measured_rad_s: FloatArray  # (n, 3)
    base_rad_s: FloatArray  # (n, 3), what the base model says
    extended_rad_s: FloatArray  # (n, 3), what the base model and the named causes say
    rate_rad_s: FloatArray  # (n, 3), of the stage
    angle_rad: FloatArray  # (2, n), pan and tilt; nan where there are none
    temperature_degc: FloatArray  # (n,)
    effects: Mapping[str, FloatArray]  # (n, 3) of each named cause by its key, by itself
    frequency_hz: FloatArray  # (k,)
    spectrum_base: FloatArray  # (k, 3), (rad/s)^2/Hz
    spectrum_extended: FloatArray  # (k, 3)
    spectrum_model: FloatArray  # (k, 3), the noise assumed
    unnamed_rad_s: FloatArray | None = None  # (n, 3), what was fitted, but has no name

    @property
    def left_base_rad_s(self) -> FloatArray:
        """Measured minus base model."""
        return self.measured_rad_s - self.base_rad_s

    @property
    def left_extended_rad_s(self) -> FloatArray:
        """Measured minus extended model."""
        return self.measured_rad_s - self.extended_rad_s

    @property
    def unexplained_rad_s(self) -> FloatArray:
        """Measured minus what has a name."""
        left = self.left_extended_rad_s
        return left if self.unnamed_rad_s is None else left + self.unnamed_rad_s

    def without(self, key: str) -> FloatArray:
        """Measured minus all of the extended model but one cause, (n, 3)."""
        return self.left_extended_rad_s + self.effects[key]


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """One series of one recording."""

    time_s: FloatArray
    measured: FloatArray
    base: FloatArray
    extended: FloatArray
    rate: FloatArray
    angle: FloatArray
    temperature: FloatArray
    effects: Sequence[FloatArray]


def course_of(explained: Explained) -> Course:
    """Return the arrays for the pictures of what was found."""
    causes = explained.findings.causes
    base, extended = explained.solution_base, explained.solution_extended
    pieces, begin_s = [], 0.0
    for one, other in zip(base.sessions, extended.sessions, strict=True):
        found = _pieces(one, other, base, extended, causes, begin_s)
        pieces += found
        begin_s = float(found[-1].time_s[-1]) + BETWEEN_S
    pooled = [session.periodograms(base.gain)[0] for session in base.sessions]
    lower = [session.periodograms(extended.gain)[0] for session in extended.sessions]
    spectrum = binned([p for own in pooled for p in own])
    after = binned([p for own in lower for p in own])
    return Course(
        time_s=np.concatenate([p.time_s for p in pieces]),
        measured_rad_s=np.concatenate([p.measured for p in pieces]),
        base_rad_s=np.concatenate([p.base for p in pieces]),
        extended_rad_s=np.concatenate([p.extended for p in pieces]),
        rate_rad_s=np.concatenate([p.rate for p in pieces]),
        angle_rad=np.concatenate([p.angle for p in pieces], axis=1),
        temperature_degc=np.concatenate([p.temperature for p in pieces]),
        effects={
            figure_key(cause.cause, cause.where): np.concatenate([p.effects[k] for p in pieces])
            for k, cause in enumerate(causes)
        },
        frequency_hz=spectrum.frequency_hz,
        spectrum_base=spectrum.density,
        spectrum_extended=_at(spectrum.frequency_hz, after.frequency_hz, after.density),
        spectrum_model=extended.noises[-1].density(spectrum.frequency_hz),
    )


def course_of_fit(fit: GyroFit) -> Course | None:
    """Return the arrays for the pictures of a fit without causes, None where it keeps none."""
    data = fit.diagnostics
    if data is None:
        return None
    n, says = data.time_s.size, data.rate_rad_s - data.residual_rad_s
    return Course(
        time_s=data.time_s - data.time_s[0],
        measured_rad_s=data.rate_rad_s,
        base_rad_s=says,
        extended_rad_s=says,
        rate_rad_s=data.reference_rad_s,
        angle_rad=np.full((2, n), np.nan) if data.angle_rad is None else data.angle_rad,
        temperature_degc=np.full(n, np.nan),
        effects={},
        frequency_hz=data.frequency_hz,
        spectrum_base=data.spectrum,
        spectrum_extended=data.spectrum,
        spectrum_model=data.spectrum_model,
    )


def course_of_attitudes(found: AttitudeExplained) -> Course:
    """Return the arrays for the pictures of what was found beside reference attitudes.

    Everything is in the band that was compared; recordings and stretches follow each other.
    """
    space, causes = found.space, found.findings.causes
    named = [k for k, one in enumerate(space.extensions) if one in found.findings.extensions]
    nameless = [one for k, one in enumerate(space.extensions) if k not in named]
    before, after = space.remaining(named), space.remaining()
    effects = {
        figure_key(cause.cause, cause.where): np.concatenate(
            space.in_band(partial(_effect, cause.extension))
        )
        for cause in causes
    }
    measured = np.concatenate([one.modelled for one in space.pieces]) + np.concatenate(before)
    base = measured - np.concatenate(before)
    n, begin_s, time_s = base.shape[0], 0.0, []
    for one in space.pieces:
        time_s.append(one.time_s - one.time_s[0] + begin_s)
        begin_s = float(time_s[-1][-1]) + BETWEEN_S
    rate_hz = 1.0 / float(np.median(np.diff(space.pieces[0].time_s)))
    spectra = [
        binned([Periodogram.of(r, rate_hz).between(0.0, space.band_hz) for r in left])
        for left in (before, after)
    ]
    at = spectra[0].frequency_hz
    return Course(
        time_s=np.concatenate(time_s),
        measured_rad_s=measured,
        base_rad_s=base,
        extended_rad_s=measured - np.concatenate(after),
        rate_rad_s=np.concatenate([one.rate for one in space.pieces]),
        angle_rad=np.full((2, n), np.nan),
        temperature_degc=np.full(n, np.nan),
        effects=effects,
        frequency_hz=at,
        spectrum_base=spectra[0].density,
        spectrum_extended=_at(at, spectra[1].frequency_hz, spectra[1].density),
        spectrum_model=space.density(at),
        unnamed_rad_s=sum(
            (np.concatenate(space.in_band(partial(_effect, one))) for one in nameless),
            np.zeros((n, 3)),
        ),
    )


def _effect(extension: Extension, scene: Scene) -> FloatArray:
    return effect_of((extension,), scene)[None]


def _pieces(
    base: SessionFit,
    extended: SessionFit,
    one: Solution,
    other: Solution,
    causes: Sequence[NamedCause],
    begin_s: float,
) -> list[_Piece]:
    found: list[_Piece] = []
    first_s = float(base.series[0].time_s[0])
    left, lower = base.residuals(one.gain), extended.residuals(other.gain)
    for k, series in enumerate(base.series):
        use, kept = extended.used[k], base.used[k] & extended.used[k]
        time_s = series.block_times_s()
        scenes = [extended.scene(series, part, other.gain) for part in series.parts()]
        effects = [np.concatenate([effect_of((c.extension,), s) for s in scenes]) for c in causes]
        after = extended.measured[k] - lower[k]
        # What the base model takes for a spike it has no residual for; there it is what the
        # extended one says without the causes.
        before = np.where(kept[:, None], base.measured[k] - left[k], after - sum(effects))
        found.append(
            _Piece(
                time_s=time_s - first_s + begin_s,
                measured=_used(extended.measured[k], use),
                base=_used(before, use),
                extended=_used(after, use),
                rate=_used(extended.rates[k], use),
                angle=_angles(extended, time_s),
                temperature=_temperature(scenes[0], time_s),
                effects=[_used(effect, use) for effect in effects],
            )
        )
    return found


def _used(values: FloatArray, use: BoolArray) -> FloatArray:
    return np.where(use[:, None], values, np.nan)


def _angles(session: SessionFit, time_s: FloatArray) -> FloatArray:
    of = getattr(session.reference, "angles_rad", None)
    if of is None:
        return np.full((2, time_s.size), np.nan)
    return np.asarray(of(time_s - session.time_offset_s), dtype=np.float64)


def _temperature(scene: Scene, time_s: FloatArray) -> FloatArray:
    known = scene.setting.temperature
    if known is None:
        return np.full(time_s.size, np.nan)
    return np.asarray(known.at(time_s) + known.mean_degc, dtype=np.float64)


def _at(wanted: FloatArray, known: FloatArray, density: FloatArray) -> FloatArray:
    """Return a density at other frequencies, straight in both logarithms."""
    logs = [
        np.interp(np.log(wanted), np.log(known), np.log(np.maximum(column, 1e-30)))
        for column in density.T
    ]
    return np.asarray(np.exp(np.stack(logs, axis=1)), dtype=np.float64)
