"""From a fit to the document: the contract's shapes, nulls, matrices and verdict.

What to use when: `calibration_of` for any `GyroFit`. The caller says which board and
which recordings; nothing here reads a clock or a file, so the same fit gives the same
document.
"""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.calibration.document import (
    MODEL,
    Board,
    Calibration,
    Covariance,
    HeldOut,
    Level,
    Matrices,
    Matrix,
    NoiseFigure,
    Observability,
    OwnOfRecording,
    Parameter,
    Quality,
    SecondOpinion,
    SolvedInput,
    SolverRecord,
    Units,
    Validity,
)
from gyrorig_solver.calibration.trust import judge, profile_warnings
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.model.gain import factorise

ONE_CLOCK_PPM = 1e-3  # no two clocks are that near to each other; 1e-9 s in 10 s is a tenth of it
_UNITS = {"bias": "rad/s", "scale": "1", "nonorthogonality": "1", "misalignment": "rad"}
_ENTRIES = {
    "bias": ("x", "y", "z"),
    "scale": ("x", "y", "z"),
    "nonorthogonality": ("xy", "zx", "zy"),
    "misalignment": ("x", "y", "z"),
}


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a fit came from: everything of the document that the fit does not know."""

    board: Board
    inputs: Sequence[SolvedInput]
    software: str  # version of the program
    settings: Mapping[str, Any] = field(default_factory=dict)  # of the solver, JSON values

    @property
    def settings_sha256(self) -> str:
        """The digest of the settings, independent of their order."""
        return settings_sha256(self.settings)


def settings_sha256(settings: Mapping[str, Any]) -> str:
    """Return the digest of a solver's settings, independent of their order."""
    text = json.dumps(settings, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def calibration_of(
    fit: GyroFit,
    origin: Provenance,
    *,
    version: int,
    previous: str | None,
    created: str,
    profile: SensorProfile | None = None,
) -> Calibration:
    """Return the document of one fit.

    Args:
        fit: the result.
        origin: the board, the recordings and the solver's settings.
        version: counts up from 1.
        previous: `sha256:` digest of the version before, None for the first.
        created: UTC, as `2026-01-31T02:30:00Z`.
        profile: the sensor's data sheet, to warn where a value lies outside it.
    """
    config_hash = origin.board.config.config_hash
    return Calibration(
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
        observability=Observability(
            rank=int(fit.observability.rank),
            of=int(fit.observability.of),
            unobservable=list(fit.observability.unobservable),
            condition=_number(fit.observability.condition),
        ),
        noise=_noise(fit),
        quality=_quality(fit, profile, origin),
        trust=judge(fit),
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
    out = {
        name: Parameter(
            value=[_number(v) for v in values],
            std=[_number(fit.std.get(f"{name}.{part}", math.nan)) for part in _ENTRIES[name]],
            unit=_UNITS[name],
        )
        for name, values in vectors.items()
    }
    out["time_offset"] = Parameter(
        value=_number(fit.time_offset_s),
        std=_number(fit.std.get("time_offset", math.nan)),
        unit="s",
    )
    for cause in fit.causes:
        out[cause.name] = Parameter(
            value=[_number(v) for v in cause.value],
            std=[_number(v) for v in cause.std],
            unit=cause.unit,
        )
    return out


def _matrices(gain: FloatArray) -> Matrices:
    """Return the factors, as far as G is known, and G; S T M multiplies back to STM."""
    nothing: Matrix = [[None] * 3 for _ in range(3)]
    if not np.all(np.isfinite(gain)):
        return Matrices(S=nothing, T=nothing, M=nothing, STM=_matrix(gain))
    factors = factorise(gain)
    return Matrices(
        S=_matrix(factors.S), T=_matrix(factors.T), M=_matrix(factors.M), STM=_matrix(gain)
    )


def _matrix(values: FloatArray) -> Matrix:
    # + 0.0 turns -0.0 into 0.0: a sign that means nothing is not written
    return [[_number(v + 0.0) for v in row] for row in np.asarray(values)]


def _number(value: float) -> float | None:
    """Return a plain float, None for what is not a number."""
    return float(value) if math.isfinite(value) else None


def _noise(fit: GyroFit) -> dict[str, NoiseFigure]:
    if fit.noise is None:
        return {}
    figures = {
        "angle_random_walk": (fit.noise.angle_random_walk, "rad/s/sqrt(Hz)"),
        "bias_instability": (fit.noise.bias_instability, "rad/s"),
        "rate_random_walk": (fit.noise.rate_random_walk, "rad/s^2/sqrt(Hz)"),
    }
    return {
        name: NoiseFigure(value=[_number(v) for v in values], unit=unit)
        for name, (values, unit) in figures.items()
    }


def _second_opinion(fit: GyroFit) -> SecondOpinion | None:
    found = fit.extra
    if "rest_to_rest_p_value" not in found:
        return None
    return SecondOpinion(
        moves=int(found["rest_to_rest_moves"]),
        p_value=found["rest_to_rest_p_value"],
        largest_sigma=found["rest_to_rest_largest_sigma"],
    )


def _level(fit: GyroFit) -> Level | None:
    if fit.level is None:
        return None
    return Level(
        tilt_zero=fit.level.tilt_zero_rad,
        tilt_zero_std=fit.level.tilt_zero_std_rad,
        lean=list(fit.level.lean_rad),
        lean_std=list(fit.level.lean_std_rad),
        rests=fit.level.rests,
    )


def _apart(fit: GyroFit, names: Sequence[str]) -> list[OwnOfRecording]:
    return [
        OwnOfRecording(
            name=name,
            bias=[_number(v) for v in own.bias_rad_s],
            bias_std=[_number(v) for v in own.bias_std_rad_s],
            time_offset=_number(own.time_offset_s),
            time_offset_std=_number(own.time_offset_std_s),
        )
        for name, own in zip(names, fit.recordings, strict=True)
    ]


def _skew_ppm(fit: GyroFit) -> float | None:
    """Return how far the board's clock is from its host's, None where it has none of its own.

    A table with one column of times has it as both: they differ by roundings, at most 1e-9 s.
    """
    if fit.clock is None or abs(fit.clock.skew_ppm) < ONE_CLOCK_PPM:
        return None
    return _number(fit.clock.skew_ppm)


def _quality(fit: GyroFit, profile: SensorProfile | None, origin: Provenance) -> Quality:
    full_scale_dps = origin.board.config.gyro_full_scale_dps
    before, after = _number(fit.rms_before_rad_s), _number(fit.rms_after_rad_s)
    return Quality(
        reduced_chi2=_number(fit.reduced_chi2),
        held_out=(
            HeldOut(rms_before=before, rms_after=after)
            if before is not None and after is not None
            else None
        ),
        warnings=[*fit.warnings, *profile_warnings(fit, profile, full_scale_dps)],
        outliers=int(fit.outliers),
        rest_to_rest=_second_opinion(fit),
        level=_level(fit),
        recordings=_apart(fit, [i.name for i in origin.inputs]) if fit.recordings else None,
        mean_temperature_degc=fit.extra.get("mean_temperature_degc"),
        boards_together=int(many) if (many := fit.extra.get("boards_together")) else None,
        boards_on_one_clock=int(bus) if (bus := fit.extra.get("boards_on_one_clock")) else None,
        clock_moved_s=fit.extra.get("clock_moved_s"),
        clock_skew_ppm=_skew_ppm(fit),
    )
