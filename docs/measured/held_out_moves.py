"""Test of gains from half of the moves of `imu_tk_xsens` on the gravity of the other half.

What to use when: `move_errors` for the table. The moves alternate between two halves. A fit of one
half is tested on every move of the other half. The published parameters of imu_tk are from all
moves. Therefore this module also runs the method of imu_tk on one half: eq. 16 of its paper. It is
a least-squares fit of the predicted directions, with the bias of the first rest, by scipy.
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
from gyrorig_solver.estimate.gravity_solver import MIN_TURN_RAD
from gyrorig_solver.reference import TimeInterval, find_poses, turn_vectors
from gyrorig_solver.reference.gravity_reference import StaticPoses

GRAVITY_M_S2 = 9.81744  # from the example of imu_tk; it sets only the accelerometer's scale
OFFSET_COUNTS = 32768  # of the Xsens' offset binary, see config/imports/imu-tk-xsens.yaml
BOOTSTRAPS = 2000
PERCENT = (2.5, 97.5)
SEED = 20260131  # the same errors then give the same interval

ParameterChoice = Callable[["Move"], tuple[FloatArray, FloatArray]]
"""Function that returns the bias and the gain for the test of a move."""


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """One move between two rests."""

    part: slice  # of the samples
    half: int  # 0 or 1, alternating
    rest_bias_rad_s: FloatArray  # (3,), mean of the rests before and after
    before: FloatArray  # (3,), unit vector up in the accelerometer's frame
    after: FloatArray

    def error_rad(self, samples: GyroSamples, bias_rad_s: FloatArray, gain: FloatArray) -> float:
        """Return the angle between measured gravity after the move and its gyro prediction."""
        rate = (samples.rate_rad_s[self.part] - bias_rad_s) @ np.linalg.inv(gain).T
        vectors = turn_vectors(rate, np.diff(samples.time_s[self.part]))
        carried = total_rotation(vectors[None])[0].inv().apply(self.before)
        sine = float(np.linalg.norm(np.cross(carried, self.after)))
        return float(np.arctan2(sine, carried @ self.after))


def move_errors(measured: MeasuredSets) -> str:
    """Return the angle errors of the moves, per set of parameters."""
    loaded = measured.load_recording("xsens")
    samples, quiet = loaded.samples, loaded.rests[0]
    moves, poses = find_moves(samples, quiet)
    errors = {
        words: np.array([move.error_rad(samples, *choose(move)) for move in moves])
        for words, choose in _make_parameter_choices(samples, quiet, moves, poses)
    }
    ours = errors["gyrorig, fitted to the other half"]
    rows = []
    for words, error in errors.items():
        low, high = _compute_interval(error)
        ratio = float(np.sqrt(np.mean(error**2) / np.mean(ours**2)))
        ratio_low, ratio_high = _compute_interval(error, ours)
        rows.append(
            [
                words,
                f"{number(np.degrees(_compute_rms(error)), 3)}"
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


def _compute_rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _compute_interval(
    error: FloatArray, other_error: FloatArray | None = None
) -> tuple[float, float]:
    """Return the 95 % interval of an rms, or of the ratio of two rms over the same moves."""
    indices = np.random.default_rng(SEED).integers(0, error.size, (BOOTSTRAPS, error.size))
    squares = np.mean(error[indices] ** 2, axis=1)
    if other_error is not None:
        squares = squares / np.mean(other_error[indices] ** 2, axis=1)
    low, high = np.percentile(np.sqrt(squares), PERCENT)
    return float(low), float(high)


def _make_parameter_choices(
    samples: GyroSamples, quiet: TimeInterval, moves: list[Move], poses: StaticPoses
) -> Iterator[tuple[str, ParameterChoice]]:
    halves = [_fit_half(samples, quiet, poses, moves, half) for half in (0, 1)]
    full_fit = _fit_half(samples, quiet, poses, moves, None)
    their_gain = IMU_TK.compute_gain(samples.quantum_rad_s)
    first_rest_bias = (IMU_TK.b_counts - OFFSET_COUNTS) * samples.quantum_rad_s
    mean_scale = [float(np.mean(np.linalg.norm(gain, axis=1))) * np.eye(3) for gain in halves]
    their_method = [
        fit_gain_as_imu_tk(
            samples, [m for m in moves if m.half == half], first_rest_bias, mean_scale[half]
        )
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
    yield (
        "gain of imu_tk from all moves, its bias from the first rest",
        lambda _: (first_rest_bias, their_gain),
    )
    yield (
        "gain of imu_tk from all moves, bias of the neighbouring rests",
        lambda m: (m.rest_bias_rad_s, their_gain),
    )
    yield (
        "method of imu_tk, fitted to the other half",
        lambda m: (first_rest_bias, their_method[1 - m.half]),
    )
    yield "gyrorig, fitted to the other half", lambda m: (m.rest_bias_rad_s, halves[1 - m.half])
    yield "(gyrorig, fitted to all moves)", lambda m: (m.rest_bias_rad_s, full_fit)


def _fit_half(
    samples: GyroSamples,
    quiet: TimeInterval,
    poses: StaticPoses,
    moves: list[Move],
    half: int | None,
) -> FloatArray:
    """Return the gain from one half of the moves, or from all moves if `half` is None.

    One unusable sample in its middle excludes a move from the fit, as a saturated sample does.
    """
    good = samples.usable.copy()
    for move in moves:
        if half is not None and move.half != half:
            good[(move.part.start + move.part.stop) // 2] = False
    fit = fit_gravity(replace(samples, usable=good), GRAVITY_M_S2, quiet)
    move_count = sum(half is None or move.half == half for move in moves)
    result = fit.gravity_moves
    if result is None or result.moves != move_count or result.poses != len(poses.rests):
        raise ValueError(f"the fit did not use {move_count} moves between {len(poses.rests)} rests")
    return fit.gain


def fit_gain_as_imu_tk(
    samples: GyroSamples, moves: list[Move], bias_rad_s: FloatArray, start: FloatArray
) -> FloatArray:
    """Return the gain with the best predicted gravity of these moves, with the cost of imu_tk.

    Args:
        samples: of the session.
        moves: the moves to fit.
        bias_rad_s: constant in the fit, shape (3,).
        start: start value of the gain, shape (3, 3).

    Source: Tedaldi et al., ICRA 2014, eq. 16.
    """
    steps = max(move.part.stop - move.part.start for move in moves) - 1
    before, after = (np.array([getattr(m, name) for m in moves]) for name in ("before", "after"))

    def compute_residual(entries: FloatArray) -> FloatArray:
        inverse_gain = np.linalg.inv(entries.reshape(3, 3)).T
        vectors = np.zeros((len(moves), steps, 3))  # zero turns fill up the shorter moves
        for k, move in enumerate(moves):
            rate = (samples.rate_rad_s[move.part] - bias_rad_s) @ inverse_gain
            turns_rad = turn_vectors(rate, np.diff(samples.time_s[move.part]))
            vectors[k, : len(turns_rad)] = turns_rad
        return np.asarray((total_rotation(vectors).inv().apply(before) - after).ravel())

    return np.asarray(least_squares(compute_residual, start.ravel()).x.reshape(3, 3), np.float64)


def find_moves(samples: GyroSamples, quiet: TimeInterval) -> tuple[list[Move], StaticPoses]:
    """Return the moves with a turn, and the rests between them."""
    if samples.accel_m_s2 is None:
        raise ValueError("the set has an accelerometer")
    poses = find_poses(samples.time_s, samples.accel_m_s2, GRAVITY_M_S2, quiet)
    rest_bias_rad_s = np.array(
        [
            samples.rate_rad_s[first : last + 1].mean(axis=0)
            for first, last in zip(poses.first_sample, poses.last_sample, strict=True)
        ]
    )
    moves: list[Move] = []
    for k in range(len(poses.rests) - 1):
        part = slice(poses.last_sample[k], poses.first_sample[k + 1] + 1)
        bias_rad_s = 0.5 * (rest_bias_rad_s[k] + rest_bias_rad_s[k + 1])
        rate = samples.rate_rad_s[part] - bias_rad_s
        step_s = np.diff(samples.time_s[part])
        if float(np.sum(np.linalg.norm(rate[1:], axis=1) * step_s)) < MIN_TURN_RAD:
            continue
        half = len(moves) % 2
        moves.append(Move(part, half, bias_rad_s, poses.direction[k], poses.direction[k + 1]))
    return moves, poses
