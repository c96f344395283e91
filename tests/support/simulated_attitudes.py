"""Attitudes by others, simulated: a board turned by hand, a camera, and the stamps of both.

What to use when: `simulate_attitudes` for the samples and the attitudes of one session as
somebody would record them, with a `StampSettings` for what is wrong with the stamps and the
poses. The motion is known in closed form, and nothing here is shared with the solver or the
emulator.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from gyrorig_solver.data import FloatArray, IntArray

GAIN = np.array([[1.012, 0.013, -0.006], [-0.009, 0.984, 0.017], [0.004, -0.011, 1.008]])
BIAS_RAD_S = np.array([0.011, -0.024, 0.006])
LAG_S = 0.0071  # the stamps of the gyro are late


@dataclass(frozen=True, slots=True)
class StampSettings:
    """What is wrong with the stamps and the poses of a reference."""

    jitter_s: float = 0.0  # standard deviation, or the scale of a delay
    kind: str = "device"  # symmetric ("device"), half-normal ("arrival") or "exponential"
    skew_ppm: float = 0.0  # of the camera's clock
    step_s: float = 0.0  # of the camera's clock, at half time
    drop_share: float = 0.0
    repeat_share: float = 0.0  # poses that are sent twice instead of the new one
    outlier_share: float = 0.0
    lost_s: float = 0.0  # a stretch without tracking
    swap: tuple[float, float, float] | None = None  # rotation vector, body frame, in the last third
    irregular_s: float = 0.0  # the camera's own frames are irregular by so much, truly


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedAttitudes:
    """The session as recorded, and the truth."""

    gyro_time_s: FloatArray  # (n,), on the capture clock
    gyro_rad_s: FloatArray  # (n, 3)
    stamp_s: FloatArray  # (m,), of the attitudes, in the order of the file
    orientation_xyzw: FloatArray  # (m, 4)
    frame: IntArray  # (m,), the true number of the camera's frame
    true_time_s: FloatArray  # (m,), capture clock
    gain: FloatArray = field(default_factory=GAIN.copy)
    bias_rad_s: FloatArray = field(default_factory=BIAS_RAD_S.copy)
    lag_s: float = LAG_S  # of the gyro's stamps, on the capture clock
    clock_error_s: float = 0.0  # of the camera's clock, the mean over the attitudes

    @property
    def time_offset_s(self) -> float:
        """The delay of the gyro's stamps after those of the camera, the mean over the attitudes."""
        return self.lag_s - self.clock_error_s


@dataclass(frozen=True, slots=True, eq=False)
class HandMotion:
    """Turns about all axes, z-y-x Euler angles that are sums of sines."""

    seed: int
    speed: float = 1.0

    def _angles(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        rng = np.random.default_rng(self.seed)
        angle, rate = np.zeros((time_s.size, 3)), np.zeros((time_s.size, 3))
        for axis in range(3):
            for _ in range(4):
                f = rng.uniform(0.05, 1.2) * self.speed
                phase = rng.uniform(0.0, 2.0 * np.pi)
                size = rng.uniform(0.1, 0.4) * (0.7 if axis == 1 else 1.5)
                angle[:, axis] += size * np.sin(2.0 * np.pi * f * time_s + phase)
                rate[:, axis] += size * 2.0 * np.pi * f * np.cos(2.0 * np.pi * f * time_s + phase)
        return angle, rate

    def attitude(self, time_s: FloatArray) -> Rotation:
        """Return body into world."""
        return Rotation.from_euler("ZYX", self._angles(time_s)[0])

    def rate_rad_s(self, time_s: FloatArray) -> FloatArray:
        """Return the body rate, (n, 3), from the rates of the Euler angles."""
        angle, rate = self._angles(time_s)
        (da, db, dc), b, c = rate.T, angle[:, 1], angle[:, 2]
        return np.stack(
            [
                dc - np.sin(b) * da,
                np.cos(c) * db + np.sin(c) * np.cos(b) * da,
                -np.sin(c) * db + np.cos(c) * np.cos(b) * da,
            ],
            axis=1,
        )


def simulate_attitudes(
    seed: int,
    settings: StampSettings = StampSettings(),
    *,
    span_s: float = 60.0,
    camera_hz: float = 100.0,
    gyro_hz: float = 200.0,
    angle_noise_rad: float = 5e-4,
    rate_noise_rad_s: float = 1e-3,
    motion: HandMotion | None = None,
) -> SimulatedAttitudes:
    """Return one session.

    Args:
        seed: of the motion and of all noise.
        settings: of the stamps and the poses.
        span_s: duration.
        camera_hz: frames per second of the camera's clock.
        gyro_hz: samples per second.
        angle_noise_rad: of each attitude, per axis, white.
        rate_noise_rad_s: of each sample, white.
        motion: instead of the one of the seed.
    """
    rng = np.random.default_rng([seed, 18])
    motion = HandMotion(seed) if motion is None else motion
    gyro_time_s = np.arange(int(span_s * gyro_hz)) / gyro_hz
    true_rate = motion.rate_rad_s(gyro_time_s - LAG_S)
    gyro = true_rate @ GAIN.T + BIAS_RAD_S + rate_noise_rad_s * rng.normal(size=true_rate.shape)
    frame = np.arange(int((span_s - 0.2) * camera_hz))
    clock_s = 0.1 + frame / camera_hz  # the camera's clock
    true_s = 0.1 + (clock_s - 0.1) / (1.0 + 1e-6 * settings.skew_ppm)
    if settings.irregular_s:
        irregular_part_s = settings.irregular_s * rng.normal(size=frame.size)
        true_s, clock_s = true_s + irregular_part_s, clock_s + irregular_part_s
    clock_s = clock_s + np.where(true_s > span_s / 2.0, settings.step_s, 0.0)
    pose = motion.attitude(true_s) * Rotation.from_rotvec(
        angle_noise_rad * rng.normal(size=(frame.size, 3))
    )
    if settings.swap is not None:
        is_swapped = true_s > 2.0 * span_s / 3.0
        pose = pose * Rotation.from_rotvec(np.outer(is_swapped, settings.swap))
    if settings.outlier_share:
        is_outlier = rng.random(frame.size) < settings.outlier_share
        wrong = rng.normal(size=(frame.size, 3)) * is_outlier[:, None]
        pose = pose * Rotation.from_rotvec(wrong)
    orientation = np.asarray(pose.as_quat(), dtype=np.float64)
    if settings.repeat_share:
        for k in np.flatnonzero(rng.random(frame.size) < settings.repeat_share).tolist():
            orientation[k] = orientation[max(k - 1, 0)]
    is_sent = rng.random(frame.size) >= settings.drop_share
    if settings.lost_s:
        is_sent &= np.abs(true_s - 0.4 * span_s) > settings.lost_s / 2.0
    error_s = clock_s - true_s
    stamp_s = clock_s + _stamp_errors(rng, settings, frame.size)
    if settings.kind != "device":
        stamp_s = np.maximum.accumulate(stamp_s)  # a link delivers in order
    return SimulatedAttitudes(
        gyro_time_s,
        gyro,
        stamp_s[is_sent],
        orientation[is_sent],
        frame[is_sent],
        true_s[is_sent],
        clock_error_s=float(np.mean(error_s[is_sent])),
    )


def _stamp_errors(rng: np.random.Generator, settings: StampSettings, count: int) -> FloatArray:
    if settings.kind == "arrival":
        return np.abs(settings.jitter_s * rng.normal(size=count))
    if settings.kind == "exponential":
        return settings.jitter_s * rng.exponential(size=count)
    return settings.jitter_s * rng.normal(size=count)
