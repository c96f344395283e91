"""Remedies for imported data fit a person without a board, a cable and a host."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.handheld_session import simulate_session, write_xsens

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver import cli
from gyrorig_solver.calibration.verdict import judge_fit
from gyrorig_solver.data import link_remedies
from gyrorig_solver.data.link_remedies import LinkRemedy
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.data.stream.count_stream import COUNT_FIELDS
from gyrorig_solver.data.stream.gain_checks import check_gain
from gyrorig_solver.data.stream.stream_checks import check_stream
from gyrorig_solver.estimate import fit_gravity
from gyrorig_solver.importers import import_files
from gyrorig_solver.model.catalogue import catalogue

# What a person needs a board on a bench for. The catalogue's causes of a unit are left out.
BENCH = ("cable", "supply", "host", "firmware", "data-ready", "register", "baud", "gyrorigd")
REMEDIES = {n: r for n, r in vars(link_remedies).items() if isinstance(r, LinkRemedy)}
BOARD_CAUSES = [
    cause
    for cause, term in catalogue().items()
    if not (term.is_of_unit or term.needs_angles or term.kind == "known")
]


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


@pytest.mark.parametrize("name", REMEDIES)
def test_a_remedy_for_a_file_needs_no_bench(name: str) -> None:
    remedy = REMEDIES[name]
    assert remedy.for_link("serial") == remedy.for_link("unknown") == remedy.rig
    for word in BENCH:
        assert word not in remedy.for_link("file"), word


@pytest.mark.parametrize("cause", BOARD_CAUSES)
def test_a_cause_of_imported_data_has_a_remedy_without_a_bench(cause: str) -> None:
    """Before: "check the board's supply, load and light at that moment, and record again"."""
    remedy = catalogue()[cause].remedy_for("file")
    assert remedy == remedy.rstrip(".")
    for word in BENCH:
        assert word not in remedy or "column map" in remedy, word


def as_link(samples: GyroSamples, link: str) -> GyroSamples:
    changes: dict[str, Any] = dict.fromkeys(COUNT_FIELDS)
    changes |= {"rate_rad_s": samples.gyro, "metadata": {**samples.metadata, "link": link}}
    return replace(samples, clock=replace(samples.clock, restarts=2, steps=1), **changes)


def test_findings_of_the_stream_state_the_remedy_of_their_link(recording_path: Path) -> None:
    recording = read_recording(recording_path)
    samples = load_samples(recording, recording.board_ids[0])
    at_rig = check_stream(as_link(samples, "serial"))[0].findings
    of_file = check_stream(as_link(samples, "file"))[0].findings
    assert [f.cause for f in of_file] == ["lost_samples", "board_restart", "clock_step"]
    assert [f.remedy for f in of_file] == [
        link_remedies.LOST_SAMPLES.file,
        link_remedies.RESTART.file,
        link_remedies.CLOCK_STEP.file,
    ]
    assert [f.remedy for f in at_rig] == [
        link_remedies.LOST_SAMPLES.rig,
        link_remedies.RESTART.rig,
        link_remedies.CLOCK_STEP.rig,
    ]


def test_a_wrong_gain_of_a_file_is_corrected_in_the_import_map() -> None:
    mirrored, doubled = np.diag([1.0, -1.0, 1.0]), 2.0 * np.eye(3)
    for gain, check in ((mirrored, 0), (doubled, 1)):
        for link, is_file in (("file", True), ("serial", False)):
            (finding,) = check_gain(gain, None, link)[check].findings
            assert ("import map" in finding.remedy) == is_file


def test_outliers_of_a_file_are_no_matter_of_a_bus(recording_path: Path) -> None:
    recording = read_recording(recording_path)
    fit = fit_gravity(load_samples(recording, recording.board_ids[0]), 9.80665)
    reasons = judge_fit(replace(fit, outliers=fit.samples)).reasons
    (reason,) = [reason for reason in reasons if "outliers" in reason]
    assert "look at these samples in the original file" in reason
    assert "bus" not in reason


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ("serial", "the unit's pan_sign and tilt_sign"),
        ("file", "the signs of the reference's angles"),
    ],
)
def test_three_wrong_signs_can_be_those_of_the_reference(link: str, words: str) -> None:
    """A person who imported a file has no rig file with signs."""
    axes, _ = check_gain(-np.eye(3), link=link)
    assert f"{words} can be wrong instead" in axes.summary
