"""Several recordings whose time of day is not known: their order, their gap, and their report."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.support.reference_recordings import (
    BOARD,
    HandMotion,
    SimulatedGyro,
    record_attitudes,
    record_rest,
    record_turns,
)

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import CalibrationStore
from gyrorig_solver.pipeline import solve_and_store, solve_recordings

GYRO = SimulatedGyro()
OTHER = replace(GYRO, bias_rad_s=(-0.01, 0.01, 0.03))


def recordings_of(kind: str, folder: Path) -> list[Recording]:
    """Return three recordings; the later ones are shorter and begin at the same time."""
    paths = []
    for k, gyro in enumerate((GYRO, OTHER, GYRO)):
        path = folder / f"{'cab'[k]}.mcap"
        if kind == "attitudes":
            hand = HandMotion(k, span_s=50.0 - 10.0 * k, rest_s=4.0)
            record_attitudes(path, gyro, k, motion=hand)
        elif kind == "turns":
            record_turns(path, gyro, k, repeats=1)
        else:
            record_rest(path, gyro, k, span_s=50.0 - 10.0 * k)
        paths.append(path)
    return [read_recording(path) for path in paths]


@pytest.mark.long
@pytest.mark.parametrize("kind", ["attitudes", "turns", "rest"])
def test_the_order_is_that_in_which_they_were_given(kind: str, tmp_path: Path) -> None:
    recordings = recordings_of(kind, tmp_path)
    result = solve_and_store(CalibrationStore(tmp_path / "out"), recordings, BoardId(BOARD))
    assert [row.name for row in result.calibration.inputs] == ["c.mcap", "a.mcap", "b.mcap"]
    rows = result.calibration.quality.recordings
    assert rows is not None
    for row, gyro in zip(rows, (GYRO, OTHER, GYRO), strict=True):
        error = np.array(row.bias) - np.array(gyro.bias_rad_s)
        assert np.abs(error / np.array(row.bias_std)).max() < 4.0
    page = result.report.read_text()
    assert "the time of day of c.mcap, a.mcap, b.mcap is not known" in page
    assert "1970" not in page


def test_figures_show_them_one_after_the_other(tmp_path: Path) -> None:
    fit = solve_recordings(recordings_of("attitudes", tmp_path), BOARD)
    assert fit.diagnostics is not None
    steps = np.diff(fit.diagnostics.time_s)
    assert steps.min() > 0.0
    assert int(np.sum(steps > 0.9)) == 2  # the gaps between three recordings
