"""The twin as a rig: recorded and solved again, it gives the calibration of the measured rig."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.unit.twin.conftest import RecordedTwin, record, run_gyrorig

from gyrorig_protocol.twin import Twin, parse_twin

FARTHEST_STDS = 4.0  # of the noise of both calibrations
FARTHEST_TOTALS = 2.0  # of the total uncertainties of both
GROUPS = ("scale", "nonorthogonality", "misalignment")
MAX_OFFSET_CHANGE_S = 1e-4  # the common uncertainty of both is 1.5 ms
START_DELAY_S = 0.032  # much more than the answer time of the unit


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


def _start_delay(twin: Twin) -> tuple[float, float]:
    """Return the start delay and its standard deviation in a draw, s."""
    assert twin.unit is not None
    assert twin.unit.start_delay is not None
    assert twin.posterior is not None
    k = twin.posterior.names.index("unit.start_delay")
    return twin.unit.start_delay.value, math.sqrt(twin.posterior.covariance[k][k])


@pytest.mark.long
def test_a_unit_that_starts_late_has_a_twin_that_starts_late(
    recorded_twin: Callable[..., RecordedTwin], tmp_path: Path
) -> None:
    made = recorded_twin("--seed", "31")
    document = yaml.safe_load(made.file.read_text("utf-8"))
    document["twin"]["unit"]["start_delay"]["value"] = START_DELAY_S
    late = tmp_path / "late.yaml"
    late.write_text(yaml.safe_dump(document), encoding="utf-8")
    recording, _ = record(tmp_path / "late", "--session-seed", "7", config=late)
    process = run_gyrorig("twin", recording, "--out", tmp_path / "again")
    assert process.returncode == 0, process.stderr
    again = parse_twin((tmp_path / "again" / "twin.yaml").read_bytes(), "twin.yaml")
    value_s, std_s = _start_delay(again)
    assert abs(value_s - START_DELAY_S) < FARTHEST_STDS * std_s
    assert std_s < MAX_OFFSET_CHANGE_S
    (board,) = again.boards.values()
    (measured,) = made.twin.boards.values()
    change_s = board.time_offset.value - measured.time_offset.value
    assert abs(change_s) < MAX_OFFSET_CHANGE_S
