"""The paper's method on a recording, and its result as a document.

For comparison only. What the method gives as printed stands in the document as far as
the contract has a place for it; everything else is null and named, with the reason.
"""

import math

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import EventKind, PtuStatus
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.calibration.build import Provenance
from gyrorig_solver.calibration.document import (
    Calibration,
    Covariance,
    Matrices,
    Matrix,
    Observability,
    Parameter,
    Quality,
    SolverRecord,
    Trust,
    Units,
    Validity,
)
from gyrorig_solver.estimate.paper import FAILURES, PaperResult, calibrate_as_printed
from gyrorig_solver.model.gain import rotation_vector
from gyrorig_solver.reference.ptu_recording import OUT_OF_STEP
from gyrorig_solver.samples import GyroSamples

_EXACT = 1e-9  # S T M and STM agree, and M is a rotation, to this: the contract's own bound


def solve_as_printed(recording: Recording, board: BoardId, samples: GyroSamples) -> PaperResult:
    """Return what eq. 6 to 12 make of one board of one recording.

    Raises:
        InputError: the recording has no positions of a pan-tilt unit, or no motion.
    """
    if "/ptu/position" not in recording.topics:
        raise InputError(
            f"{recording.path.name} has no pan-tilt unit in it",
            "the paper's method needs its angles: use --method likelihood",
        )
    time_s, pan, tilt, span = _angles(recording, samples)
    inside = samples.good & (time_s >= span[0]) & (time_s <= span[1])
    inside[1:] &= np.diff(time_s) > 0.0
    try:
        return calibrate_as_printed(
            time_s[inside],
            samples.rate_rad_s[inside],
            pan[inside],
            tilt[inside],
            _static(recording, samples)[inside],
        )
    except ValueError as fault:
        raise InputError(
            f"the paper's method cannot use board {board}, {fault}",
            "record a program with rests and moves, such as survey-40, or use --method likelihood",
        ) from fault


def paper_calibration_of(
    result: PaperResult,
    rate_range_rad_s: tuple[float, float],
    origin: Provenance,
    *,
    version: int,
    previous: str | None,
    created: str,
) -> Calibration:
    """Return the document of the paper's result."""
    matrices = _matrices(result)
    known = matrices.S[0][0] is not None
    parameters = _parameters(result, known)
    unobservable = [
        f"{name}.{part}"
        for name, parts in _PARTS.items()
        if name != "bias" and parameters[name].value == [None] * 3
        for part in parts
    ] + ["time_offset"]
    return Calibration(
        schema="gyrorig/calibration/1",
        board=origin.board,
        version=version,
        previous=previous,
        created=created,
        inputs=list(origin.inputs),
        solver=SolverRecord(
            version=origin.software,
            method="paper",
            terms=["bias", "scale", "nonorthogonality", "misalignment"],
            config_sha256=origin.settings_sha256,
        ),
        units=Units(),
        model="y = S T M u + b t, angles: the paper's eq. 6 to 12 as printed",
        parameters=parameters,
        matrices=matrices,
        covariance=Covariance(order=[], matrix=[]),
        observability=Observability(
            rank=13 - len(unobservable), of=12, unobservable=unobservable, condition=None
        ),
        noise={},
        quality=Quality(
            reduced_chi2=None,
            warnings=["the paper's method gives no standard deviations and no time offset"],
        ),
        trust=Trust(
            verdict="refused" if result.failures else "limited",
            reasons=[f"{name}: {FAILURES[name]}" for name in result.failures]
            or ["no standard deviations: use --method likelihood"],
        ),
        validity=Validity(
            rate_rad_s=[float(v) for v in rate_range_rad_s],
            config_hash=origin.board.config.config_hash,
        ),
    )


_PARTS = {
    "bias": ("x", "y", "z"),
    "scale": ("x", "y", "z"),
    "nonorthogonality": ("xy", "zx", "zy"),
    "misalignment": ("x", "y", "z"),
}


def _matrices(result: PaperResult) -> Matrices:
    """Return S, T and M where they are what their names say, else null; STM always."""
    none: Matrix = [[None] * 3 for _ in range(3)]
    S, T, M = result.S, result.T, result.M
    if S is None or T is None or M is None:
        return Matrices(S=none, T=none, M=none, STM=_rows(result.STM))
    fits = float(np.abs(S @ T @ M - result.STM).max()) < _EXACT
    rotation = float(np.abs(M.T @ M - np.eye(3)).max()) < _EXACT and np.linalg.det(M) > 0.0
    if not (fits and rotation):
        return Matrices(S=none, T=none, M=none, STM=_rows(result.STM))
    return Matrices(S=_rows(S), T=_rows(T), M=_rows(M), STM=_rows(result.STM))


def _parameters(result: PaperResult, known: bool) -> dict[str, Parameter]:
    nothing: list[float | None] = [None] * 3
    scale, skew, turn = nothing, nothing, nothing
    S, T, M = result.S, result.T, result.M
    if known and S is not None and T is not None and M is not None:
        if np.allclose(S, np.diag(np.diag(S)), atol=_EXACT):
            scale = [float(v) for v in np.diag(S)]
        if np.allclose(T, np.tril(T), atol=_EXACT) and np.allclose(np.diag(T), 1.0, atol=_EXACT):
            skew = [float(T[1, 0]), float(T[2, 0]), float(T[2, 1])]
        turn = [float(v) for v in rotation_vector(M)]
    return {
        "bias": Parameter([float(v) for v in result.bias_rad_s], nothing, "rad/s"),
        "scale": Parameter(scale, nothing, "1"),
        "nonorthogonality": Parameter(skew, nothing, "1"),
        "misalignment": Parameter(turn, nothing, "rad"),
        "time_offset": Parameter(None, None, "s"),
    }


def _rows(values: FloatArray) -> Matrix:
    return [[float(v) + 0.0 if math.isfinite(v) else None for v in row] for row in values]


def _angles(
    recording: Recording, samples: GyroSamples
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[float, float]]:
    """Return sample times, pan and tilt interpolated to them, and the span of the polls."""
    polls = recording.ptu_positions()
    polls = polls[polls["status"] & OUT_OF_STEP == 0]
    middle = (times_ns(polls["request_time"]) + times_ns(polls["reply_time"])) // 2
    middle_s = (middle - samples.origin_ns) * 1e-9
    out, low, high = [], -math.inf, math.inf
    for axis, valid in (("pan", PtuStatus.PAN_ANSWERED), ("tilt", PtuStatus.TILT_ANSWERED)):
        has = polls["status"] & valid != 0
        if int(has.sum()) < 2:
            raise InputError(
                f"{recording.path.name} has fewer than two {axis} positions",
                "leave out ptu: poll: rate_hz in the rig file, so that the daemon asks often, and "
                "record again",
            )
        out.append(np.interp(samples.time_s, middle_s[has], polls[axis][has]))
        low, high = max(low, float(middle_s[has][0])), min(high, float(middle_s[has][-1]))
    return samples.time_s, out[0], out[1], (low, high)


def _static(recording: Recording, samples: GyroSamples) -> BoolArray:
    """Return which samples lie in a phase `static`."""
    inside = np.zeros(samples.time_s.size, dtype=np.bool_)
    begin_s: float | None = None
    for event in recording.events():
        if event.phase != "static":
            continue
        at_s = (event.host_time_ns - samples.origin_ns) * 1e-9
        if event.kind == EventKind.PHASE_BEGIN:
            begin_s = at_s
        elif event.kind == EventKind.PHASE_END and begin_s is not None:
            inside |= (samples.time_s >= begin_s) & (samples.time_s < at_s)
            begin_s = None
    return inside
