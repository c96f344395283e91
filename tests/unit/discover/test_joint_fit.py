"""Two causes that act at starts and stops are both found, although a fit with one may fail."""

from pathlib import Path

import pytest
from tests.bench.rigs.recording_file import BOARD, write_recording
from tests.bench.rigs.rig import draw_rig
from tests.support.board_fits import explain_recordings

from gyrorig_protocol.recording.reader import read_recording

# Rigs with a compliant base. The fit with the base alone fails because of the low-pass; the small
# steps of the fit with the base speed alternate.
LOW_PASS, BASE_SPEED = 25_000_041, 25_000_008


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "causes"),
    [
        (LOW_PASS, {"base_compliance", "low_pass_lag"}),
        (BASE_SPEED, {"base_compliance", "base_speed_jump"}),
    ],
)
def test_both_causes_are_named(seed: int, causes: set[str], tmp_path: Path) -> None:
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
