"""Tables of measurements from a known motion: attitudes, turns by known angles, gravity.

What to use when: through `materials`. Each function writes a log and its column map; the motion
is given by formulas, and the noise by numpy's generator with a fixed seed.
"""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

FloatArray = npt.NDArray[np.float64]
GAIN = np.array([[1.021, 0.013, -0.006], [-0.009, 0.984, 0.017], [0.004, -0.011, 1.008]])
BIAS_RAD_S = np.array([0.011, -0.024, 0.006])
GRAVITY_M_S2 = 9.81
RATE_HZ = 100.0


def _write_map(out: Path, board: str, **more: object) -> None:
    document = {"schema": "gyrorig/import/1", "board": board, "sensor": "MPU-6050", **more}
    (out / "map.yaml").write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")


def _reading(rate_rad_s: FloatArray, noise_rad_s: float, rng: np.random.Generator) -> FloatArray:
    """Return what a sensor of gain GAIN and bias BIAS_RAD_S reads."""
    noise = rng.normal(size=rate_rad_s.shape) * noise_rad_s
    reading: FloatArray = rate_rad_s @ GAIN.T + BIAS_RAD_S + noise
    return reading


def _rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation matrix of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: FloatArray = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return matrix


def _tumbling(time_s: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return angles about z, y, x as sums of sines, and their rates; shape (n, 3)."""
    angle, rate = np.zeros((time_s.size, 3)), np.zeros((time_s.size, 3))
    for axis in range(3):
        for _ in range(4):
            frequency_hz, phase = rng.uniform(0.05, 1.2), rng.uniform(0.0, 2 * np.pi)
            size = rng.uniform(0.1, 0.4) * (0.7 if axis == 1 else 1.5)
            omega = 2 * np.pi * frequency_hz
            angle[:, axis] += size * np.sin(omega * time_s + phase)
            rate[:, axis] += size * omega * np.cos(omega * time_s + phase)
    return angle, rate


def make_attitude(out: Path) -> None:
    """Write 60 s of tumbling with a reference attitude: quaternions w, x, y, z."""
    rng = np.random.default_rng(71)
    time_s = np.arange(round(60.0 * RATE_HZ)) / RATE_HZ
    # it is at rest for 10 s, then the motion grows over 2 s
    ramp = np.clip((time_s - 10.0) / 2.0, 0.0, 1.0)
    share = ramp**2 * (3 - 2 * ramp)
    share_rate = 6 * ramp * (1 - ramp) / 2.0
    angle, rate = _tumbling(time_s, rng)
    rate = rate * share[:, None] + angle * share_rate[:, None]
    angle = angle * share[:, None]
    (da, db, dc), (_, b, c) = rate.T, angle.T
    body = np.stack(
        [
            dc - np.sin(b) * da,
            np.cos(c) * db + np.sin(c) * np.cos(b) * da,
            -np.sin(c) * db + np.cos(c) * np.cos(b) * da,
        ],
        axis=1,
    )
    # half the angles' noise of 1 mrad, as a camera system has it
    noise = rng.normal(size=angle.shape) * 1e-3
    (ca, cb, cc), (sa, sb, sc) = np.cos((angle + noise).T / 2), np.sin((angle + noise).T / 2)
    quaternion = np.stack(
        [
            ca * cb * cc + sa * sb * sc,
            ca * cb * sc - sa * sb * cc,
            ca * sb * cc + sa * cb * sc,
            sa * cb * cc - ca * sb * sc,
        ],
        axis=1,
    )
    reading = _reading(body, 2e-3, rng)
    np.savez(out / "log.npz", t=time_s, gyr=reading, quat=quaternion)
    _write_map(
        out,
        "ATT-1",
        time={"key": "t", "unit": "s"},
        gyro={"keys": ["gyr"], "unit": "rad/s"},
        attitude={"keys": ["quat"], "order": "wxyz"},
        static=[{"end_s": 9.5}],
    )


def make_turns(out: Path) -> None:
    """Write a table that was turned by two full turns about each axis between rests."""
    rng = np.random.default_rng(72)
    time_s = np.arange(round(64.0 * RATE_HZ)) / RATE_HZ
    rate = np.zeros((time_s.size, 3))
    turns, rests = [], [{"end_s": 3.5}]
    for axis in range(3):
        begin_s = 4.0 + 20.0 * axis
        phase = np.clip((time_s - begin_s) / 16.0, 0.0, 1.0)
        rate[:, axis] = 4 * np.pi / 16.0 * (1 - np.cos(2 * np.pi * phase))
        over = {"begin_s": begin_s - 0.2, "end_s": begin_s + 16.2}
        direction = np.eye(3)[axis].tolist()
        turns.append({"axis": direction, "angle_deg": 720.0, "std_deg": 0.05, "over": over})
        rests.append({"begin_s": begin_s + 16.4, "end_s": begin_s + 19.6})
    degrees = np.degrees(_reading(rate, 1e-3, rng))
    lines = ["t,gx,gy,gz"]
    for at_s, (x, y, z) in zip(time_s.tolist(), degrees.tolist(), strict=True):
        lines.append(f"{at_s:.2f},{x:.5f},{y:.5f},{z:.5f}")
    (out / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    gyro: dict[str, Any] = {"keys": ["gx", "gy", "gz"], "unit": "deg/s", "full_scale_dps": 250.0}
    time = {"key": "t", "unit": "s"}
    _write_map(out, "TURN-1", time=time, gyro=gyro, static=rests, turns=turns)


def make_gravity(out: Path) -> None:
    """Write a sensor moved by hand: rests in 21 poses, smooth turns between them."""
    rng = np.random.default_rng(73)
    attitude, up = np.eye(3), np.array([0.0, 0.0, 1.0])
    rates, ups = [np.zeros((1200, 3))], [np.tile(attitude.T @ up, (1200, 1))]
    phase = np.arange(200) / 200.0
    share = phase - np.sin(2 * np.pi * phase) / (2 * np.pi)
    for _ in range(20):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        size = rng.uniform(0.7, 1.6) * rng.choice([-1.0, 1.0])
        rates.append(size / 2.0 * (1 - np.cos(2 * np.pi * phase))[:, None] * axis)
        ups.append(np.array([(attitude @ _rotation(size * s * axis)).T @ up for s in share]))
        attitude = attitude @ _rotation(size * axis)
        rates.append(np.zeros((300, 3)))
        ups.append(np.tile(attitude.T @ up, (300, 1)))
    rate, force = np.concatenate(rates), GRAVITY_M_S2 * np.concatenate(ups)
    shake = np.where(np.linalg.norm(rate, axis=1) > 0.0, 0.4, 0.01)[:, None]
    sensor = np.array([[1.013, -0.008, 0.005], [0.0, 0.991, 0.012], [0.0, 0.0, 1.004]])
    offset_m_s2 = np.array([0.11, -0.23, 0.07])
    accel = force @ np.linalg.inv(sensor).T + offset_m_s2 + rng.normal(size=force.shape) * shake
    time_s = np.arange(len(rate)) / RATE_HZ
    np.savez(out / "log.npz", t=time_s, gyr=_reading(rate, 3e-3, rng), acc=accel)
    _write_map(
        out,
        "HAND-1",
        time={"key": "t", "unit": "s"},
        gyro={"keys": ["gyr"], "unit": "rad/s"},
        accel={"keys": ["acc"], "unit": "m/s2"},
        gravity_m_s2=GRAVITY_M_S2,
        static=[{"end_s": 10.0}],
    )
