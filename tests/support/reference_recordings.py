"""Recordings with references by others, simulated from a known truth.

What to use when: `record_attitudes`, `record_turns`, `record_gravity` and `record_rest` write one
recording each. The truth is a `SimulatedGyro`. `PoseError` describes how a reference differs
from the true motion.

The motion is a rotation in closed form. The rate is its difference over a millisecond, without
any code of the solver. The recording is written by the importer, as a user would write it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from gyrorig_protocol.documents import convert_document
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers import ImportMap, import_measurements

BOARD, SENSOR, GRAVITY_M_S2 = "gyro-1", "ICM-20948", 9.81
GYRO_HZ, CAMERA_HZ = 200.0, 100.0
# Of time, rate and force. The rate is that of the sensor's axes for the error of a gyro.
RateError = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedGyro:
    """The true gain, bias and noise, and what the gyro adds to a rate."""

    gain: FloatArray = field(
        default_factory=lambda: np.array(
            [[1.012, 0.006, -0.004], [-0.005, 0.991, 0.008], [0.003, -0.007, 1.006]]
        )
    )
    bias_rad_s: tuple[float, float, float] = (0.01, -0.02, 0.005)
    noise_rad_s: float = 5e-4  # of a sample
    error: RateError | None = None  # what the gyro adds, rad/s

    def measure(
        self, time_s: FloatArray, rate_rad_s: FloatArray, force: FloatArray, seed: int
    ) -> FloatArray:
        """Return the gyro's readings of a body rate, (n, 3)."""
        rng = np.random.default_rng(9000 + seed)
        sensor_rate = rate_rad_s @ self.gain.T
        reading = sensor_rate + np.array(self.bias_rad_s)
        if self.error is not None:
            reading = reading + self.error(time_s, sensor_rate, force)
        return np.asarray(reading + self.noise_rad_s * rng.normal(size=reading.shape), np.float64)


@dataclass(frozen=True, slots=True)
class PoseError:
    """How reference attitudes differ from the true attitudes."""

    noise_rad: float = 3e-4  # grows with the motion, and wanders
    smoothing_s: float = 0.0  # standard deviation of the time that an attitude is the mean of
    delay_s: float = 0.004  # the samples of the gyro are late by it
    drift_rad_s: float = 0.0  # about the vertical, as of a heading without a magnetometer
    disturbance_rad: float = 0.0  # of the heading, by magnetic fields that depend on the heading
    flex_s2: float = 0.0  # a soft mount: angle per angular acceleration
    clock_skew: float = 0.0  # the clock of the attitudes is fast by it


@dataclass(frozen=True, slots=True, eq=False)
class HandMotion:
    """A board turned by hand between two rests: sums of sines, faded in and out."""

    seed: int
    span_s: float = 60.0
    rest_s: float = 8.0  # at both ends
    size: float = 1.0  # of the angles, 1: up to a radian

    def attitude(self, time_s: FloatArray) -> Rotation:
        """Return body to world."""
        rng = np.random.default_rng(self.seed)
        fade = np.clip((time_s - self.rest_s) / 2.0, 0.0, 1.0) * np.clip(
            (self.span_s - self.rest_s - time_s) / 2.0, 0.0, 1.0
        )
        fade = fade**2 * (3.0 - 2.0 * fade)
        angles = np.zeros((time_s.size, 3))
        for k in range(12):
            hertz, phase, size = rng.uniform(0.1, 1.0), rng.uniform(0, 6.3), rng.uniform(0.2, 0.6)
            angles[:, k % 3] += self.size * size * np.sin(2.0 * np.pi * hertz * time_s + phase)
        return Rotation.from_rotvec(fade[:, None] * angles)

    def rate_rad_s(self, time_s: FloatArray) -> FloatArray:
        """Return the body rate, (n, 3)."""
        before, after = self.attitude(time_s - 5e-4), self.attitude(time_s + 5e-4)
        return np.asarray((before.inv() * after).as_rotvec() / 1e-3)

    def seen(self, time_s: FloatArray, error: PoseError) -> Rotation:
        """Return the attitudes that a reference reports."""
        rng = np.random.default_rng(500 + self.seed)
        true_attitude = self.attitude(time_s)
        if error.smoothing_s > 0.0:
            # Gauss and Hermite's three points have a normal time's moments up to the fifth.
            width_s = np.sqrt(3.0) * error.smoothing_s
            at = [self.attitude(time_s + k * width_s).as_matrix() for k in (-1, 0, 1)]
            true_attitude = Rotation.from_matrix((at[0] + 4.0 * at[1] + at[2]) / 6.0)
        rate = self.rate_rad_s(time_s)
        if error.flex_s2:
            bend = error.flex_s2 * np.gradient(rate, time_s, axis=0)
            true_attitude = true_attitude * Rotation.from_rotvec(bend)
        heading = true_attitude.as_euler("ZYX")[:, 0]
        turn = error.drift_rad_s * time_s + error.disturbance_rad * np.sin(2.0 * heading)
        about_vertical = Rotation.from_rotvec(np.outer(turn, [0.0, 0.0, 1.0]))
        white = rng.normal(size=(time_s.size, 3))
        wander = lfilter([0.1], [1.0, -0.95], white, axis=0) + 0.2 * white
        speed = np.linalg.norm(rate, axis=1)
        noise = error.noise_rad * (0.3 + speed)[:, None] * wander
        return about_vertical * true_attitude * Rotation.from_rotvec(noise)


def record_attitudes(
    path: Path,
    gyro: SimulatedGyro,
    seed: int = 1,
    error: PoseError = PoseError(),
    motion: HandMotion | None = None,
    **more: Any,
) -> Path:
    """Write a recording with reference attitudes."""
    hand = HandMotion(seed) if motion is None else motion
    time_s = np.arange(int(hand.span_s * GYRO_HZ)) / GYRO_HZ
    at_s = np.arange(0.5, hand.span_s - 0.5, 1.0 / CAMERA_HZ)
    moved_s = time_s - error.delay_s
    rate, force = hand.rate_rad_s(moved_s), _force(hand.attitude(moved_s))
    return _write(
        path,
        {
            "t": time_s,
            "g": gyro.measure(time_s, rate, force, seed),
            "a": force,
            "qt": at_s * (1.0 + error.clock_skew),
            "q": hand.seen(at_s, error).as_quat(),
        },
        {"attitude": {"keys": ["q"], "order": "xyzw", "time": {"key": "qt"}}, **more},
    )


def record_turns(
    path: Path,
    gyro: SimulatedGyro,
    seed: int = 1,
    angle_std_deg: float = 0.2,
    revolutions: float = 1.0,
    repeats: int = 2,
    static_over_turns: bool = False,
) -> Path:
    """Write a recording with turns by known angles about each axis, both ways, and rests.

    With `static_over_turns`, the map marks the turns as rests.
    """
    rng = np.random.default_rng(700 + seed)
    parts, turns, static, at = [np.zeros((600, 3))], [], [{"start": 0, "end": 600}], 600
    for k in range(6 * repeats):
        axis, sign = np.eye(3)[k % 3], 1.0 if (k // 3) % 2 == 0 else -1.0
        angle = sign * 2.0 * np.pi * revolutions
        shape = 1.0 - np.cos(2.0 * np.pi * (np.arange(800) + 0.5) / 800)
        true_angle = angle + np.radians(angle_std_deg) * rng.normal()
        tilt = Rotation.from_rotvec(np.radians(0.3) * rng.normal(size=3))
        rate = np.outer(shape / shape.sum() * true_angle * GYRO_HZ, tilt.apply(axis))
        turns.append(
            {
                "axis": [float(v) for v in axis],
                "angle_deg": float(np.degrees(angle)),
                "std_deg": angle_std_deg,
                "over": {"start": at, "end": at + 800},
            }
        )
        first = at if static_over_turns else at + 800
        static.append({"start": first, "end": at + (800 if static_over_turns else 1200)})
        parts += [rate, np.zeros((400, 3))]
        at += 1200
    rate = np.concatenate(parts)
    time_s = np.arange(len(rate)) / GYRO_HZ
    reading = gyro.measure(time_s, rate, np.tile([0.0, 0.0, GRAVITY_M_S2], (len(rate), 1)), seed)
    return _write(path, {"t": time_s, "g": reading}, {"turns": turns, "static": static})


def record_gravity(path: Path, gyro: SimulatedGyro, seed: int = 1, moves: int = 24) -> Path:
    """Write a recording of a board held still in many poses, with its accelerometer."""
    rng = np.random.default_rng(300 + seed)
    pose = Rotation.random(random_state=seed)
    rates, forces = [np.zeros((2000, 3))], [np.repeat(_force(pose)[None], 2000, axis=0)]
    for _ in range(moves):
        axis = rng.normal(size=3)
        angle = rng.uniform(0.7, 1.6) * rng.choice([-1.0, 1.0])
        phase = (np.arange(400) + 0.5) / 400.0
        part = angle * (phase - np.sin(2.0 * np.pi * phase) / (2.0 * np.pi))
        axis = axis / np.linalg.norm(axis)
        forces.append(_force(pose * Rotation.from_rotvec(np.outer(part, axis))))
        rates.append(np.outer(angle / 2.0 * (1.0 - np.cos(2.0 * np.pi * phase)), axis))
        pose = pose * Rotation.from_rotvec(angle * axis)
        rates.append(np.zeros((500, 3)))
        forces.append(np.repeat(_force(pose)[None], 500, axis=0))
    rate, force = np.concatenate(rates), np.concatenate(forces)
    time_s = np.arange(len(rate)) / GYRO_HZ
    shake = np.where(np.linalg.norm(rate, axis=1) > 0.0, 0.4, 0.01)[:, None]
    reading = force + rng.normal(size=force.shape) * shake
    return _write(
        path,
        {"t": time_s, "g": gyro.measure(time_s, rate, force, seed), "a": reading},
        {"static": [{"start": 0, "end": 2000}]},
    )


def record_rest(
    path: Path,
    gyro: SimulatedGyro,
    seed: int = 1,
    span_s: float = 60.0,
    rate: RateError | None = None,
    with_accelerometer: bool = True,
) -> Path:
    """Write a recording that its map calls a rest; `rate` is what moves the board in truth."""
    time_s = np.arange(int(span_s * GYRO_HZ)) / GYRO_HZ
    force = np.tile([0.0, 0.0, GRAVITY_M_S2], (time_s.size, 1))
    true_rate = np.zeros((time_s.size, 3))
    if rate is not None:
        true_rate = rate(time_s, true_rate, force)
        steps = Rotation.from_rotvec(true_rate / GYRO_HZ)
        force = _integrate(steps, force[0])
    data = {"t": time_s, "g": gyro.measure(time_s, true_rate, force, seed)}
    if with_accelerometer:
        noise = np.random.default_rng(100 + seed).normal(size=force.shape)
        data["a"] = force + 0.01 * noise
    return _write(path, data, {"static": [{"start": 0, "end": time_s.size}]})


def _integrate(steps: Rotation, force: FloatArray) -> FloatArray:
    """Return the force before each step, by a prefix scan of the steps."""
    poses, shift = steps, 1
    while shift < len(steps):
        poses = Rotation.concatenate([poses[:shift], poses[:-shift] * poses[shift:]])
        shift *= 2
    before = Rotation.concatenate([Rotation.identity(1), poses[:-1]])
    return np.asarray(before.inv().apply(force), dtype=np.float64)


def _force(attitude: Rotation) -> FloatArray:
    return np.asarray(attitude.inv().apply([0.0, 0.0, GRAVITY_M_S2]), np.float64)


def _write(path: Path, data: dict[str, FloatArray], more: dict[str, Any]) -> Path:
    source = path.with_suffix(".npz")
    np.savez(source, **data)  # type: ignore[arg-type] # the stub takes arrays only
    document: dict[str, Any] = {
        "schema": "gyrorig/import/1",
        "board": BOARD,
        "sensor": SENSOR,
        "time": {"key": "t"},
        "gyro": {"keys": ["g"], "unit": "rad/s"},
        **({"accel": {"keys": ["a"], "unit": "m/s2"}} if "a" in data else {}),
        **more,
    }
    mapping = convert_document(document, ImportMap, "map")
    return import_measurements(source, mapping, path).path
