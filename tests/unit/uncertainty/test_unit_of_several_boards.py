"""Boards that are solved one after another on one emulated unit with axes that lean."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gyrorig_daemon import cli as daemon
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver import cli
from gyrorig_solver.check.true_values import _true_values
from gyrorig_solver.pipeline import UnitKnowledge
from gyrorig_solver.pipeline.unit_prior import unit_identity
from gyrorig_solver.uncertainty import default_settings

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]
BOARDS = 3
Captured = pytest.CaptureFixture[str]


@dataclass(frozen=True)
class Rig:
    """Recordings of several boards on one unit, and their calibrations in order."""

    recordings: list[Path]
    true_misalignments: list[Any]
    out: Path

    def solve(self, number: int, *options: str) -> int:
        """Solve one recording."""
        return cli.run(
            ["--quiet", "solve", str(self.recordings[number]), "--out", str(self.out), *options]
        )

    def calibration(self, version: int) -> Any:
        """Return a version of the board's calibration; every recording has the same board name."""
        (path,) = self.out.glob(f"*/v{version:04d}.yaml")
        return yaml.safe_load(path.read_text(encoding="utf-8"))

    def unit_versions(self) -> list[Path]:
        """Return the versions of the unit's posterior."""
        return sorted((self.out / "rigs").glob("*/v*.yaml"))


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """Solve each recording once, in order, with a search for causes."""
    folder = tmp_path_factory.mktemp("rig")
    recordings, truths = [], []
    for number in range(BOARDS):
        truth = folder / f"truth{number}.json"
        out = folder / str(number)
        assert daemon.run(
            ["record", "--config", str(ROOT / "config" / "rig.yaml"), "--program",
             str(ROOT / "config" / "programs" / "survey-40.yaml"), "--out", str(out),
             "--simulated-time", "--seed", str(100 + number), "--truth", str(truth),
             "--hide", "axis_nonorthogonality:0.0013"]
        ) == 0  # fmt: skip
        recordings.append(next(out.glob("*.mcap")))
        (board,) = json.loads(truth.read_text())["boards"].values()
        truths.append(np.array(_true_values(board)["misalignment"]))
    rig = Rig(recordings, truths, folder / "calibrations")
    for number in range(BOARDS):
        assert rig.solve(number) == 0
    return rig


def total_of(calibration: Any, parameter: str) -> float:
    return float(calibration["uncertainty"]["parameters"][parameter]["total"])


def test_the_total_uncertainty_shrinks_and_the_truth_stays_inside(rig: Rig) -> None:
    totals = []
    for number in range(BOARDS):
        calibration = rig.calibration(number + 1)
        error = np.array(calibration["parameters"]["misalignment"]["value"])
        error -= rig.true_misalignments[number]
        total = np.array([total_of(calibration, f"misalignment.{axis}") for axis in "xyz"])
        assert np.all(np.abs(error) <= 2.0 * total)
        totals.append(total)
    assert totals[2][1] < 0.4 * totals[0][1]
    assert totals[2][2] < 0.5 * totals[0][2]


def test_a_calibration_states_the_version_that_it_used(rig: Rig) -> None:
    priors = [rig.calibration(number + 1).get("unit_prior") for number in range(BOARDS)]
    assert priors[0] is None
    assert [prior["version"] for prior in priors[1:]] == [1, 2]
    assert [prior["recordings"] for prior in priors[1:]] == [1, 2]
    assert {prior["id"] for prior in priors[1:]} == {rig.unit_versions()[0].parent.name}


def test_solving_a_recording_again_changes_nothing(rig: Rig) -> None:
    versions_before = {path: path.read_bytes() for path in rig.unit_versions()}
    assert len(versions_before) == BOARDS
    assert rig.solve(1) == 0
    again, before = rig.calibration(BOARDS + 1), rig.calibration(2)
    for key in ("parameters", "covariance", "uncertainty", "unit_prior"):
        assert again[key] == before[key]
    assert {path: path.read_bytes() for path in rig.unit_versions()} == versions_before


def test_none_neither_reads_nor_writes(rig: Rig, tmp_path: Path) -> None:
    alone = Rig([rig.recordings[1]], [], tmp_path)
    assert alone.solve(0, "--unit-prior", "none") == 0
    assert alone.unit_versions() == []
    assert "unit_prior" not in alone.calibration(1)
    without_prior = total_of(alone.calibration(1), "misalignment.y")
    assert total_of(rig.calibration(2), "misalignment.y") < without_prior
    assert alone.solve(0, "--unit-prior", str(rig.unit_versions()[0])) == 0
    assert alone.unit_versions() == []
    assert alone.calibration(2)["parameters"] == rig.calibration(2)["parameters"]


def test_a_damaged_posterior_is_an_error_of_one_line(
    rig: Rig, tmp_path: Path, capsys: Captured
) -> None:
    newest = rig.unit_versions()[-1]
    damaged = tmp_path / "rigs" / newest.parent.name / "v0001.yaml"
    damaged.parent.mkdir(parents=True)
    damaged.write_bytes(newest.read_bytes()[:2000])
    alone = Rig([rig.recordings[0]], [], tmp_path)
    capsys.readouterr()
    assert alone.solve(0) == 3
    error = capsys.readouterr().err
    assert "v0001.yaml" in error
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("*/v0001.report.html"))


def test_a_unit_is_known_by_its_serial_number_then_by_its_rig(rig: Rig) -> None:
    recording: Any = read_recording(rig.recordings[0])
    identity = unit_identity([recording])
    assert identity is not None
    assert identity.identified_by == "serial"
    recording.metadata["gyrorig.ptu"].pop("serial")
    by_rig = unit_identity([recording])
    assert by_rig is not None
    assert by_rig.identified_by == "rig"
    assert by_rig.id == recording.metadata["gyrorig"]["rig"]
    recording.metadata["gyrorig"]["rig"] = "../../etc"
    assert unit_identity([recording]) is None
    assert unit_identity([]) is None
    assert UnitKnowledge().prior_of([recording], default_settings()) is None
