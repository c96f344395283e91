"""A section that is marked as a rest is used only if the board does not move in it."""

from pathlib import Path

import numpy as np
import pytest
from tests.support.reference_recordings import (
    BOARD,
    RateError,
    SimulatedGyro,
    record_rest,
    record_turns,
)

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers import ImportMap, check_import_map, import_measurements
from gyrorig_solver.pipeline import solve_recordings

GYRO = SimulatedGyro()


def hand(time_s: FloatArray, _rate: FloatArray, _force: FloatArray) -> FloatArray:
    """Return slow turns about all axes, without a mean."""
    phases = np.stack([0.7 * time_s + k for k in range(3)], axis=1)
    return np.asarray(np.radians(20.0) * np.sin(phases), np.float64)


def rate_table(time_s: FloatArray, _rate: FloatArray, _force: FloatArray) -> FloatArray:
    """Return a constant rate about the vertical."""
    return np.tile(np.radians([0.0, 0.0, 13.0]), (time_s.size, 1))


def one_turn(time_s: FloatArray, _rate: FloatArray, _force: FloatArray) -> FloatArray:
    """Return a rest with one turn by 90 deg in three seconds."""
    moves = ((time_s > 40.0) & (time_s < 43.0)).astype(np.float64)
    return np.outer(moves, np.radians([30.0, 0.0, 0.0]))


def short_turn(time_s: FloatArray, _rate: FloatArray, _force: FloatArray) -> FloatArray:
    """Return a rest with one turn by 14 deg in a fifth of a second."""
    moves = ((time_s > 40.0) & (time_s < 40.2)).astype(np.float64)
    return np.outer(moves, np.radians([70.0, 0.0, 0.0]))


def knock(time_s: FloatArray, _rate: FloatArray, _force: FloatArray) -> FloatArray:
    """Return a knock that lasts a twentieth of a second."""
    moves = ((time_s > 40.0) & (time_s < 40.05)).astype(np.float64)
    return np.outer(moves, np.radians([20.0, 0.0, 0.0]))


@pytest.mark.parametrize("with_accelerometer", [True, False])
@pytest.mark.parametrize(
    ("rate", "evidence"),
    [
        (hand, "the board moves in 100 %"),
        (rate_table, "or the unit of the rates is wrong"),
        (one_turn, "the board moves"),
        (short_turn, "the board moves in 3.39 %"),  # "in 0 %" of a long rest before
    ],
)
def test_motion_is_refused_with_its_times(
    tmp_path: Path, rate: RateError, evidence: str, with_accelerometer: bool
) -> None:
    path = record_rest(tmp_path / "r.mcap", GYRO, rate=rate, with_accelerometer=with_accelerometer)
    with pytest.raises(InputError, match=r"from 0\.0 s to 60\.0 s is marked as a rest") as fault:
        solve_recordings([read_recording(path)], BOARD)
    assert evidence in str(fault.value)


def test_a_pose_that_changes_is_seen_by_gravity(tmp_path: Path) -> None:
    """A turn by 6 deg in a second is short, and gravity is another one afterwards."""

    def tip(time_s: FloatArray, _rate: FloatArray, _force: FloatArray) -> FloatArray:
        moves = ((time_s > 30.0) & (time_s < 31.0)).astype(np.float64)
        return np.outer(moves, np.radians([8.0, 0.0, 0.0]))

    path = record_rest(tmp_path / "r.mcap", GYRO, rate=tip)
    with pytest.raises(InputError, match="the accelerometer shows"):
        solve_recordings([read_recording(path)], BOARD)


def test_a_knock_and_a_warm_up_are_at_rest(tmp_path: Path) -> None:
    warming = SimulatedGyro(
        error=lambda time_s, rate, _force: (
            np.radians(2.0) * (1.0 - np.exp(-time_s / 60.0))[:, None] + 0.0 * rate
        )
    )
    for k, (gyro, rate) in enumerate(((GYRO, knock), (warming, None))):
        path = record_rest(tmp_path / f"r{k}.mcap", gyro, rate=rate)
        assert solve_recordings([read_recording(path)], BOARD).observability.rank == 3


def test_a_rest_between_turns_is_checked_too(tmp_path: Path) -> None:
    """The map of a turn's file marks the turn itself as a rest."""
    path = record_turns(tmp_path / "t.mcap", GYRO, static_over_turns=True)
    with pytest.raises(InputError, match=r"from 3\.0 s to 7\.0 s is marked as a rest"):
        solve_recordings([read_recording(path)], BOARD)


@pytest.mark.parametrize("missing", ["dropout", "slower"])
def test_samples_without_an_acceleration_are_no_motion(tmp_path: Path, missing: str) -> None:
    """Before, they counted as 0 m/s^2: "its reading changes by up to 9.8 m/s^2"."""
    rng = np.random.default_rng(4)
    time_s = np.arange(6000) / 100.0
    force = np.tile([0.0, 0.0, 9.81], (6000, 1)) + 0.01 * rng.normal(size=(6000, 3))
    is_missing = (time_s > 20.0) & (time_s < 26.0)
    force[is_missing if missing == "dropout" else np.arange(6000) % 5 < 2] = np.nan
    np.savez(tmp_path / "in.npz", t=1.0 + time_s, g=1e-3 * rng.normal(size=(6000, 3)), a=force)
    text = f"""
    schema: gyrorig/import/1
    board: "{BOARD}"
    sensor: "X"
    time: {{key: t, unit: s}}
    gyro: {{keys: [g], unit: rad/s}}
    accel: {{keys: [a], unit: m/s2}}
    static: [{{end_s: 60.9}}]
    """
    mapping = check_import_map(convert_document(parse_yaml(text, "map"), ImportMap, "map"), "map")
    path = import_measurements(tmp_path / "in.npz", mapping, tmp_path / "out.mcap").path
    assert solve_recordings([read_recording(path)], BOARD).observability.rank == 3
