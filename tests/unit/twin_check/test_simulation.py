"""The draws of a simulation as parts of one process each."""

from pathlib import Path

import pytest
from tests.support.reference_recordings import SimulatedGyro, record_attitudes

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.twin_check.simulation import (
    SimulationFailedError,
    Simulator,
    run_draws,
    split_draws,
)

RIG = Path(__file__).resolve().parents[3] / "config" / "rig.yaml"


@pytest.mark.parametrize(
    ("draws", "is_twin", "parts"),
    [
        (range(21), True, [range(1), range(1, 11), range(11, 21)]),
        (range(7), False, [range(3), range(3, 7)]),
        (range(2), True, [range(1), range(1, 2)]),
        (range(5, 8), True, [range(5, 6), range(6, 8)]),
    ],
)
def test_draw_0_of_a_twin_is_alone(draws: range, is_twin: bool, parts: list[range]) -> None:
    """`gyrorigd record --sessions` counts up from each draw except 0."""
    assert split_draws(draws, 2, is_twin) == parts


def test_a_simulation_that_fails_states_the_reason_of_the_daemon(tmp_path: Path) -> None:
    measured = read_recording(record_attitudes(tmp_path / "r.mcap", SimulatedGyro()))
    simulator = Simulator("before", RIG, is_twin=False)
    with pytest.raises(SimulationFailedError, match="no unit moves in it") as caught:
        run_draws([(simulator, range(1))], measured, tmp_path, lambda: None)
    assert caught.value.exit_code == 3
