"""docs/measured-data.md holds what its commands give, and what they write keeps the contracts.

Every command of the page is run once, in this process: one to two minutes, in `make test-pages`.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from docs import blocks
from docs.measured import held_out_moves, sessions, write
from docs.measured.printed import IMU_TK

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.apply import read_calibration
from gyrorig_solver.calibration import parse_calibration
from gyrorig_solver.pipeline import solve_recordings
from gyrorig_solver.pipeline.solve_board import FINDINGS_SUFFIX

DECIMAL = re.compile(r"\d+\.\d+")
# The first of them runs every command.
pytestmark = [pytest.mark.pages, pytest.mark.timeout(1800)]
CAN_SHOW_ALL, NOT_IDENTIFIABLE, REFUSED = 0, 4, 3


@pytest.fixture(scope="module")
def measured(
    measured_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> sessions.MeasuredSets:
    return sessions.run_all(measured_data.resolve(), tmp_path_factory.mktemp("measured"))


@pytest.fixture(scope="module")
def document() -> str:
    return write.DOCUMENT.read_text(encoding="utf-8")


def test_the_exit_statuses_follow_the_contract(measured: sessions.MeasuredSets) -> None:
    refused = []
    for runs in measured.runs.values():
        for command in runs:
            assert command.exit_code in (CAN_SHOW_ALL, NOT_IDENTIFIABLE, REFUSED), command.errors
            if command.exit_code == REFUSED:
                refused.append(command)
                assert len(command.errors.splitlines()) == 1
            else:
                assert command.errors == ""
    # The two that the page shows: no gyro in it, and no rest for the bias.
    assert ["can_frames" in command.line for command in refused] == [False, True]
    assert "the board never rests" in refused[0].errors


def test_what_they_write_keeps_the_contracts(
    measured: sessions.MeasuredSets, contract_judge: Path
) -> None:
    recordings, documents = measured.list_recordings(), measured.list_documents()
    explanations = measured.list_explanations()
    findings = [path for path in documents if path.name.endswith(FINDINGS_SUFFIX)]
    # 12 calibrations; the four from known turns or gravity are not searched for causes.
    assert (len(recordings), len(documents), len(findings)) == (14, 20, 8)
    assert len(explanations) == len(sessions.COMMANDS[sessions.EXPLAINED])
    judged = subprocess.run(
        [sys.executable, contract_judge, *recordings, *documents, *explanations],
        capture_output=True,
        text=True,
        check=False,
    )
    assert judged.returncode == 0, judged.stdout + judged.stderr


def test_every_calibration_can_be_applied(measured: sessions.MeasuredSets) -> None:
    paths = [p for p in measured.list_documents() if not p.name.endswith(FINDINGS_SUFFIX)]
    boards = {read_calibration(path)[0].board.id for path in paths}
    assert {"BROAD-1", "BROAD-2", "BROAD-3"} < boards


def test_a_calibration_names_the_findings_beside_it(measured: sessions.MeasuredSets) -> None:
    for path in measured.list_documents():
        if path.name.endswith(FINDINGS_SUFFIX):
            continue
        findings = path.with_name(path.stem + FINDINGS_SUFFIX)
        reference = parse_calibration(path.read_bytes(), path.name).findings
        assert (reference.file if reference else None) == (
            findings.name if findings.exists() else None
        )


def test_every_block_is_in_the_page_once(measured: sessions.MeasuredSets, document: str) -> None:
    names = blocks.read_block_names(document)
    assert len(set(names)) == len(names)
    assert set(names) == set(write.make_blocks(measured))


def test_blocks_are_what_the_commands_give(measured: sessions.MeasuredSets, document: str) -> None:
    """The words must agree, a number within 1 % or three of its last digit.

    Less than any of the standard deviations beside them.
    """
    pytest.importorskip("imucal")
    printed = blocks.read_block_bodies(document)
    for name, block in write.make_blocks(measured).items():
        assert blocks.describe_difference(printed[name], block() + "\n", 0.01, 3.0) == "", name


def test_decimals_in_prose_stand_in_a_block_too(document: str) -> None:
    """A number that is written by hand is one that a command gave."""
    made = " ".join(blocks.read_block_bodies(document).values())
    by_hand = set(DECIMAL.findall(blocks.BLOCK.sub("", document)))
    assert {number for number in by_hand if number not in made} == set()


def test_gains_of_a_document_are_those_of_the_fit(measured: sessions.MeasuredSets) -> None:
    """The page goes back from S, T, M and their covariance; the solver has G at first hand."""
    fit = solve_recordings([read_recording(measured.folder / "ferraris.mcap")], "FERRARIS")
    gain, std = sessions.compute_gain_and_std(measured.read_calibration("FERRARIS"))
    np.testing.assert_allclose(gain, fit.gain, atol=1e-12)
    np.testing.assert_allclose(std, fit.gain_std, rtol=1e-6)


def test_imu_tk_method_run_here_gives_what_its_program_printed(
    measured: sessions.MeasuredSets,
) -> None:
    """On all moves: each entry of the gain within a third of the standard deviation it printed."""
    loaded = measured.load_recording("xsens")
    samples = loaded.samples
    moves, _ = held_out_moves.find_moves(samples, loaded.rests[0])
    scale_rad_s = samples.quantum_rad_s
    first = (IMU_TK.b_counts - held_out_moves.OFFSET_COUNTS) * scale_rad_s
    result = held_out_moves.fit_gain_as_imu_tk(samples, moves, first, 0.76 * np.eye(3))
    std = IMU_TK.propagate_std(lambda gain: gain, scale_rad_s)
    assert len(moves) == 37  # as its program counts them
    assert np.abs((result - IMU_TK.compute_gain(scale_rad_s)) / std).max() < 1.0 / 3.0


def test_without_the_data_the_script_says_what_to_do(tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, str(Path(write.__file__)), "--check"],
        cwd=tmp_path,
        env={**os.environ, sessions.VARIABLE: str(tmp_path / "nowhere")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    assert result.stderr.startswith("no measured data at")
    assert "set GYRORIG_DATA" in result.stderr
    assert len(result.stderr.splitlines()) == 1
