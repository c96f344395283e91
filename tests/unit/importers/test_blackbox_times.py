"""Times of a blackbox log: pauses stay, and frames with a damaged time are left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.support.flight_log_writers import blackbox_session
from tests.support.handheld_session import HandheldSession, simulate_session

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.importers import ImportSummary, import_files


@pytest.fixture(scope="module")
def session() -> HandheldSession:
    return simulate_session(7, moves=2)


def imported(
    folder: Path, session: HandheldSession, time_s: np.ndarray
) -> tuple[ImportSummary, GyroSamples]:
    (folder / "log.bbl").write_bytes(blackbox_session(replace(session, time_s=time_s)))
    summary = import_files([folder / "log.bbl"], folder / "out.mcap")
    return summary, load_samples(read_recording(summary.path), "BETAFLIGHT")


@pytest.mark.parametrize("pause_s", [5.0, 10.0, 25.0, 600.0])
@pytest.mark.parametrize("row", [640, 650])
def test_a_pause_stays_in_the_times(
    tmp_path: Path, session: HandheldSession, pause_s: float, row: int
) -> None:
    """Before, a pause of 10 s or more was cut out, and its first frame was left out."""
    time_s = session.time_s + pause_s * (np.arange(session.time_s.size) >= row)
    summary, samples = imported(tmp_path, session, time_s)
    np.testing.assert_allclose(samples.time_s, time_s, atol=1e-6)
    assert any(f"jump by {pause_s + 0.01:.6g} s" in note for note in summary.notes)
    assert samples.period_s == pytest.approx(0.01)


@pytest.mark.parametrize("error_s", [25.0, -3.0])
def test_a_frame_that_the_next_contradicts_is_left_out(
    tmp_path: Path, session: HandheldSession, error_s: float
) -> None:
    """Before, the next frame was left out, too, and its step was missing in all later times."""
    time_s = session.time_s.copy()
    time_s[640] += error_s
    summary, samples = imported(tmp_path, session, time_s)
    assert samples.number.size == time_s.size - 1
    np.testing.assert_allclose(samples.time_s, np.delete(session.time_s, 640), atol=1e-6)
    assert not any("jump by" in note for note in summary.notes)
