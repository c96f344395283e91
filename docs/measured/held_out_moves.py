"""`imu_tk_xsens`: the gain of half of the moves, judged by gravity over the other half.

What to use when: `held_out` for the table. Every move is judged once, by the fit of the
moves that alternate with it. imu_tk's own parameters are those of all moves, the judged ones
too; so its method is run here on the other half as well: eq. 16 of its paper, plain least
squares of the carried directions with the bias of the first rest, by scipy.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from docs.markdown import number, table
from docs.measured.printed import IMU_TK
from docs.measured.sessions import MeasuredSets
from scipy.optimize import least_squares
from tests.support.rotation_error import total_rotation

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import fit_gravity
from gyrorig_solver.estimate.gravity_fit import MIN_TURN_RAD
from gyrorig_solver.reference import TimeInterval, find_poses, turn_vectors
from gyrorig_solver.reference.gravity_reference import StaticPoses

GRAVITY_M_S2 = 9.81744  # of imu_tk's example; only the accelerometer's scale rests on it
OFFSET_COUNTS = 32768  # of the Xsens' offset binary, as config/imports/imu-tk-xsens.yaml has it
BOOTSTRAPS = 2000
PERCENT = (2.5, 97.5)
SEED = 20260131  # so that the same errors give the same interval

Use = Callable[["Move"], tuple[FloatArray, FloatArray]]
"""The bias and the gain that a move is tested with."""


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """One move between two rests."""

    part: slice  # of the samples
    half: int  # 0 or 1, alternating
    rest_bias_rad_s: FloatArray  # (3,), mean of the rest before and the one after
    before: FloatArray  # (3,), unit vector up in the accelerometer's frame
    after: FloatArray

    def error_rad(self, samples: GyroSamples, bias_rad_s: FloatArray, gain: FloatArray) -> float:
        """Angle between gravity as seen after the move and as the gyro carried it there."""
        rate = (samples.rate_rad_s[self.part] - bias_rad_s) @ np.linalg.inv(gain).T
        vectors = turn_vectors(rate, np.diff(samples.time_s[self.part]))
        carried = total_rotation(vectors[None])[0].inv().apply(self.before)
        sine = float(np.linalg.norm(np.cross(carried, self.after)))
        return float(np.arctan2(sine, carried @ self.after))


def held_out(measured: MeasuredSets) -> str:
    """Angle errors of the moves, per set of parameters."""
    loaded = measured.load("xsens")
    samples, quiet = loaded.samples, loaded.rests[0]
    moves, poses = find_moves(samples, quiet)
    errors = {
        words: np.array([move.error_rad(samples, *use(move)) for move in moves])
        for words, use in _ways(samples, quiet, moves, poses)
    }
    ours = errors["gyrorig, fitted to the other half"]
    rows = []
    for words, error in errors.items():
        low, high = _interval(error)
        ratio = float(np.sqrt(np.mean(error**2) / np.mean(ours**2)))
        ratio_low, ratio_high = _interval(error, ours)
        rows.append(
            [
                words,
                f"{number(np.degrees(_rms(error)), 3)}"
                f" ({number(np.degrees(low), 3)} to {number(np.degrees(high), 3)})",
                number(float(np.degrees(np.median(error))), 3),
                ""
                if error is ours
                else f"{number(ratio, 2)} ({number(ratio_low, 2)} to {number(ratio_high, 2)})",
                str(error.size),
            ]
        )
    head = [
        "gain and bias",
        "rms, °",
        "median, °",
        "rms / rms of gyrorig fitted to the other half",
        "moves",
    ]
    return table(head, rows)


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _interval(error: FloatArray, other_error: FloatArray | None = None) -> tuple[float, float]:
    """95 % interval of an rms, or of its ratio to another's over the same moves."""
    drawn = np.random.default_rng(SEED).integers(0, error.size, (BOOTSTRAPS, error.size))
    squares = np.mean(error[drawn] ** 2, axis=1)
    if other_error is not None:
        squares = squares / np.mean(other_error[drawn] ** 2, axis=1)
    low, high = np.percentile(np.sqrt(squares), PERCENT)
    return float(low), float(high)


def _ways(
    samples: GyroSamples, quiet: TimeInterval, moves: list[Move], poses: StaticPoses
) -> Iterator[tuple[str, Use]]:
    halves = [_fit(samples, quiet, poses, moves, half) for half in (0, 1)]
    every = _fit(samples, quiet, poses, moves, None)
    theirs = IMU_TK.gain(samples.quantum_rad_s)
    first = (IMU_TK.b_counts - OFFSET_COUNTS) * samples.quantum_rad_s
    mean_scale = [float(np.mean(np.linalg.norm(gain, axis=1))) * np.eye(3) for gain in halves]
    plain = [
        gain_as_imu_tk(samples, [m for m in moves if m.half == half], first, mean_scale[half])
        for half in (0, 1)
    ]
    yield (
        "nominal scale factor (a guess), bias of the neighbouring rests",
        lambda m: (m.rest_bias_rad_s, np.eye(3)),
    )
    yield (
        "one scale factor for all axes from the other half, bias of the neighbouring rests",
        lambda m: (m.rest_bias_rad_s, mean_scale[1 - m.half]),
    )
    yield "gain of imu_tk from all moves, its bias from the first rest", lambda _: (first, theirs)
    yield (
        "gain of imu_tk from all moves, bias of the neighbouring rests",
        lambda m: (m.rest_bias_rad_s, theirs),
    )
    yield "method of imu_tk, fitted to the other half", lambda m: (first, plain[1 - m.half])
    yield "gyrorig, fitted to the other half", lambda m: (m.rest_bias_rad_s, halves[1 - m.half])
    yield "(gyrorig, fitted to all moves)", lambda m: (m.rest_bias_rad_s, every)


def _fit(
    samples: GyroSamples,
    quiet: TimeInterval,
    poses: StaticPoses,
    moves: list[Move],
    half: int | None,
) -> FloatArray:
    """Return the gain of one half of the moves, of all with None.

    A move is left out by one bad sample in its middle, as a saturated one would leave it out.
    """
    good = samples.usable.copy()
    for move in moves:
        if half is not None and move.half != half:
            good[(move.part.start + move.part.stop) // 2] = False
    fit = fit_gravity(replace(samples, usable=good), GRAVITY_M_S2, quiet)
    wanted = sum(half is None or move.half == half for move in moves)
    used = fit.gravity_moves
    if used is None or used.moves != wanted or used.poses != len(poses.rests):
        raise ValueError(f"the fit did not use {wanted} moves between {len(poses.rests)} rests")
    return fit.gain


def gain_as_imu_tk(
    samples: GyroSamples, moves: list[Move], bias_rad_s: FloatArray, start: FloatArray
) -> FloatArray:
    """Return the gain that carries the gravity of these moves best, by imu_tk's cost.

    Args:
        samples: of the session.
        moves: those to fit.
        bias_rad_s: held, shape (3,).
        start: a gain near enough, shape (3, 3).

    Source: Tedaldi et al., ICRA 2014, eq. 16.
    """
    steps = max(move.part.stop - move.part.start for move in moves) - 1
    before, after = (np.array([getattr(m, name) for m in moves]) for name in ("before", "after"))

    def missing(entries: FloatArray) -> FloatArray:
        back = np.linalg.inv(entries.reshape(3, 3)).T
        vectors = np.zeros((len(moves), steps, 3))  # the shorter moves end in steps of no turn
        for k, move in enumerate(moves):
            rate = (samples.rate_rad_s[move.part] - bias_rad_s) @ back
            turned = turn_vectors(rate, np.diff(samples.time_s[move.part]))
            vectors[k, : len(turned)] = turned
        return np.asarray((total_rotation(vectors).inv().apply(before) - after).ravel())

    return np.asarray(least_squares(missing, start.ravel()).x.reshape(3, 3), np.float64)


def find_moves(samples: GyroSamples, quiet: TimeInterval) -> tuple[list[Move], StaticPoses]:
    """Return the moves that turn, and the rests between them."""
    if samples.accel_m_s2 is None:
        raise ValueError("the set has an accelerometer")
    poses = find_poses(samples.time_s, samples.accel_m_s2, GRAVITY_M_S2, quiet)
    bias = np.array(
        [
            samples.rate_rad_s[first : last + 1].mean(axis=0)
            for first, last in zip(poses.first_sample, poses.last_sample, strict=True)
        ]
    )
    moves: list[Move] = []
    for k in range(len(poses.rests) - 1):
        part = slice(poses.last_sample[k], poses.first_sample[k + 1] + 1)
        between = 0.5 * (bias[k] + bias[k + 1])
        rate = samples.rate_rad_s[part] - between
        step_s = np.diff(samples.time_s[part])
        if float(np.sum(np.linalg.norm(rate[1:], axis=1) * step_s)) < MIN_TURN_RAD:
            continue
        half = len(moves) % 2
        moves.append(Move(part, half, between, poses.direction[k], poses.direction[k + 1]))
    return moves, poses
