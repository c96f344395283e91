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

from gyrorig_protocol.documents import document_part, finite_values
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
from gyrorig_solver.calibration.temperature_record import (
    CurveRecord,
    HysteresisRecord,
    TemperaturePoint,
    TemperatureRecord,
)
from gyrorig_solver.calibration.verdict import judge_fit, mirror_warnings, profile_warnings
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import GyroFit, TemperatureFit
from gyrorig_solver.estimate.fit_summary import SAME_CLOCK_PPM
from gyrorig_solver.estimate.gyro_fit import RecordingFit
from gyrorig_solver.model import PARAMETER_GROUPS, LevelEstimate, factorise

UNKNOWN: Matrix = [[None] * 3] * 3
_UNITS = {"bias": "rad/s", "scale": "1", "nonorthogonality": "1", "misalignment": "rad"}


@dataclass(frozen=True, slots=True)
class Provenance:
    """Provenance of a fit: the parts of the document that are not in the fit."""

    board: BoardRecord
    inputs: Sequence[SolvedInput]
    software: str  # version of the program
    created: str  # UTC, as 2026-01-31T02:30:00Z
    settings: Mapping[str, Any] = field(default_factory=dict)  # of the solver, JSON values

    def solver_record(self, method: str, terms: Sequence[str]) -> SolverRecord:
        """Return the document's entry of the solver."""
        return SolverRecord(self.software, method, list(terms), settings_sha256(self.settings))


def settings_sha256(settings: Mapping[str, Any]) -> str:
    """Return the digest of a solver's settings, independent of their order."""
    text = json.dumps(settings, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def build_calibration(
    fit: GyroFit, origin: Provenance, profile: SensorProfile | None = None
) -> CalibrationDocument:
    """Return the document of one fit, as a first version."""
    return CalibrationDocument(
        schema="gyrorig/calibration/1",
        board=origin.board,
        version=1,
        created=origin.created,
        inputs=list(origin.inputs),
        solver=origin.solver_record(fit.method, fit.terms),
        units=Units(),
        model=MODEL,
        parameters=_parameters(fit),
        matrices=_matrices(fit.gain),
        covariance=Covariance(order=list(fit.order), matrix=np.asarray(fit.covariance).tolist()),
        observability=document_part(ObservabilityRecord, fit.observability),
        noise=_noise(fit),
        quality=_quality(fit, profile, origin),
        trust=judge_fit(fit),
        validity=Validity(
            rate_rad_s=finite_values(fit.rate_range_rad_s),
            temperature_degc=finite_values(fit.temperature_range_degc),
            config_hash=origin.board.config.config_hash,
        ),
        temperature=None if fit.temperature is None else temperature_record(fit),
    )


def temperature_record(fit: GyroFit) -> TemperatureRecord | None:
    """Return the document's section on the bias against the temperature."""
    curve_fit = fit.temperature
    if curve_fit is None:
        return None
    hysteresis = curve_fit.hysteresis
    return TemperatureRecord(
        source=fit.reference,
        reference_degc=curve_fit.reference_degc,
        range_degc=list(curve_fit.range_degc),
        bias=curve_record(curve_fit, "rad/s"),
        lag_s=curve_fit.lag_s,
        lag_std_s=curve_fit.lag_std_s or None,
        hysteresis=None
        if hysteresis is None
        else HysteresisRecord(
            width=hysteresis.width.tolist(),
            std=hysteresis.std.tolist(),
            p_value=hysteresis.p_value,
            fitted=hysteresis.is_fitted,
        ),
        repeatability=None if np.isnan(curve_fit.run_std).any() else curve_fit.run_std.tolist(),
        points=[
            TemperaturePoint(round(point.temperature_degc, 3), point.value.tolist(), point.heating)
            for point in curve_fit.points
        ],
    )


def curve_record(curve_fit: TemperatureFit, unit: str) -> CurveRecord:
    """Return the document's entry of one curve."""
    curve = curve_fit.curve
    return CurveRecord(
        kind="spline" if curve.knots_degc.size else "polynomial",
        unit=unit,
        coefficients=curve.coefficients.tolist(),
        covariance=curve_fit.covariance.tolist(),
        knots_degc=curve.knots_degc.tolist(),
        knot_coefficients=curve.knot_coefficients.tolist(),
    )


def _parameters(fit: GyroFit) -> dict[str, Parameter]:
    vectors = {
        "bias": fit.bias_rad_s,
        "scale": fit.scale,
        "nonorthogonality": fit.nonorthogonality,
        "misalignment": fit.misalignment_rad,
    }
    labels = {group.name: group.labels for group in PARAMETER_GROUPS}
    parameters = {
        name: Parameter(
            value=finite_values(values),
            std=finite_values([fit.std.get(f"{name}.{label}", math.nan) for label in labels[name]]),
            unit=_UNITS[name],
        )
        for name, values in vectors.items()
    }
    parameters["time_offset"] = Parameter(
        value=finite_values(fit.time_offset_s),
        std=finite_values(fit.std.get("time_offset", math.nan)),
        unit="s",
    )
    for cause in fit.causes:
        parameters[cause.name] = document_part(Parameter, cause)
    return parameters


def _matrices(gain: FloatArray) -> Matrices:
    """Return the factors of G, if it is known, and G."""
    if not np.all(np.isfinite(gain)):
        return Matrices(S=UNKNOWN, T=UNKNOWN, M=UNKNOWN, STM=finite_values(gain))
    return document_part(Matrices, factorise(gain), STM=gain)


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
    if fit.noise.noise_floor is not None:
        figures["noise_floor"] = (fit.noise.noise_floor, "rad/s/sqrt(Hz)")
    return {
        name: NoiseFigure(value=finite_values(values), unit=unit)
        for name, (values, unit) in figures.items()
    }


def level_record(level: LevelEstimate) -> LevelRecord:
    """Return the document's entry of the unit's leveling."""
    return document_part(
        LevelRecord,
        level,
        tilt_zero=level.offset_rad,
        tilt_zero_std=level.offset_std_rad,
        lean=level.lean_rad,
        lean_std=level.lean_std_rad,
    )


def _recording_parameters(name: str, recording: RecordingFit) -> RecordingParameters:
    return document_part(
        RecordingParameters,
        recording,
        name=name,
        bias=recording.bias_rad_s,
        bias_std=recording.bias_std_rad_s,
        time_offset=recording.time_offset_s,
        time_offset_std=recording.time_offset_std_s,
    )


def _clock_skew_ppm(fit: GyroFit) -> float | None:
    """Return the frequency offset of the board's clock, None if it uses the host's clock.

    A table with one column of times uses it for both clocks; they differ by rounding only.
    """
    if fit.clock is None or abs(fit.clock.skew_ppm) < SAME_CLOCK_PPM:
        return None
    skew_ppm: float | None = finite_values(fit.clock.skew_ppm)
    return skew_ppm


def _quality(fit: GyroFit, profile: SensorProfile | None, origin: Provenance) -> Quality:
    full_scale_dps = origin.board.config.gyro_full_scale_dps
    check = fit.rest_to_rest
    rms = finite_values([fit.rms_before_rad_s, fit.rms_after_rad_s])
    names = [recording.name for recording in origin.inputs]
    return Quality(
        reduced_chi2=finite_values(fit.reduced_chi2),
        held_out=None if None in rms else HeldOut(*rms),
        warnings=[
            *fit.warnings,
            *mirror_warnings(fit),
            *profile_warnings(fit, profile, full_scale_dps),
        ],
        outliers=int(fit.outliers),
        rest_to_rest=None if check is None else document_part(RestToRestCheck, check),
        level=None if fit.level is None else level_record(fit.level),
        recordings=list(map(_recording_parameters, names, fit.recordings)) or None,
        mean_temperature_degc=fit.mean_temperature_degc,
        boards_together=fit.sharing.fitted_together,
        boards_on_one_clock=fit.sharing.on_one_clock,
        clock_moved_s=fit.sharing.clock_change_s,
        clock_skew_ppm=_clock_skew_ppm(fit),
    )
