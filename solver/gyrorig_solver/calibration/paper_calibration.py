"""The paper's method on a recording, and its result as a calibration document.

For comparison only. The document contains the method's results where the schema has a place for
them; everything else is null and listed with the reason.
"""

import math

import numpy as np

from gyrorig_protocol.documents import document_part, finite_values
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import EventKind, PtuStatus
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.calibration.calibration_builder import UNKNOWN, Provenance
from gyrorig_solver.calibration.calibration_document import (
    CalibrationDocument,
    Covariance,
    Matrices,
    ObservabilityRecord,
    Parameter,
    Quality,
    Trust,
    Units,
    Validity,
)
from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import calibrate_as_printed
from gyrorig_solver.estimate.paper.paper_method import FAILURES, PaperResult
from gyrorig_solver.model import PARAMETER_GROUPS, parameter_label
from gyrorig_solver.model.gain_matrix import rotation_vector
from gyrorig_solver.reference import UNUSABLE_STATUS

_EXACT = 1e-9  # tolerance of S T M = STM and of M being a rotation, as in the schema


def solve_with_paper_method(
    recording: Recording, board: BoardId, samples: GyroSamples
) -> PaperResult:
    """Return the result of eq. 6 to 12 for one board of one recording.

    Raises:
        InputError: the recording has no positions of a pan-tilt unit, or no motion.
    """
    if "/ptu/position" not in recording.topics:
        raise InputError(
            "the option --method paper needs the angles of a pan-tilt unit, but the recording "
            f"{recording.path.name} does not contain them",
            "use --method likelihood",
        )
    time_s, pan, tilt, span = _interpolated_angles(recording, samples)
    used = samples.usable & (time_s >= span[0]) & (time_s <= span[1])
    used[1:] &= np.diff(time_s) > 0.0
    try:
        return calibrate_as_printed(
            time_s[used],
            samples.rate_rad_s[used],
            pan[used],
            tilt[used],
            _static_samples(recording, samples)[used],
        )
    except ValueError as fault:
        raise InputError(
            f"`--method paper` cannot calibrate board {board} ({fault})",
            "record a motion program with static intervals and moves, such as survey-40, or "
            "use `--method likelihood`",
        ) from fault


def build_paper_calibration(
    result: PaperResult, rate_range_rad_s: tuple[float, float], origin: Provenance
) -> CalibrationDocument:
    """Return the document of the paper's result, as a first version."""
    matrices = _matrices(result)
    known = matrices.S[0][0] is not None
    parameters = _parameters(result, known)
    unobservable = [
        parameter_label(group.name, label)
        for group in PARAMETER_GROUPS
        if parameters[group.name].value in ([None] * 3, None)
        for label in group.labels
    ]
    return CalibrationDocument(
        schema="gyrorig/calibration/1",
        board=origin.board,
        version=1,
        created=origin.created,
        inputs=list(origin.inputs),
        solver=origin.solver_record("paper", [group.name for group in PARAMETER_GROUPS[:-1]]),
        units=Units(),
        model="y = S T M u + b t, angles: the paper's eq. 6 to 12 as printed",
        parameters=parameters,
        matrices=matrices,
        covariance=Covariance(order=[], matrix=[]),
        observability=ObservabilityRecord(
            rank=13 - len(unobservable), of=12, unobservable=unobservable, condition=None
        ),
        noise={},
        quality=Quality(
            reduced_chi2=None,
            warnings=["the paper's method gives no standard uncertainties and no time offset"],
        ),
        trust=Trust(
            verdict="refused" if result.failures else "limited",
            reasons=[f"{name}: {FAILURES[name]}" for name in result.failures]
            or ["no standard uncertainties are given. Use --method likelihood"],
        ),
        validity=Validity(
            rate_rad_s=list(rate_range_rad_s),
            config_hash=origin.board.config.config_hash,
        ),
    )


def _matrices(result: PaperResult) -> Matrices:
    """Return S, T and M if they are valid factors of STM, else null; STM always."""
    S, T, M = result.S, result.T, result.M
    if S is not None and T is not None and M is not None:
        product_agrees = float(np.abs(S @ T @ M - result.STM).max()) < _EXACT
        is_orthogonal = float(np.abs(M.T @ M - np.eye(3)).max()) < _EXACT
        if product_agrees and is_orthogonal and np.linalg.det(M) > 0.0:
            return document_part(Matrices, result)
    return Matrices(S=UNKNOWN, T=UNKNOWN, M=UNKNOWN, STM=finite_values(result.STM))


def _parameters(result: PaperResult, known: bool) -> dict[str, Parameter]:
    unknown: list[float | None] = [None] * 3
    scale, nonorthogonality, misalignment = unknown, unknown, unknown
    S, T, M = result.S, result.T, result.M
    if known and S is not None and T is not None and M is not None:
        if np.allclose(S, np.diag(np.diag(S)), atol=_EXACT):
            scale = [float(v) for v in np.diag(S)]
        if np.allclose(T, np.tril(T), atol=_EXACT) and np.allclose(np.diag(T), 1.0, atol=_EXACT):
            nonorthogonality = [float(T[1, 0]), float(T[2, 0]), float(T[2, 1])]
        misalignment = [float(v) for v in rotation_vector(M)]
    return {
        "bias": Parameter(result.bias_rad_s.tolist(), unknown, "rad/s"),
        "scale": Parameter(scale, unknown, "1"),
        "nonorthogonality": Parameter(nonorthogonality, unknown, "1"),
        "misalignment": Parameter(misalignment, unknown, "rad"),
        "time_offset": Parameter(None, None, "s"),
    }


def _interpolated_angles(
    recording: Recording, samples: GyroSamples
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[float, float]]:
    """Return sample times, pan and tilt interpolated to them, and the span of the polls."""
    polls = recording.ptu_positions()
    polls = polls[polls["status"] & UNUSABLE_STATUS == 0]
    middle = (times_ns(polls["request_time"]) + times_ns(polls["reply_time"])) // 2
    middle_s = (middle - samples.origin_ns) * 1e-9
    angles, start_s, end_s = [], -math.inf, math.inf
    for axis, valid in (("pan", PtuStatus.PAN_ANSWERED), ("tilt", PtuStatus.TILT_ANSWERED)):
        answered = polls["status"] & valid != 0
        if int(answered.sum()) < 2:
            raise InputError(
                f"the recording {recording.path.name} has fewer than two {axis} positions of the "
                "pan-tilt unit, which is too few for `--method paper`",
                "remove `rate_hz` under `ptu: poll` from the rig file, so that the daemon asks "
                "the unit for its position more often, and record again",
            )
        angles.append(np.interp(samples.time_s, middle_s[answered], polls[axis][answered]))
        start_s = max(start_s, float(middle_s[answered][0]))
        end_s = min(end_s, float(middle_s[answered][-1]))
    return samples.time_s, angles[0], angles[1], (start_s, end_s)


def _static_samples(recording: Recording, samples: GyroSamples) -> BoolArray:
    is_static = np.zeros(samples.time_s.size, dtype=np.bool_)
    begin_s: float | None = None
    for event in recording.events():
        if event.phase != "static":
            continue
        at_s = (event.host_time_ns - samples.origin_ns) * 1e-9
        if event.kind == EventKind.PHASE_BEGIN:
            begin_s = at_s
        elif event.kind == EventKind.PHASE_END and begin_s is not None:
            is_static |= (samples.time_s >= begin_s) & (samples.time_s < at_s)
            begin_s = None
    return is_static
