"""Gravity at rest against attitudes composed by scipy's rotations: what it tells and what not."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrorig_protocol.errors import InputError
from gyrorig_solver.model.leveling import (
    LEVEL_STD_RAD,
    estimate_level,
    level_from_rests,
)

TILTS = np.radians([-60.0, -35.0, -10.0, 15.0, 30.0])
PANS = np.radians([-150.0, -60.0, 20.0, 110.0])
STD = 0.002


def about(axis: str, angle_rad: Any) -> Rotation:
    """Rotation about x, y or z by one angle or many."""
    unit = np.eye(3)["xyz".index(axis)]
    return Rotation.from_rotvec(np.multiply.outer(np.asarray(angle_rad), unit))


def readings(
    pan: np.ndarray,
    tilt: np.ndarray,
    zero: float,
    mount: Rotation,
    lean: tuple[float, float],
    rng: np.random.Generator,
    std: float = STD,
) -> np.ndarray:
    """A board's accelerometer with its own scale and bias, on a leaning unit."""
    up = np.array([lean[0], lean[1], 1.0])
    stage = about("z", pan) * about("x", tilt + zero)
    force = 9.81 * stage.inv().apply(up / np.linalg.norm(up))
    felt = mount.apply(force) * np.array([1.02, 0.97, 1.01])
    return np.asarray(felt + np.array([0.3, -0.4, 0.8]) + rng.normal(0.0, std, felt.shape))


def grid() -> tuple[np.ndarray, np.ndarray]:
    pan, tilt = np.meshgrid(PANS, TILTS)
    return pan.ravel(), tilt.ravel()


def test_offset_and_lean_are_recovered() -> None:
    pan, tilt = grid()
    rng = np.random.default_rng(3)
    off = []
    for _ in range(300):
        zero, mount_x = rng.normal(0.0, 0.01, 2)
        lean = (float(rng.normal(0.0, 0.01)), float(rng.normal(0.0, 0.01)))
        mount = Rotation.from_rotvec([mount_x, 0.0, 0.0])
        level = estimate_level(pan, tilt, readings(pan, tilt, zero, mount, lean, rng), STD)
        off.append(
            [
                (level.offset_rad - (zero - mount_x)) / level.offset_std_rad,
                *((level.lean_rad - np.array(lean)) / level.lean_std_rad),
            ]
        )
        assert np.all(level.lean_std_rad < 0.5 * LEVEL_STD_RAD)
    spread = np.std(off, axis=0)
    assert np.all((spread > 0.85) & (spread < 1.15))
    assert np.all(np.abs(np.mean(off, axis=0)) < 0.25)


def test_mount_and_tilt_zero_are_inseparable() -> None:
    """The same readings from a zero and from a mount: nothing may tell them apart."""
    pan, tilt = grid()
    levels = [
        estimate_level(
            pan,
            tilt,
            readings(
                pan,
                tilt,
                zero,
                Rotation.from_rotvec([mount, 0, 0]),
                (0, 0),
                np.random.default_rng(0),
            ),
            STD,
        )
        for zero, mount in ((0.02, 0.0), (0.0, -0.02), (0.05, 0.03))
    ]
    for level in levels:
        assert level.offset_rad == pytest.approx(0.02, abs=4 * level.offset_std_rad)


def test_at_one_pan_lean_and_offset_are_inseparable() -> None:
    pan = np.full(TILTS.size, 0.6)
    lean = (0.01, 0.02)
    rng = np.random.default_rng(1)
    reading = readings(pan, TILTS, 0.005, Rotation.identity(), lean, rng)
    level = estimate_level(pan, TILTS, reading, STD)
    assert np.any(level.lean_std_rad > 0.5 * LEVEL_STD_RAD)
    assert level.offset_std_rad == pytest.approx(LEVEL_STD_RAD, rel=0.1)


@pytest.mark.parametrize("tilts", [[0.0, 0.0, 0.001], [0.0, 0.1, 0.2], [-0.5, 0.5]])
def test_too_small_tilt_range_is_rejected(tilts: list[float]) -> None:
    pan, tilt = np.zeros(len(tilts)), np.array(tilts)
    with pytest.raises(InputError, match="the board is level cannot be measured"):
        estimate_level(pan, tilt, np.zeros((len(tilts), 3)), STD)


def recorded(rest_scatter: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples of a unit that goes from pose to pose, ringing after each stop."""
    pan, tilt = grid()
    rng = np.random.default_rng(seed)
    means = readings(pan, tilt, 0.01, Rotation.identity(), (0.004, -0.006), rng, rest_scatter)
    rate_hz, rest, move = 100.0, 150, 80
    angles, accel = [], []
    for k in range(pan.size):
        stand = np.repeat([[pan[k]], [tilt[k]]], rest, axis=1)
        ring = np.exp(-np.arange(rest) / 5.0)[:, None] * rng.normal(0.0, 3.0, (rest, 3))
        angles.append(stand)
        accel.append(means[k] + (ring if k else 0.0) + rng.normal(0.0, 0.03, (rest, 3)))
        if k + 1 < pan.size:
            share = (np.arange(move) + 0.5) / move
            way = np.array([[pan[k + 1] - pan[k]], [tilt[k + 1] - tilt[k]]])
            angles.append(stand[:, :1] + way * share)
            accel.append(rng.normal(0.0, 5.0, (move, 3)))
    angle = np.concatenate(angles, axis=1)
    return np.arange(angle.shape[1]) / rate_hz, np.concatenate(accel), angle


@pytest.mark.parametrize("rest_scatter", [0.0, 0.02])
def test_level_is_estimated_from_rests(rest_scatter: float) -> None:
    off = []
    for seed in range(60):
        level = level_from_rests(*recorded(rest_scatter, seed))
        assert level.rests == 20
        off.append((level.offset_rad - 0.01) / level.offset_std_rad)
    assert 0.75 < np.std(off) < 1.25


def test_recording_without_rests_is_rejected() -> None:
    time_s = np.arange(0.0, 10.0, 0.01)
    with pytest.raises(InputError, match="no accelerometer samples from a rest"):
        level_from_rests(time_s, np.zeros((time_s.size, 3)), np.stack([time_s, 0.0 * time_s]))
