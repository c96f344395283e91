"""A limit that cuts off the tips of fast moves is named, also with noise behind the limit."""

from pathlib import Path

import pytest
from tests.bench.rigs.recording_file import BOARD
from tests.hidden.independent.draws import draw_session
from tests.hidden.independent.make import make_case
from tests.support.board_fits import explain_recordings

from gyrorig_protocol.recording.reader import read_recording

pytestmark = pytest.mark.long


@pytest.mark.parametrize(("seed", "tier"), [(12112, "ladder"), (14012, "many")])
def test_a_limit_just_below_the_largest_rate_is_named(seed: int, tier: str, tmp_path: Path) -> None:
    """In the second simulator, noise hides that the counts at the limit are equal."""
    session = draw_session(seed, tier)
    causes = {cause.hiding.cause for cause in session.causes}
    assert "saturation" in causes
    make_case(tmp_path, session)
    recording = read_recording(tmp_path / "recording.mcap")
    findings = explain_recordings([recording], BOARD).findings
    assert {cause.cause for cause in findings.causes} == causes
