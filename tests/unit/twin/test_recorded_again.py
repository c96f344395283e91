"""The twin as a rig: recorded and solved again, it gives the calibration of the measured rig."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.unit.twin.conftest import RecordedTwin, record, run_gyrorig

FARTHEST_STDS = 4.0  # of the noise of both calibrations
FARTHEST_TOTALS = 2.0  # of the total uncertainties of both
GROUPS = ("scale", "nonorthogonality", "misalignment")
MAX_OFFSET_CHANGE_S = 1e-4  # the common uncertainty of both is 1.5 ms


def _calibrate(recording: Path, out: Path) -> dict[str, Any]:
    process = run_gyrorig("solve", recording, "--out", out)
    assert process.returncode in (0, 4), process.stderr
    text = (out / "GY80-1" / "v0001.yaml").read_text("utf-8")
    document: dict[str, Any] = yaml.safe_load(text)
    return document


@pytest.mark.long
def test_the_twin_gives_the_same_calibration(
    recorded_twin: Callable[..., RecordedTwin], tmp_path: Path
) -> None:
    made = recorded_twin("--seed", "31", "--hide", "eccentricity@pan:0.004")
    again, _ = record(tmp_path / "again", "--session-seed", "7", config=made.file)
    first = _calibrate(made.recording, tmp_path / "first")
    second = _calibrate(again, tmp_path / "second")
    assert first["findings"]["causes"] == second["findings"]["causes"] == ["eccentricity"]
    for group in GROUPS:
        values, stds = (
            [document["parameters"][group][key] for document in (first, second)]
            for key in ("value", "std")
        )
        # The noise of both is independent, so the calibrations are not the same numbers.
        assert values[0] != values[1]
        labels = [name for name in first["uncertainty"]["parameters"] if name.startswith(group)]
        for k, label in enumerate(labels):
            change = abs(values[1][k] - values[0][k])
            assert change < FARTHEST_STDS * math.hypot(stds[0][k], stds[1][k]), label
            totals = [d["uncertainty"]["parameters"][label]["total"] for d in (first, second)]
            assert change < FARTHEST_TOTALS * math.hypot(*totals), label
    offsets_s = [document["parameters"]["time_offset"]["value"] for document in (first, second)]
    assert abs(offsets_s[1] - offsets_s[0]) < MAX_OFFSET_CHANGE_S
