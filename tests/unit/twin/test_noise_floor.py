"""A noise floor behind the low-pass goes from a recording into the calibration and the twin.

The recording is that of the second simulator, which shares no code with solver and emulator.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.hidden.independent.draws import draw_session
from tests.hidden.independent.make import make_case
from tests.unit.twin.conftest import record, run_gyrorig

from gyrorig_protocol.twin import Vector, parse_twin

SEED = 1038  # low-pass of 12.5 Hz, floor of 0.22 of the white noise
FARTHEST_SIGMA = 4.0


def twin_floor(recording: Path, out: Path) -> Vector:
    """Return the floor that the twin of a recording states."""
    process = run_gyrorig("twin", recording, "--out", out)
    assert process.returncode == 0, process.stderr
    (board,) = parse_twin((out / "twin.yaml").read_bytes(), "twin.yaml").boards.values()
    assert board.noise_floor is not None
    return board.noise_floor


@pytest.mark.long
def test_recording_twin_and_recording_of_the_twin_have_one_floor(tmp_path: Path) -> None:
    make_case(tmp_path / "case", draw_session(SEED, "nulls"))
    answer = json.loads((tmp_path / "case" / "answer.json").read_text("utf-8"))
    (truth,) = answer["truth"]["boards"].values()
    true_floor = np.full(3, truth["floor_rad_s_rthz"])

    first = twin_floor(tmp_path / "case" / "recording.mcap", tmp_path / "twin")
    assert first.std is not None
    assert np.all(np.abs(np.array(first.value) - true_floor) < FARTHEST_SIGMA * np.array(first.std))

    again, stated = record(tmp_path / "again", config=tmp_path / "twin" / "twin.yaml")
    (board,) = stated["boards"].values()
    assert board["noise_floor_rad_s_rthz"] == list(first.value)
    solved = run_gyrorig("solve", again, "--out", tmp_path / "calibrations")
    assert solved.returncode == 0, solved.stderr
    (path,) = (tmp_path / "calibrations").glob("*/v0001.yaml")
    noise = yaml.safe_load(path.read_text("utf-8"))["noise"]
    assert noise["noise_floor"]["unit"] == "rad/s/sqrt(Hz)"
    off = np.array(noise["noise_floor"]["value"]) - np.array(first.value)
    assert np.all(np.abs(off) < FARTHEST_SIGMA * np.array(first.std))
