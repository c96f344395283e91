"""Tests whether the size of a jitter depends on a covariate, which true jitter does not.

Jitter makes samples early or late with any moving axis, at any speed and time. An axis that sticks
at starts and stops adds variance at the same places, but only on that axis and at low speed.
Therefore the variance of the jitter is modulated by the accelerating axis, the speed and the time,
and a score test of each modulation is made with the size of the jitter free.

The test uses m independent values with the variance v = 1 + s^2 a. The derivative by a modulation g
of the size is D = a g / v. The score is D e / 2 with e = value^2 / v - 1, and its information is
D D' / 2.

What to use when: `BlockMotion` for the modulations, `find_modulation` for the most significant.

Source: score test, Rao, Linear Statistical Inference, 6e.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.checks.variance_trend import MIN_RELATIVE_STRENGTH
from gyrorig_solver.model import SignalState
from gyrorig_solver.numerics import chi2_upper_tail, score_statistic

MODULATION_WAVES = 3  # half waves of the speed and of the time
DESCRIPTIONS = {
    "pan_transient": "on which axis starts and stops (the scatter changes)",
    "speed": "on the speed (the scatter changes)",
    "time": "on the time (the scatter changes)",
}


@dataclass(frozen=True, slots=True, eq=False)
class BlockMotion:
    """The motion in blocks of samples: axis, speed and time; (b,) each."""

    axis_balance: FloatArray  # 1: only pan accelerates; -1: only tilt accelerates
    speed: FloatArray
    time_s: FloatArray

    @classmethod
    def of(cls, scene: SignalState, speed: FloatArray, length: int, used: BoolArray) -> Self:
        """Return the averages over the used blocks.

        Args:
            scene: a part of a series.
            speed: of the stage, (n,).
            length: number of values of a block.
            used: whether each of the n // length blocks is used, (blocks,).
        """
        jolt = np.zeros((scene.interval_count, 3))
        if scene.has_angles:
            rate = np.diff(scene.angle_rad, axis=1)
            jolt[:, :2] = np.abs(np.diff(rate, axis=1, append=rate[:, -1:])).T
        time = np.repeat(scene.time_s[:, None], 3, axis=1)
        inside = slice(0, used.size * length)

        def mean(values: FloatArray) -> FloatArray:
            means = np.mean(values[inside].reshape(used.size, length, -1), axis=1)
            return np.asarray(means[used], dtype=np.float64)

        moved, when = (mean(output) for output in scene.sample_output(np.stack([jolt, time])))
        both = moved[:, 0] + moved[:, 1]
        return cls(
            np.divide(moved[:, 0] - moved[:, 1], both, out=np.zeros_like(both), where=both > 0.0),
            mean(speed)[:, 0],
            when[:, 0],
        )

    @classmethod
    def concatenate(cls, parts: list["BlockMotion"]) -> Self:
        """Concatenate the blocks of several parts."""
        return cls(
            np.concatenate([part.axis_balance for part in parts]),
            np.concatenate([part.speed for part in parts]),
            np.concatenate([part.time_s for part in parts]),
        )

    @property
    def modulations(self) -> dict[str, FloatArray]:
        """The modulations that jitter must not have, (k, b), by covariate."""
        return {
            "pan_transient": self.axis_balance[None],
            "speed": _cosine_basis(self.speed),
            "time": _cosine_basis(self.time_s),
        }


def find_modulation(
    value: FloatArray, shape: FloatArray, size: float, motion: BlockMotion
) -> DependenceTest | None:
    """Return the most significant modulation of the jitter's variance; None if none is testable.

    Args:
        value: squares of independent coefficients, (b, m).
        shape: variance that a unit of the jitter adds to each, (b, m).
        size: the maximum-likelihood size of the jitter.
        motion: of the blocks.
    """
    variance = 1.0 + size * shape
    relative_shape, excess = shape / variance, (value / variance - 1.0).ravel()
    modulations = motion.modulations
    worst: DependenceTest | None = None
    for covariate, waves in modulations.items():
        directions = np.concatenate(
            [relative_shape[None], relative_shape * waves[:, :, None]]
        ).reshape(len(waves) + 1, -1)
        statistic, degrees = _score_statistic(directions, excess)
        if degrees > 0:
            p_value = min(1.0, len(modulations) * chi2_upper_tail(statistic, degrees))
            if worst is None or p_value < worst.p_value:
                worst = DependenceTest(
                    covariate, DESCRIPTIONS[covariate], statistic, degrees, p_value
                )
    return worst


def _score_statistic(directions: FloatArray, excess: FloatArray) -> tuple[float, int]:
    """Return the score statistic of all directions except the first, which is at its optimum."""
    energy = np.sum(directions**2, axis=1)
    is_strong = energy > 0.0
    scale = np.sqrt(2.0 * energy[is_strong])
    correlation = 2.0 * (directions[is_strong] @ directions[is_strong].T) / np.outer(scale, scale)
    score = directions[is_strong] @ excess / scale
    statistic, degrees = score_statistic(correlation, score, MIN_RELATIVE_STRENGTH)
    return statistic, degrees - 1


def _cosine_basis(x: FloatArray) -> FloatArray:
    span = float(np.ptp(x))
    share = (x - x.min()) / span if span > 0.0 else np.zeros_like(x)
    return np.asarray(
        np.cos(np.pi * np.arange(1, MODULATION_WAVES + 1)[:, None] * share), np.float64
    )
