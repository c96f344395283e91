"""Builder of the calibration document from a fit: values, nulls, matrices and verdict.

What to use when: `build_calibration` for any `GyroFit`. The caller provides board and recordings.
This module reads neither a clock nor a file, therefore the same fit gives the same document.
"""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.calibration.calibration_document import (
    MODEL,
    BoardRecord,
    CalibrationDocument,
    Covariance,
    HeldOut,
    LevelRecord,
    Matrices,
    Matrix,
    NoiseFigure,
    ObservabilityRecord,
    Parameter,
    Quality,
    RecordingParameters,
    RestToRestCheck,
    SolvedInput,
    SolverRecord,
    Units,
    Validity,
)
from gyrorig_solver.calibration.verdict import judge_fit, profile_warnings
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.model import factorise

SAME_CLOCK_PPM = (
    1e-3  # closer rates mean the same clock: rounding to 1e-9 s in 10 s is a tenth of it
)
_UNITS = {"bias": "rad/s", "scale": "1", "nonorthogonality": "1", "misalignment": "rad"}
_ENTRIES = {
    "bias": ("x", "y", "z"),
    "scale": ("x", "y", "z"),
    "nonorthogonality": ("xy", "zx", "zy"),
    "misalignment": ("x", "y", "z"),
}


@dataclass(frozen=True, slots=True)
class Provenance:
    """Provenance of a fit: the parts of the document that are not in the fit."""

    board: BoardRecord
    inputs: Sequence[SolvedInput]
    software: str  # version of the program
    settings: Mapping[str, Any] = field(default_factory=dict)  # of the solver, JSON values

    @property
    def settings_sha256(self) -> str:
        """Digest of the settings, independent of their order."""
        return settings_sha256(self.settings)


def settings_sha256(settings: Mapping[str, Any]) -> str:
    """Return the digest of a solver's settings, independent of their order."""
    text = json.dumps(settings, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def build_calibration(
    fit: GyroFit,
    origin: Provenance,
    *,
    version: int,
    previous: str | None,
    created: str,
    profile: SensorProfile | None = None,
) -> CalibrationDocument:
    """Return the document of one fit.

    Args:
        fit: the result.
        origin: board, recordings and settings of the solver.
        version: counts up from 1.
        previous: `sha256:` digest of the previous version, None for the first.
        created: UTC, as `2026-01-31T02:30:00Z`.
        profile: the sensor's data sheet, to warn of values outside it.
    """
    config_hash = origin.board.config.config_hash
    return CalibrationDocument(
        schema="gyrorig/calibration/1",
        board=origin.board,
        version=version,
        previous=previous,
        created=created,
        inputs=list(origin.inputs),
        solver=SolverRecord(
            version=origin.software,
            method=fit.method,
            terms=list(fit.terms),
            config_sha256=origin.settings_sha256,
        ),
        units=Units(),
        model=MODEL,
        parameters=_parameters(fit),
        matrices=_matrices(fit.gain),
        covariance=Covariance(
            order=list(fit.order),
            matrix=[[float(v) for v in row] for row in np.asarray(fit.covariance)],
        ),
        observability=ObservabilityRecord(
            rank=int(fit.observability.rank),
            of=int(fit.observability.of),
            unobservable=list(fit.observability.unobservable),
            condition=_finite_or_none(fit.observability.condition),
        ),
        noise=_noise(fit),
        quality=_quality(fit, profile, origin),
        trust=judge_fit(fit),
        validity=Validity(
            rate_rad_s=[float(v) for v in fit.rate_range_rad_s],
            temperature_degc=(
                [float(v) for v in fit.temperature_range_degc]
                if fit.temperature_range_degc is not None
                else None
            ),
            config_hash=config_hash,
        ),
    )


def _parameters(fit: GyroFit) -> dict[str, Parameter]:
    vectors = {
        "bias": fit.bias_rad_s,
        "scale": fit.scale,
        "nonorthogonality": fit.nonorthogonality,
        "misalignment": fit.misalignment_rad,
    }
    parameters = {
        name: Parameter(
            value=[_finite_or_none(number) for number in values],
            std=[
                _finite_or_none(fit.std.get(f"{name}.{entry}", math.nan))
                for entry in _ENTRIES[name]
            ],
            unit=_UNITS[name],
        )
        for name, values in vectors.items()
    }
    parameters["time_offset"] = Parameter(
        value=_finite_or_none(fit.time_offset_s),
        std=_finite_or_none(fit.std.get("time_offset", math.nan)),
        unit="s",
    )
    for cause in fit.causes:
        parameters[cause.name] = Parameter(
            value=[_finite_or_none(number) for number in cause.value],
            std=[_finite_or_none(number) for number in cause.std],
            unit=cause.unit,
        )
    return parameters


def _matrices(gain: FloatArray) -> Matrices:
    """Return the factors of G, if it is known, and G."""
    unknown: Matrix = [[None] * 3 for _ in range(3)]
    if not np.all(np.isfinite(gain)):
        return Matrices(S=unknown, T=unknown, M=unknown, STM=_matrix(gain))
    factors = factorise(gain)
    return Matrices(
        S=_matrix(factors.S), T=_matrix(factors.T), M=_matrix(factors.M), STM=_matrix(gain)
    )


def _matrix(values: FloatArray) -> Matrix:
    # + 0.0 turns -0.0 into 0.0
    return [[_finite_or_none(v + 0.0) for v in row] for row in np.asarray(values)]


def _finite_or_none(value: float) -> float | None:
    """Return a finite number as a float, None for any other."""
    return float(value) if math.isfinite(value) else None


def _noise(fit: GyroFit) -> dict[str, NoiseFigure]:
    if fit.noise is None:
        return {}
    figures = {
        "angle_random_walk": (fit.noise.angle_random_walk, "rad/s/sqrt(Hz)"),
        "bias_instability": (fit.noise.bias_instability, "rad/s"),
        "rate_random_walk": (fit.noise.rate_random_walk, "rad/s^2/sqrt(Hz)"),
        **{
            f"angle_random_walk_{state}": (white, "rad/s/sqrt(Hz)")
            for state, white in fit.noise.white_by_motor_state.items()
        },
    }
    return {
        name: NoiseFigure(value=[_finite_or_none(v) for v in values], unit=unit)
        for name, (values, unit) in figures.items()
    }


def _rest_to_rest_check(fit: GyroFit) -> RestToRestCheck | None:
    check = fit.rest_to_rest
    if check is None:
        return None
    return RestToRestCheck(check.moves, check.p_value, check.largest_sigma)


def _level(fit: GyroFit) -> LevelRecord | None:
    if fit.level is None:
        return None
    return LevelRecord(
        tilt_zero=fit.level.tilt_zero_rad,
        tilt_zero_std=fit.level.tilt_zero_std_rad,
        lean=list(fit.level.lean_rad),
        lean_std=list(fit.level.lean_std_rad),
        rests=fit.level.rests,
    )


def _recording_parameters(fit: GyroFit, names: Sequence[str]) -> list[RecordingParameters]:
    return [
        RecordingParameters(
            name=name,
            bias=[_finite_or_none(v) for v in recording.bias_rad_s],
            bias_std=[_finite_or_none(v) for v in recording.bias_std_rad_s],
            time_offset=_finite_or_none(recording.time_offset_s),
            time_offset_std=_finite_or_none(recording.time_offset_std_s),
        )
        for name, recording in zip(names, fit.recordings, strict=True)
    ]


def _clock_skew_ppm(fit: GyroFit) -> float | None:
    """Return the frequency offset of the board's clock, None if it uses the host's clock.

    A table with one column of times uses it for both clocks; they differ by rounding only.
    """
    if fit.clock is None or abs(fit.clock.skew_ppm) < SAME_CLOCK_PPM:
        return None
    return _finite_or_none(fit.clock.skew_ppm)


def _quality(fit: GyroFit, profile: SensorProfile | None, origin: Provenance) -> Quality:
    full_scale_dps = origin.board.config.gyro_full_scale_dps
    before, after = _finite_or_none(fit.rms_before_rad_s), _finite_or_none(fit.rms_after_rad_s)
    return Quality(
        reduced_chi2=_finite_or_none(fit.reduced_chi2),
        held_out=(
            HeldOut(rms_before=before, rms_after=after)
            if before is not None and after is not None
            else None
        ),
        warnings=[*fit.warnings, *profile_warnings(fit, profile, full_scale_dps)],
        outliers=int(fit.outliers),
        rest_to_rest=_rest_to_rest_check(fit),
        level=_level(fit),
        recordings=_recording_parameters(fit, [recording.name for recording in origin.inputs])
        if fit.recordings
        else None,
        mean_temperature_degc=fit.mean_temperature_degc,
        boards_together=fit.sharing.fitted_together,
        boards_on_one_clock=fit.sharing.on_one_clock,
        clock_moved_s=fit.sharing.clock_change_s,
        clock_skew_ppm=_clock_skew_ppm(fit),
    )
