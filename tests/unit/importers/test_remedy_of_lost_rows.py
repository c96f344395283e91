"""A file with missing rows: the remedy is for its recorder, which has no baud rate."""

from pathlib import Path

import numpy as np
import pytest
from tests.support.handheld_session import simulate_session, write_xsens

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver import cli
from gyrorig_solver.calibration.verdict import judge_fit
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.data.stream.stream_checks import check_stream
from gyrorig_solver.estimate import fit_gravity
from gyrorig_solver.importers import import_files


@pytest.fixture(scope="module")
def recording_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tenth of the rows is missing."""
    folder = tmp_path_factory.mktemp("lost")
    source = write_xsens(folder, simulate_session(7))
    lines = source.read_text().splitlines(keepends=True)
    head, rows = lines[:-3000], lines[-3000:]
    is_lost = np.random.default_rng(1).random(len(rows)) < 0.1
    is_lost[[0, -1]] = False
    remaining = [row for row, lost in zip(rows, is_lost, strict=True) if not lost]
    source.write_text("".join(head + remaining))
    import_files([source], folder / "lost.mcap")
    return folder / "lost.mcap"


def test_every_command_states_a_remedy_for_a_file(
    recording_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = read_recording(recording_path)
    samples = load_samples(recording, recording.board_ids[0])
    assert samples.lost > 200
    (lost,) = check_stream(samples)[0].findings
    (reason,) = [
        reason
        for reason in judge_fit(fit_gravity(samples, 9.80665)).reasons
        if "samples were lost" in reason
    ]
    cli.run(["check", str(recording_path)])
    lines = capsys.readouterr().out.splitlines()
    (line,) = [text for text in lines if text.startswith("  ! ") and " lost " in text]
    for text in (lost.remedy, reason, line):
        assert "baud" not in text
        assert "ask the person who recorded the file" in text
