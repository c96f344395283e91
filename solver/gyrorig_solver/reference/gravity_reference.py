"""Gravity as a reference: rests of a hand-held board, which calibrate its accelerometer.

What to use when: `find_poses` for the rests of an accelerometer series and the direction of
gravity in each; `calibrate_accelerometer` for a calibration in which the specific force of every
pose has the length g.

Source: Tedaldi, Pretto, Menegatti, "A robust and easy to implement method for IMU
calibration without external equipments", ICRA 2014 (imu_tk), sections III and IV.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.reference.known_turns import TimeInterval

VARIANCE_WINDOW_S = 1.0  # window of the variance (imu_tk: 101 samples at 100 Hz)
MIN_REST_S = 1.0
# Candidate thresholds, in units of the smallest variance. imu_tk tries the same ten and uses the
# one with the smallest residual, which can split rests. This module uses the highest threshold with
# a similar residual, because a move that counts as a rest causes a much larger error.
THRESHOLD_MULTIPLIERS = range(1, 11)
MAX_RESIDUAL_RATIO = 3.0
NOISE_WINDOW_S = 10.0  # the window of smallest variance is the rest, if none is marked
# Nine unknowns need more than nine poses for a residual.
MIN_POSES = 10
MAX_ITERATIONS = 30
# Largest condition number of the column-normalised Jacobian.
MAX_CONDITION = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerCalibration:
    """Accelerometer model: specific force = U (reading - offset), U upper triangular."""

    matrix: FloatArray  # (3, 3), U
    offset_m_s2: FloatArray  # (3,)
    residual_m_s2: float  # standard deviation of |force| - gravity over the poses
    condition: float  # column-normalised
    pose_count: int

    def apply(self, reading_m_s2: FloatArray) -> FloatArray:
        """Return specific force for readings of shape (n, 3)."""
        return np.asarray((reading_m_s2 - self.offset_m_s2) @ self.matrix.T, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class StaticPoses:
    """All rests, the direction of gravity in each, and the accelerometer calibration."""

    rests: tuple[TimeInterval, ...]
    first_sample: tuple[int, ...]  # index of the first sample of each rest
    last_sample: tuple[int, ...]  # of its last sample
    direction: FloatArray  # (n, 3), unit vectors, accelerometer frame, up
    accel: AccelerometerCalibration
    gravity_m_s2: float


def find_poses(
    time_s: FloatArray,
    accel_m_s2: FloatArray,
    gravity_m_s2: float,
    known_rest: TimeInterval | None = None,
) -> StaticPoses:
    """Return the rests of a series and the gravity direction at each.

    Args:
        time_s: shape (n,), increasing.
        accel_m_s2: nominal scale, shape (n, 3); rows that are not finite are ignored.
        gravity_m_s2: local gravity; it determines the scale of the accelerometer only.
        known_rest: an interval known to be at rest; None: the ten seconds of smallest variance.

    Raises:
        InputError: there are too few poses, or the poses are too similar.
    """
    row = np.flatnonzero(np.isfinite(accel_m_s2).all(axis=1))
    if row.size < len(accel_m_s2):
        poses = find_poses(time_s[row], accel_m_s2[row], gravity_m_s2, known_rest)
        first, last = row[list(poses.first_sample)], row[list(poses.last_sample)]
        return replace(poses, first_sample=tuple(first.tolist()), last_sample=tuple(last.tolist()))
    candidates: list[StaticPoses] = []
    max_rests = 0
    variance = _moving_variance(time_s, accel_m_s2)
    rest_variance = _rest_variance(time_s, accel_m_s2, variance, known_rest)
    for multiplier in THRESHOLD_MULTIPLIERS:
        rests = _find_rests(time_s, variance < multiplier * rest_variance)
        max_rests = max(max_rests, len(rests))
        if len(rests) >= MIN_POSES:
            candidates.append(_calibrate_poses(time_s, accel_m_s2, rests, gravity_m_s2))
    if not candidates:
        raise InputError(
            "the recording has too few rests to calibrate the accelerometer by gravity "
            f"({max_rests} rests)",
            f"hold the board still in at least {MIN_POSES} different poses",
        )
    # With a low threshold most rests are lost, and the residual is small by chance.
    usual_count = float(np.median([len(poses.rests) for poses in candidates]))
    candidates = [poses for poses in candidates if len(poses.rests) >= 0.75 * usual_count]
    min_residual = min(poses.accel.residual_m_s2 for poses in candidates)
    chosen = [p for p in candidates if p.accel.residual_m_s2 <= MAX_RESIDUAL_RATIO * min_residual][
        -1
    ]
    if chosen.accel.condition > MAX_CONDITION:
        raise InputError(
            f"the {chosen.accel.pose_count} poses in the recording are too similar to calibrate "
            "the accelerometer",
            "hold the board with each axis up and down, and also in tilted poses",
        )
    return chosen


def _calibrate_poses(
    time_s: FloatArray,
    accel: FloatArray,
    rests: list[tuple[int, int]],
    gravity_m_s2: float,
) -> StaticPoses:
    means = np.array([accel[a : b + 1].mean(axis=0) for a, b in rests])
    calibration = calibrate_accelerometer(means, gravity_m_s2)
    force = calibration.apply(means)
    return StaticPoses(
        rests=tuple(TimeInterval(float(time_s[a]), float(time_s[b])) for a, b in rests),
        first_sample=tuple(a for a, _ in rests),
        last_sample=tuple(b for _, b in rests),
        direction=force / np.linalg.norm(force, axis=1)[:, None],
        accel=calibration,
        gravity_m_s2=gravity_m_s2,
    )


def calibrate_accelerometer(
    means_m_s2: FloatArray, gravity_m_s2: float
) -> AccelerometerCalibration:
    """Estimate U and offset, so that the specific force of every pose has the length g.

    Args:
        means_m_s2: mean reading of each pose, shape (n, 3), n at least `MIN_POSES`.
        gravity_m_s2: local gravity.

    Gauss-Newton with analytic derivatives; a step that does not help is halved.
    """
    rows, columns = np.triu_indices(3)
    matrix, offset = np.eye(3), _sphere_centre(means_m_s2)
    matrix *= gravity_m_s2 / float(np.mean(np.linalg.norm(means_m_s2 - offset, axis=1)))
    jacobian = np.zeros((len(means_m_s2), 9))
    for _ in range(MAX_ITERATIONS):
        centred = means_m_s2 - offset
        force = centred @ matrix.T
        length = np.linalg.norm(force, axis=1)
        unit = force / length[:, None]
        residual = gravity_m_s2 - length
        jacobian[:, :6] = unit[:, rows] * centred[:, columns]
        jacobian[:, 6:] = -unit @ matrix
        scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
        step = np.linalg.lstsq(jacobian / scale, residual, rcond=1e-9)[0] / scale
        share = 1.0
        while share > 1e-3:
            trial = matrix.copy()
            trial[rows, columns] += share * step[:6]
            trial_offset = offset + share * step[6:]
            trial_residual = gravity_m_s2 - np.linalg.norm(
                (means_m_s2 - trial_offset) @ trial.T, axis=1
            )
            if trial_residual @ trial_residual <= residual @ residual:
                matrix, offset = trial, trial_offset
                break
            share *= 0.5
        if share <= 1e-3 or float(np.max(np.abs(share * step * scale))) < 1e-12:
            break
    residual = gravity_m_s2 - np.linalg.norm((means_m_s2 - offset) @ matrix.T, axis=1)
    freedom = max(1, len(means_m_s2) - 9)
    singular = np.linalg.svd(jacobian / scale, compute_uv=False)
    return AccelerometerCalibration(
        matrix=matrix,
        offset_m_s2=offset,
        residual_m_s2=float(np.sqrt(residual @ residual / freedom)),
        condition=float(singular[0] / max(singular[-1], 1e-300)),
        pose_count=len(means_m_s2),
    )


def _sphere_centre(means: FloatArray) -> FloatArray:
    """Return the centre of the sphere through the poses, by linear least squares."""
    design = np.column_stack([2.0 * means, np.ones(len(means))])
    solution = np.linalg.lstsq(design, np.sum(means**2, axis=1), rcond=1e-6)[0]
    centre = np.asarray(solution[:3], dtype=np.float64)
    # Poses in one plane do not determine the offset normal to it; limit it to the readings.
    inside = np.abs(centre) < 0.5 * np.abs(means).max()
    return np.where(inside, centre, 0.0)


def _moving_variance(time_s: FloatArray, accel: FloatArray) -> FloatArray:
    """Return the length of the variance vector over a window centred on each sample."""
    step_s = float(np.median(np.diff(time_s)))
    half = max(2, round(0.5 * VARIANCE_WINDOW_S / step_s))
    if len(accel) < 4 * half:
        raise InputError(
            f"the recording has only {len(accel)} samples of the accelerometer, but at least "
            f"{4 * half} are needed to detect rests",
            "record for longer",
        )
    centred = accel - accel.mean(axis=0)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(centred, axis=0)])
    square_sums = np.concatenate([np.zeros((1, 3)), np.cumsum(centred**2, axis=0)])
    index = np.arange(half, len(accel) - half)
    mean = (sums[index + half] - sums[index - half]) / (2 * half)
    inner_variance = np.linalg.norm(
        (square_sums[index + half] - square_sums[index - half]) / (2 * half) - mean**2, axis=1
    )
    return np.concatenate(
        [np.full(half, inner_variance[0]), inner_variance, np.full(half, inner_variance[-1])]
    )


def _rest_variance(
    time_s: FloatArray, accel: FloatArray, variance: FloatArray, known_rest: TimeInterval | None
) -> float:
    if known_rest is not None:
        inside = (time_s >= known_rest.begin_s) & (time_s <= known_rest.end_s)
        if inside.sum() >= 16:
            return float(np.linalg.norm(np.var(accel[inside], axis=0)))
    blocks = np.array_split(variance, max(1, int((time_s[-1] - time_s[0]) / NOISE_WINDOW_S)))
    return max(min(float(np.median(block)) for block in blocks), 1e-12)


def _find_rests(time_s: FloatArray, still: BoolArray) -> list[tuple[int, int]]:
    """Return first and last index of every rest of sufficient length."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    pairs = zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True)
    return [(a, b) for a, b in pairs if time_s[b] - time_s[a] >= MIN_REST_S]
