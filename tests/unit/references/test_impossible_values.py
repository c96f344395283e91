"""Values of turns and attitudes that no rig can have give an error, not a crash or a warning."""

import numpy as np
import pytest

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import EventKind, SessionEvent
from gyrorig_solver.reference.attitude_reference import read_attitude
from gyrorig_solver.reference.known_turns import read_turns

HUGE = "1" + "0" * 400  # an integer that no float can hold


@pytest.mark.parametrize(
    ("angle", "std"), [(HUGE, "0.1"), ("1.0", HUGE), ("1e200", "0.1"), ("-1e9", "0.1")]
)
def test_an_impossible_turn_is_an_error(angle: str, std: str) -> None:
    text = f'{{"axis": [1, 0, 0], "angle_rad": {angle}, "std_rad": {std}}}'
    events = [
        SessionEvent(0, EventKind.PHASE_BEGIN, "turn", text),
        SessionEvent(10**9, EventKind.PHASE_END, "turn", text),
    ]
    with pytest.raises(InputError, match=r"the turn at 0\.0 s has"):
        read_turns(events, 0)


def test_an_attitude_of_infinite_length_is_lost() -> None:
    orientation = np.tile([0.0, 0.0, 0.0, 1.0], (300, 1))
    orientation[5] = 1e200
    reference = read_attitude(np.arange(300) / 100.0, orientation, np.zeros(300))
    assert np.flatnonzero(~np.isfinite(reference.orientation_xyzw).all(axis=1)).tolist() == [5]
