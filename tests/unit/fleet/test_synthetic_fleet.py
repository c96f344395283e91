"""The makers of synthetic fleets: the same draw again, and what is hidden is in it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.bench.bench_fleet_statistics import Fleet, hidden_in, ours, plan_of
from tests.bench.fleet.make import make, spoil
from tests.bench.fleet.nights import Broken, FleetDraw, Session, sessions_of, truth_of
from tests.bench.fleet.shewhart import beyond

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.reader import read_recording

DRAW = FleetDraw(boards=12, nights=4, rigs=2, lots=3, at_once=3, seed=5)


def session(draw: FleetDraw, board: int, night: int) -> Session:
    return next(s for s in sessions_of(draw) if s.night == night and board in s.boards)


def test_every_board_is_measured_on_its_rig_every_night() -> None:
    sessions = list(sessions_of(DRAW))
    assert [item.number for item in sessions] == list(range(len(sessions)))
    seen = sorted((item.night, board) for item in sessions for board in item.boards)
    assert seen == [(night, board) for night in range(4) for board in range(12)]
    assert all(DRAW.rig_of(board) == item.rig for item in sessions for board in item.boards)


def test_a_session_can_be_recorded_again_alone() -> None:
    item = session(DRAW, 4, 2)
    first, again = (truth_of(DRAW, item).boards["B000004"] for _ in range(2))
    assert np.array_equal(first.imu.gain, again.imu.gain)
    other = truth_of(DRAW, session(DRAW, 4, 3)).boards["B000004"]
    change = np.abs(other.imu.gain - first.imu.gain).max()
    assert 1e-6 < change < 5e-3  # a night's scatter, the same part
    assert first.clock == other.clock


def test_hidden_faults_are_in_the_recordings() -> None:
    plain = truth_of(DRAW, session(DRAW, 5, 3)).boards["B000005"]
    lot = DRAW.lot_of(5)
    bad = replace(DRAW, bad_lot=(lot, 0.03))
    scale = truth_of(bad, session(bad, 5, 3)).boards["B000005"].scale
    assert np.diag(scale - plain.scale) == pytest.approx([0.0, 0.0, 0.03])
    wrong = replace(DRAW, constant=0.14)
    scale = truth_of(wrong, session(wrong, 5, 3)).boards["B000005"].scale
    assert np.diag(scale - plain.scale) == pytest.approx(0.14)
    rig = replace(DRAW, rig_drift=(DRAW.rig_of(5), 2, 1e-3))
    turned = truth_of(rig, session(rig, 5, 3)).boards["B000005"].imu.mounting
    angle = np.arccos((np.trace(plain.imu.mounting.T @ turned) - 1.0) / 2.0)
    assert angle == pytest.approx(2e-3, rel=1e-6)


def test_recordings_exist_and_damaged_ones_are_refused(tmp_path: Path) -> None:
    draw = FleetDraw(boards=1, nights=1, rigs=1, lots=1, at_once=1, seed=2)
    assert make(tmp_path, draw, "quick") == 1
    assert make(tmp_path, draw, "quick") == 0
    (good,) = (tmp_path / "spool").iterdir()
    assert read_recording(good).board_ids == ("B000000",)
    assert (tmp_path / "boards.csv").read_text().splitlines()[1] == "B000000,lot-0,north"
    kinds: tuple[Broken, ...] = ("truncated", "garbled", "foreign", "empty")
    for how in kinds:
        path = tmp_path / f"{how}.mcap"
        path.write_bytes(good.read_bytes())
        spoil(path, how)
        if how in ("truncated", "garbled"):
            assert read_recording(path).losses
            continue
        with pytest.raises(InputError):
            read_recording(path)


def test_shewhart_limits_are_three_standard_deviations() -> None:
    rng = np.random.default_rng(3)
    result = beyond(rng.normal(size=(200, 2000)))
    assert not result[:10].any()
    # ten points make poor limits: more than the 0.27 % of known ones
    assert 0.005 < result[10:].mean() < 0.04


def test_the_benchmark_tests_a_fleet_as_the_command_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.bench.bench_fleet_statistics.NIGHTS", 28)
    plan = replace(plan_of(3, "rig", 0.5), boards=80, nights=28)
    fleet = Fleet(plan)
    reported = ours(fleet, "rig")
    assert hidden_in(plan, "rig") is not None
    assert reported.delay is not None
    assert reported.wrong == 0
