"""Two causes at the same times, of which neither has a fit alone, are named together."""

from pathlib import Path

import pytest
from tests.bench.rigs.recording_file import BOARD, write_recording
from tests.bench.rigs.rig import draw_rig
from tests.support.board_fits import explain_recordings

from gyrorig_protocol.recording.reader import read_recording

# Each of the two has a low-pass or a speed at starts that is not the model's, and a compliant base.
LOW_PASS, BASE_SPEED = 25_000_041, 25_000_008


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "causes"),
    [
        (LOW_PASS, {"base_compliance", "low_pass_lag"}),
        (BASE_SPEED, {"base_compliance", "base_speed_jump"}),
    ],
)
def test_causes_of_one_time_are_named(seed: int, causes: set[str], tmp_path: Path) -> None:
    path = tmp_path / "rig.mcap"
    rig = draw_rig(seed)
    write_recording(rig, path)
    findings = explain_recordings([read_recording(path)], BOARD).findings
    assert findings.unexplained is None
    # The timer of the ramps differs from its nominal frequency by 0.03 %, too.
    named = {cause.cause for cause in findings.causes} - {"acceleration_error"}
    assert named == causes
    compliance = next(cause for cause in findings.causes if cause.cause == "base_compliance")
    values = {value.name: value.value for value in compliance.values}
    true = rig.causes.get("base_compliance", "pan")
    assert values["coefficient.pan"] == pytest.approx(true, rel=0.02)
