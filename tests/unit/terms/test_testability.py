"""Whether recordings that are fitted together can show a cause."""

from dataclasses import replace

import numpy as np
import pytest

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model import (
    RecordingContext,
    SignalState,
    find_term,
    limit_to_recording,
    why_not_computable,
    why_not_testable,
)

INTERVALS, STEP_S = 600, 0.01
EDGES_S: FloatArray = np.arange(INTERVALS + 1, dtype=np.float64) * STEP_S


def build(angle_rad: FloatArray | None, rate_rad_s: FloatArray | None = None) -> SignalState:
    """Return the state of one part, without a motion law and without a temperature."""
    return SignalState.build(
        EDGES_S,
        angle_rad,
        np.ones(INTERVALS, dtype=np.bool_),
        instants_per_block=1,
        intervals_per_instant=1,
        bandwidth_hz=25.0,
        gain=np.eye(3),
        rate_rad_s=rate_rad_s,
    )


MOVING = build(np.stack([0.5 * np.sin(EDGES_S), 0.3 * np.cos(EDGES_S)]))
RESTING = build(np.zeros((2, INTERVALS + 1)))
WITHOUT_ANGLES = build(None, np.full((INTERVALS, 3), 0.1))
RESTING_WITHOUT_ANGLES = build(None, np.zeros((INTERVALS, 3)))


@pytest.mark.parametrize("rest", [RESTING, RESTING_WITHOUT_ANGLES])
@pytest.mark.parametrize("cause", ["eccentricity", "g_sensitivity", "tilt_sag"])
def test_a_rest_beside_a_motion_prevents_no_test(cause: str, rest: SignalState) -> None:
    term = find_term(cause)
    assert why_not_testable(term, [MOVING]) is None
    assert why_not_testable(term, [MOVING, rest]) is None
    assert why_not_testable(term, [rest, MOVING]) is None


def test_rests_alone_do_not_show_a_cause_of_the_moves() -> None:
    for cause in ("base_speed_jump", "acceleration_error", "s_curve"):
        reason = why_not_testable(find_term(cause), [RESTING, RESTING])
        assert reason == "the unit does not move; record a program that moves it"


def test_a_motion_about_unknown_axes_prevents_the_test() -> None:
    """Its part of the effect cannot be computed, so that the other part says too little."""
    assert why_not_testable(find_term("eccentricity"), [MOVING, WITHOUT_ANGLES]) is not None


def test_moves_without_commands_prevent_the_test() -> None:
    reason = why_not_testable(find_term("base_speed_jump"), [RESTING, MOVING])
    assert reason == "the recording has no commands to the unit; record the commands too"


def test_a_cause_of_one_recording_needs_the_data_of_that_recording_only() -> None:
    second = replace(
        WITHOUT_ANGLES,
        context=RecordingContext(begin_s=0.0, end_s=float(EDGES_S[-1]), recording_index=1),
    )
    term = limit_to_recording(find_term("lost_steps"), 0)
    assert why_not_testable(term, [MOVING, second]) is None
    assert why_not_testable(limit_to_recording(find_term("lost_steps"), 1), [MOVING, second])


def test_averaging_hides_a_brief_cause_that_still_acts() -> None:
    averaged, resting = (_averaged(state) for state in (MOVING, RESTING))
    ringing = find_term("ringing")
    assert "0.5" in str(why_not_testable(ringing, [averaged]))
    assert why_not_computable(ringing, [averaged]) is None
    assert why_not_testable(ringing, [MOVING, resting]) is None  # a rest has no edges
    assert why_not_testable(find_term("supply_hum"), [MOVING, resting]) is not None


def _averaged(state: SignalState) -> SignalState:
    context = RecordingContext(begin_s=0.0, end_s=float(EDGES_S[-1]), mean_duration_s=0.5)
    return replace(state, context=context)
