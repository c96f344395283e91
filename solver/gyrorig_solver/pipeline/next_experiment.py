"""The next experiment after an explanation: the program that separates the remaining causes.

What to use when: `with_next_experiment` for the explanation of a board, `next_experiment` for only
a search.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.discover import FitExplanation
from gyrorig_solver.pipeline.board_results import BoardExplanation
from gyrorig_solver.plan import MAX_PROGRAM_S, NextExperiment, RigModel, apply_limits
from gyrorig_solver.plan.separation import propose_program, recorded_unit
from gyrorig_solver.plan.unit_model import UnitModel
from gyrorig_solver.reference import PanTiltReference

PTU_METADATA = "gyrorig.ptu"


def with_next_experiment(
    explanation: BoardExplanation,
    rig: RigModel | None = None,
    max_duration_s: float = MAX_PROGRAM_S,
    unseen: Sequence[str] = (),
) -> BoardExplanation:
    """Return an explanation with the proposed program; arguments as for `next_experiment`.

    If the unit allows none of the motions, a remark states the reason. A remark also states why no
    program can show the `unseen` causes.
    """
    if max_duration_s <= 0.0:
        return explanation
    fit_explanation = explanation.fit_explanation
    has_unit = any(recording.ptu_positions().size for recording in explanation.recordings)
    if fit_explanation is None or not has_unit:
        reason = "the recordings have no motion unit"
        return _with_reason(explanation, reason) if unseen else explanation
    try:
        proposed = next_experiment(
            explanation.recordings, fit_explanation, rig, max_duration_s, unseen
        )
    except UsageError as fault:
        return _with_reason(explanation, fault.problem)
    return replace(explanation, next_experiment=proposed)


def _with_reason(explanation: BoardExplanation, reason: str) -> BoardExplanation:
    remark = f"no motion program is proposed, because {reason}"
    return replace(explanation, remarks=(*explanation.remarks, remark))


def next_experiment(
    recordings: Sequence[Recording],
    explanation: FitExplanation,
    rig: RigModel | None = None,
    max_duration_s: float = MAX_PROGRAM_S,
    unseen: Sequence[str] = (),
) -> NextExperiment | None:
    """Return the program that separates ambiguous causes; None if it is not needed.

    Args:
        recordings: of the explanation.
        explanation: the search for causes in these recordings.
        rig: with further limits; its unit counts only if the recordings do not state one.
        max_duration_s: of the program.
        unseen: causes that the program must show at their typical size.

    Raises:
        UsageError: the limits of the rig allow no motion, or the program leaves those of the unit.
    """
    unit = _unit_of_recording(recordings, explanation)
    if unit is not None and rig is not None:
        unit = apply_limits(unit, rig.limits, f"the rig file of {rig.name}")
    if unit is None and rig is not None:
        unit = rig.unit
    return None if unit is None else propose_program(explanation, unit, max_duration_s, unseen)


def _unit_of_recording(
    recordings: Sequence[Recording], explanation: FitExplanation
) -> UnitModel | None:
    """Return the unit that the last recording with motion states, with the signs of its fit.

    None if it is unknown.
    """
    solution = explanation.solution_extended
    metadata = recordings[solution.offset_recording].metadata.get(PTU_METADATA)
    unit = None if metadata is None else recorded_unit(metadata)
    reference = solution.sessions[solution.offset_recording].reference
    if unit is None or not isinstance(reference, PanTiltReference):
        return unit
    pan_sign, tilt_sign = (int(np.sign(step_rad)) for step_rad in reference.rad_per_step)
    return replace(unit, pan=unit.pan.with_sign(pan_sign), tilt=unit.tilt.with_sign(tilt_sign))
