"""Gravity as a reference: rests of a hand-held board, and its accelerometer calibrated by them.

What to use when: `find_rests` for the stretches at rest of any accelerometer series;
`calibrate_accel` for what makes its readings one gravity long at every rest; with both,
the direction of gravity in the accelerometer's own frame before and after every move.

Source: Tedaldi, Pretto, Menegatti, "A robust and easy to implement method for IMU
calibration without external equipments", ICRA 2014 (imu_tk), sections III and IV.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.reference.turns import Interval

WINDOW_S = 1.0  # variance is judged over this long (imu_tk: 101 samples at 100 Hz)
SHORTEST_REST_S = 1.0
# Thresholds tried, in units of the variance at the quietest (imu_tk tries the same ten, and
# takes the one of the least residual; that may be one that tears rests apart, so here it is
# the highest that keeps gravity about as constant: a move taken for rest costs far more).
MULTIPLIERS = range(1, 11)
AS_CONSTANT = 3.0
QUIET_S = 10.0  # the quietest stretch that long stands for rest where none is marked
# Nine unknowns want more than nine poses before a residual tells anything.
FEWEST_POSES = 10
ROUNDS = 30
# A column that the poses fix worse than this, column-normalised, is not a number.
WORST_CONDITION = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class AccelCalibration:
    """specific force = U (reading - offset), U upper triangular: its frame is orthogonal."""

    matrix: FloatArray  # (3, 3), U
    offset_m_s2: FloatArray  # (3,)
    residual_m_s2: float  # standard deviation of |force| - gravity over the poses
    condition: float  # column-normalised
    poses: int

    def apply(self, reading_m_s2: FloatArray) -> FloatArray:
        """Return specific force for readings of shape (n, 3)."""
        return np.asarray((reading_m_s2 - self.offset_m_s2) @ self.matrix.T, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Every rest, the gravity it shows, and the calibration behind that."""

    rests: tuple[Interval, ...]
    first: tuple[int, ...]  # index of each rest's first sample
    last: tuple[int, ...]  # of its last sample
    direction: FloatArray  # (n, 3), unit vectors, accelerometer frame, up
    accel: AccelCalibration
    multiplier: int


def find_poses(
    time_s: FloatArray,
    accel_m_s2: FloatArray,
    gravity_m_s2: float,
    quiet: Interval | None = None,
) -> Poses:
    """Return the rests of a series and the gravity direction at each.

    Args:
        time_s: shape (n,), increasing.
        accel_m_s2: nominal scale, shape (n, 3).
        gravity_m_s2: local gravity; it sets the accelerometer's scale, not the gyro's.
        quiet: a stretch known to be at rest; None: the quietest ten seconds.

    Raises:
        InputError: too few poses, or poses too alike.
    """
    tried: list[Poses] = []
    most = 0
    variance = _variance(time_s, accel_m_s2)
    level = _quiet_level(time_s, accel_m_s2, variance, quiet)
    for multiplier in MULTIPLIERS:
        rests = _stretches(time_s, variance < multiplier * level)
        most = max(most, len(rests))
        if len(rests) >= FEWEST_POSES:
            tried.append(_poses(time_s, accel_m_s2, rests, gravity_m_s2, multiplier))
    if not tried:
        raise InputError(
            f"{most} rests are too few to calibrate an accelerometer by gravity",
            f"hold the board still in {FEWEST_POSES} and more different poses",
        )
    # A threshold so low that most rests are lost has a small residual by chance.
    usual = float(np.median([len(poses.rests) for poses in tried]))
    tried = [poses for poses in tried if len(poses.rests) >= 0.75 * usual]
    least = min(poses.accel.residual_m_s2 for poses in tried)
    best = [p for p in tried if p.accel.residual_m_s2 <= AS_CONSTANT * least][-1]
    if best.accel.condition > WORST_CONDITION:
        raise InputError(
            f"{best.accel.poses} poses are too alike to calibrate the accelerometer",
            "hold the board with every axis up and down, and tilted in between",
        )
    return best


def _poses(
    time_s: FloatArray,
    accel: FloatArray,
    rests: list[tuple[int, int]],
    gravity_m_s2: float,
    multiplier: int,
) -> Poses:
    means = np.array([accel[a : b + 1].mean(axis=0) for a, b in rests])
    found = calibrate_accel(means, gravity_m_s2)
    force = found.apply(means)
    return Poses(
        rests=tuple(Interval(float(time_s[a]), float(time_s[b])) for a, b in rests),
        first=tuple(a for a, _ in rests),
        last=tuple(b for _, b in rests),
        direction=force / np.linalg.norm(force, axis=1)[:, None],
        accel=found,
        multiplier=multiplier,
    )


def calibrate_accel(means_m_s2: FloatArray, gravity_m_s2: float) -> AccelCalibration:
    """Find U and offset so that every pose's specific force is one gravity long.

    Args:
        means_m_s2: mean reading of each pose, shape (n, 3), n at least `FEWEST_POSES`.
        gravity_m_s2: local gravity.

    Gauss-Newton with analytic derivatives, halving a step that does not help.
    """
    rows, columns = np.triu_indices(3)
    matrix, offset = np.eye(3), _sphere_centre(means_m_s2)
    matrix *= gravity_m_s2 / float(np.mean(np.linalg.norm(means_m_s2 - offset, axis=1)))
    jacobian = np.zeros((len(means_m_s2), 9))
    for _ in range(ROUNDS):
        centred = means_m_s2 - offset
        force = centred @ matrix.T
        length = np.linalg.norm(force, axis=1)
        unit = force / length[:, None]
        left = gravity_m_s2 - length
        jacobian[:, :6] = unit[:, rows] * centred[:, columns]
        jacobian[:, 6:] = -unit @ matrix
        scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
        step = np.linalg.lstsq(jacobian / scale, left, rcond=1e-9)[0] / scale
        share = 1.0
        while share > 1e-3:
            trial = matrix.copy()
            trial[rows, columns] += share * step[:6]
            moved = offset + share * step[6:]
            now = gravity_m_s2 - np.linalg.norm((means_m_s2 - moved) @ trial.T, axis=1)
            if now @ now <= left @ left:
                matrix, offset = trial, moved
                break
            share *= 0.5
        if share <= 1e-3 or float(np.max(np.abs(share * step * scale))) < 1e-12:
            break
    left = gravity_m_s2 - np.linalg.norm((means_m_s2 - offset) @ matrix.T, axis=1)
    freedom = max(1, len(means_m_s2) - 9)
    singular = np.linalg.svd(jacobian / scale, compute_uv=False)
    return AccelCalibration(
        matrix=matrix,
        offset_m_s2=offset,
        residual_m_s2=float(np.sqrt(left @ left / freedom)),
        condition=float(singular[0] / max(singular[-1], 1e-300)),
        poses=len(means_m_s2),
    )


def _sphere_centre(means: FloatArray) -> FloatArray:
    """Return the centre of the sphere through the poses, by linear least squares."""
    design = np.column_stack([2.0 * means, np.ones(len(means))])
    found = np.linalg.lstsq(design, np.sum(means**2, axis=1), rcond=1e-6)[0]
    centre = np.asarray(found[:3], dtype=np.float64)
    # Poses in one plane say nothing across it; an offset beyond the readings is no offset.
    inside = np.abs(centre) < 0.5 * np.abs(means).max()
    return np.where(inside, centre, 0.0)


def _variance(time_s: FloatArray, accel: FloatArray) -> FloatArray:
    """Return the length of the variance vector over a window centred on each sample."""
    step_s = float(np.median(np.diff(time_s)))
    half = max(2, round(0.5 * WINDOW_S / step_s))
    if len(accel) < 4 * half:
        raise InputError("the recording is too short to find rests in", "record for longer")
    centred = accel - accel.mean(axis=0)
    one = np.concatenate([np.zeros((1, 3)), np.cumsum(centred, axis=0)])
    two = np.concatenate([np.zeros((1, 3)), np.cumsum(centred**2, axis=0)])
    index = np.arange(half, len(accel) - half)
    mean = (one[index + half] - one[index - half]) / (2 * half)
    inner = np.linalg.norm((two[index + half] - two[index - half]) / (2 * half) - mean**2, axis=1)
    return np.concatenate([np.full(half, inner[0]), inner, np.full(half, inner[-1])])


def _quiet_level(
    time_s: FloatArray, accel: FloatArray, variance: FloatArray, quiet: Interval | None
) -> float:
    if quiet is not None:
        inside = (time_s >= quiet.begin_s) & (time_s <= quiet.end_s)
        if inside.sum() >= 16:
            return float(np.linalg.norm(np.var(accel[inside], axis=0)))
    blocks = np.array_split(variance, max(1, int((time_s[-1] - time_s[0]) / QUIET_S)))
    return max(min(float(np.median(block)) for block in blocks), 1e-12)


def _stretches(time_s: FloatArray, still: BoolArray) -> list[tuple[int, int]]:
    """Return first and last index of every stretch that lasts."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    pairs = zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True)
    return [(a, b) for a, b in pairs if time_s[b] - time_s[a] >= SHORTEST_REST_S]
