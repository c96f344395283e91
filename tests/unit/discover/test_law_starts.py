"""A motion law whose fit fails from a size of zero is fitted from larger sizes."""

from pathlib import Path

import pytest
from tests.bench.rigs.recording_file import BOARD, write_recording
from tests.bench.rigs.rig import draw_rig
from tests.support.board_fits import fit_base_model

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.discover.law_candidates import fit_law_cause
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.model import find_term

# Tilt starts at 10 deg/s instead of the base speed. Small sizes are less likely than zero.
SEED = 24_000_076


@pytest.mark.long
def test_a_large_base_speed_is_found(tmp_path: Path) -> None:
    rig = draw_rig(SEED)
    path = tmp_path / "rig.mcap"
    write_recording(rig, path)
    space = MotionFitSpace(fit_base_model([read_recording(path)], BOARD))
    candidate = fit_law_cause(space, find_term("base_speed_jump")).candidate
    assert candidate is not None
    speed_rad_s = candidate.extension.values[1]
    assert speed_rad_s == pytest.approx(rig.causes.get("base_speed_jump", "tilt"), rel=0.02)
