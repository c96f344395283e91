"""Conventions of a reference's quaternions, tested with the gyro.

Quaternions from other programs can map world to body, or have the scalar in another place. Each of
these readings gives other body rates, and the right one agrees with the gyro up to a rotation of
the mount and a bias. The residual decides only half of that. A wrong order of the components is
equivalent to a wrong direction of the map together with turned axes, because an odd permutation of
the components of a quaternion is a conjugation between two fixed rotations. So among the readings
with equal residuals, the one with the smallest rotation of the mount is the likely one.

What to use when: `judge_conventions` for the residuals, `check_convention` before a fit,
`mirrored_gain` for the axes of the gyro.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.attitude.attitude_matching import (
    MAX_LAG_S,
    AttitudeSegment,
    coarse_lag_s,
    match_segments,
)
from gyrorig_solver.reference import AttitudeReference

MEAN_S = 0.1  # rates are means over this time, in which the noise of a camera is small
# The reading as recorded is wrong if another one has a residual smaller by this factor.
MIN_RESIDUAL_RATIO = 3.0
# This ratio is sufficient if the mount is straight in the other reading and turned as recorded.
MIN_STRAIGHT_RATIO = 1.2
# Readings whose residuals differ by less agree equally well.
EQUAL_RATIO = 1.1
# A mount turned by more than the first angle is not straight; by less than the second, it is.
MIN_TURNED_MOUNT_RAD, MAX_STRAIGHT_MOUNT_RAD = np.radians(80.0), np.radians(15.0)
# A reading whose residual is a larger share of the gyro's motion explains nothing.
MAX_EXPLAINED_SHARE = 0.5
# If the residual is below this share, no other reading is better by the ratio above, because a
# wrong direction of the map reverses the rates of at least one of three axes.
CLEAR_SHARE = 0.1
MAX_UNRELATED_SHARE = 0.55
MIN_MOTION_RAD_S = np.radians(3.0)  # with less motion, the data do not show the convention
TRIMMED_SHARE = 0.5  # of the largest residuals: outliers of the reference

AS_RECORDED = "as recorded"
_READINGS = (
    (AS_RECORDED, (0, 1, 2, 3), False, "", ""),
    (
        "conjugated",
        (0, 1, 2, 3),
        True,
        "the quaternions map world to body",
        "change `maps` under `attitude` in the import map, which is body_to_world if it is not "
        "given",
    ),
    (
        "read as xyzw",
        (3, 0, 1, 2),
        False,
        "the quaternions have the order xyzw",
        "set `order: xyzw` under `attitude` in the import map",
    ),
    (
        "read as xyzw and conjugated",
        (3, 0, 1, 2),
        True,
        "the quaternions have the order xyzw and map world to body",
        "set `order: xyzw` and change `maps` under `attitude` in the import map",
    ),
    (
        "read as wxyz",
        (1, 2, 3, 0),
        False,
        "the quaternions have the order wxyz",
        "set `order: wxyz` under `attitude` in the import map",
    ),
    (
        "read as wxyz and conjugated",
        (1, 2, 3, 0),
        True,
        "the quaternions have the order wxyz and map world to body",
        "set `order: wxyz` and change `maps` under `attitude` in the import map",
    ),
)


@dataclass(frozen=True, slots=True)
class ConventionResidual:
    """One reading of the quaternions, and the residual of the gyro's rates with it."""

    reading: str
    residual_rad_s: float  # rms after the best rotation and bias
    mount_rad: float  # this rotation, from the reference's body frame to the sensor
    meaning: str  # of the quaternions, if this reading is right
    remedy: str


@dataclass(frozen=True, slots=True)
class ConventionJudgement:
    """All readings, the best one first; of equal ones, the one with the straightest mount."""

    residuals: tuple[ConventionResidual, ...]
    motion_rad_s: float  # rms of the gyro's rates about their mean

    @property
    def as_recorded(self) -> ConventionResidual:
        """The residual of the quaternions as recorded."""
        return next(each for each in self.residuals if each.reading == AS_RECORDED)

    @property
    def is_decided(self) -> bool:
        """True if the readings differ, and the reading as recorded is one of the right ones."""
        worst = self.residuals[-1].residual_rad_s
        return (
            self.motion_rad_s > MIN_MOTION_RAD_S
            and worst > MIN_RESIDUAL_RATIO * self.as_recorded.residual_rad_s
        )

    @property
    def is_turned(self) -> bool:
        """True if another order of the components agrees as well, and makes a straight mount."""
        best, recorded = self.residuals[0], self.as_recorded
        return (
            self.is_decided
            and recorded.residual_rad_s < EQUAL_RATIO * best.residual_rad_s
            and recorded.mount_rad > MIN_TURNED_MOUNT_RAD
            and best.mount_rad < MAX_STRAIGHT_MOUNT_RAD
        )

    @property
    def is_wrong(self) -> bool:
        """True if a reading other than the recorded one is right."""
        best, recorded = self.residuals[0], self.as_recorded
        is_straightened = (
            recorded.mount_rad > MIN_TURNED_MOUNT_RAD and best.mount_rad < MAX_STRAIGHT_MOUNT_RAD
        )
        ratio = MIN_STRAIGHT_RATIO if is_straightened else MIN_RESIDUAL_RATIO
        return (
            self.motion_rad_s > MIN_MOTION_RAD_S
            and best.residual_rad_s < MAX_EXPLAINED_SHARE * self.motion_rad_s
            and recorded.residual_rad_s > ratio * best.residual_rad_s
        )

    @property
    def is_unrelated(self) -> bool:
        """True if no reading explains any of the motion."""
        return (
            self.motion_rad_s > MIN_MOTION_RAD_S
            and self.residuals[0].residual_rad_s > MAX_UNRELATED_SHARE * self.motion_rad_s
        )


def judge_conventions(
    samples: GyroSamples, reference: AttitudeReference
) -> ConventionJudgement | None:
    """Return the residual of each reading of the quaternions; None without common times."""
    residuals, motion = [], 0.0
    for reading, order, is_conjugated, meaning, remedy in _READINGS:
        orientation = reference.orientation_xyzw[:, order]
        if is_conjugated:
            orientation = orientation * [-1.0, -1.0, -1.0, 1.0]
        segments = match_segments(samples, replace(reference, orientation_xyzw=orientation))
        if not segments:
            return None
        residual, motion, mount_rad = _residual(segments)
        residuals.append(ConventionResidual(reading, residual, mount_rad, meaning, remedy))
    least = min(each.residual_rad_s for each in residuals)
    residuals.sort(
        key=lambda each: (
            (0.0, each.mount_rad)
            if each.residual_rad_s < EQUAL_RATIO * least
            else (each.residual_rad_s, 0.0)
        )
    )
    return ConventionJudgement(tuple(residuals), motion)


def check_convention(samples: GyroSamples, reference: AttitudeReference) -> str:
    """Check that the quaternions are body to world, in the order of the recording.

    Returns:
        A remark if another order of the components is likely; else an empty text.

    Raises:
        InputError: another reading agrees with the gyro, or none does.
    """
    segments = match_segments(samples, reference)
    if not segments:
        return ""
    residual, motion, mount_rad = _residual(segments)
    if residual < CLEAR_SHARE * motion and mount_rad < MIN_TURNED_MOUNT_RAD:
        return ""
    judgement = judge_conventions(samples, reference)
    if judgement is None:
        return ""
    best, recorded = judgement.residuals[0], judgement.as_recorded
    if judgement.is_wrong:
        raise InputError(
            f"{best.meaning}: {best.reading}, they agree with the gyro to "
            f"{np.degrees(best.residual_rad_s):.2g} deg/s, but {AS_RECORDED} only to "
            f"{np.degrees(recorded.residual_rad_s):.3g} deg/s",
            f"{best.remedy}, and import the data again",
        )
    if judgement.is_unrelated:
        raise InputError(
            "the reference attitudes do not show the motion of the gyro: the best reading of the "
            f"quaternions leaves {np.degrees(best.residual_rad_s):.2g} deg/s of "
            f"{np.degrees(judgement.motion_rad_s):.2g} deg/s",
            "check that the attitudes are of the board, that the unit of the times is right, and "
            f"that their times and those of the gyro differ by less than {MAX_LAG_S:g} s",
        )
    if judgement.is_turned:
        return (
            f"as the quaternions are recorded, the sensor is turned by "
            f"{np.degrees(recorded.mount_rad):.0f} deg in the body frame of the reference; "
            f"{best.reading}, by {np.degrees(best.mount_rad):.0f} deg. If {best.meaning}, "
            f"{best.remedy}, and import the data again"
        )
    return ""


def mirrored_gain(samples: GyroSamples, reference: AttitudeReference) -> FloatArray | None:
    """Return the gyro's gain if its axes are a mirror image of those of the reference, (3, 3).

    The gain is that of least squares on mean rates, with an error of some percent. None: the axes
    are not mirrored, or the motion about one of them is too small to show it.
    """
    segments = match_segments(samples, reference)
    if not segments:
        return None
    rate, gyro = _mean_rates(segments)
    is_used = np.ones(len(rate), dtype=np.bool_)
    gain: FloatArray = np.eye(3)
    for _ in range(3):
        solution = np.linalg.lstsq(rate[is_used], gyro[is_used], rcond=None)[0]
        gain = np.asarray(solution.T, dtype=np.float64)
        residual = np.linalg.norm(gyro - rate @ gain.T, axis=1)
        is_used = residual <= np.quantile(residual, 1.0 - TRIMMED_SHARE)
    smallest = np.linalg.svd(rate[is_used], compute_uv=False)[-1] / np.sqrt(np.sum(is_used))
    error, motion = (float(np.sqrt(np.mean(each[is_used] ** 2))) for each in (residual, gyro))
    is_shown = smallest > MIN_MOTION_RAD_S and error < MAX_EXPLAINED_SHARE * motion
    return gain if is_shown and np.linalg.det(gain) < 0.0 else None


def _residual(segments: Sequence[AttitudeSegment]) -> tuple[float, float, float]:
    """Return the rms of the gyro's rates after the best rotation, their rms, and the angle.

    The angle is that of the rotation. A bias is removed too.
    """
    rate, gyro = _mean_rates(segments)
    is_used = np.ones(len(rate), dtype=np.bool_)
    residual, mount = np.zeros(len(rate)), np.eye(3)
    for _ in range(3):
        left, _, right = np.linalg.svd(gyro[is_used].T @ rate[is_used])
        turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
        mount = left @ turn @ right
        difference = gyro - rate @ mount.T
        difference -= difference[is_used].mean(axis=0)
        residual = np.linalg.norm(difference, axis=1)
        is_used = residual <= np.quantile(residual, 1.0 - TRIMMED_SHARE)
    motion = np.linalg.norm(gyro[is_used], axis=1)
    angle_rad = float(np.arccos(np.clip((np.trace(mount) - 1.0) / 2.0, -1.0, 1.0)))
    residual_rms = float(np.sqrt(np.mean(residual[is_used] ** 2)))
    return residual_rms, float(np.sqrt(np.mean(motion**2))), angle_rad


def _mean_rates(segments: Sequence[AttitudeSegment]) -> tuple[FloatArray, FloatArray]:
    """Return the mean rates of reference and gyro without their medians, (n, 3) each."""
    lag_s = coarse_lag_s(segments)
    rates, measured = [], []
    for segment in segments:
        group = max(1, round(MEAN_S / segment.track.step_s))
        count = segment.track.begin_s.size // group
        if count:
            rates.append(_group_means(segment.track.rate_rad_s, group, count))
            measured.append(_group_means(segment.mean_rate(lag_s)[0], group, count))
    rate, gyro = np.concatenate(rates), np.concatenate(measured)
    return rate - np.median(rate, axis=0), gyro - np.median(gyro, axis=0)


def _group_means(values: FloatArray, group: int, count: int) -> FloatArray:
    return np.asarray(values[: group * count].reshape(count, group, 3).mean(axis=1), np.float64)
