"""Does a scatter that passes for jitter hang on what jitter must not hang on?

Samples are early or late whichever axis moves, however fast, whenever. An axis that sticks
and jumps while it starts and stops scatters where jitter does, but on that axis alone and at
low speed. So the jitter's variance is made to grow and shrink with the axis that accelerates,
with the speed and with the time; a score test beside the jitter's own size, which is free.

With m independent values of variance v = 1 + s^2 a, the derivative by a modulation g of the
size is D = a g / v, the score D e / 2 with e = value^2 / v - 1, its information D D' / 2.

What to use when: `Where` for the blocks' modulations, `against` for what speaks against jitter.

Source: score test, Rao, Linear Statistical Inference, 6e.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.model.terms.scene import Scene

WAVES = 3  # half waves of the speed and of the time
ALIKE = 1e-7  # of the strongest: modulations that are sums of others say nothing more
WORDS = {
    "pan_transient": "on which axis starts and stops, in its scatter",
    "speed": "on the speed, in its scatter",
    "time": "on the time, in its scatter",
}


@dataclass(frozen=True, slots=True)
class Swell:
    """What speaks most against a scatter being jitter."""

    covariate: str
    words: str
    statistic: float
    degrees_of_freedom: int
    p_value: float  # the choice among them counted


@dataclass(frozen=True, slots=True, eq=False)
class Where:
    """Of blocks of samples: what moved in them, how fast, and when; (b,) each."""

    axis: FloatArray  # 1: all acceleration is pan's; -1: tilt's
    speed: FloatArray
    time_s: FloatArray

    @classmethod
    def of(cls, scene: Scene, speed: FloatArray, length: int, used: BoolArray) -> Self:
        """Average over blocks of so many means, those used.

        Args:
            scene: a part of a series.
            speed: of the stage, (n,).
            length: of a block.
            used: (blocks,), n // length of them.
        """
        jolt = np.zeros((scene.n, 3))
        if scene.has_angles:
            rate = np.diff(scene.angle_rad, axis=1)
            jolt[:, :2] = np.abs(np.diff(rate, axis=1, append=rate[:, -1:])).T
        time = np.repeat(scene.time_s[:, None], 3, axis=1)
        inside = slice(0, used.size * length)

        def mean(values: FloatArray) -> FloatArray:
            means = np.mean(values[inside].reshape(used.size, length, -1), axis=1)
            return np.asarray(means[used], dtype=np.float64)

        moved, when = (mean(one) for one in scene.read(np.stack([jolt, time])))
        both = moved[:, 0] + moved[:, 1]
        return cls(
            np.divide(moved[:, 0] - moved[:, 1], both, out=np.zeros_like(both), where=both > 0.0),
            mean(speed)[:, 0],
            when[:, 0],
        )

    @classmethod
    def joined(cls, some: list["Where"]) -> Self:
        """Put parts one after the other."""
        return cls(
            np.concatenate([one.axis for one in some]),
            np.concatenate([one.speed for one in some]),
            np.concatenate([one.time_s for one in some]),
        )

    @property
    def modulations(self) -> dict[str, FloatArray]:
        """What the size must not grow and shrink with, (k, b), by covariate."""
        return {
            "pan_transient": self.axis[None],
            "speed": _waves(self.speed),
            "time": _waves(self.time_s),
        }


def against(value: FloatArray, shape: FloatArray, size: float, where: Where) -> Swell | None:
    """Return what speaks most against a scatter being jitter, None where nothing can.

    Args:
        value: squares of independent coefficients, (b, m).
        shape: what a unit of the jitter adds to their variance, (b, m).
        size: the likeliest.
        where: of the blocks.
    """
    variance = 1.0 + size * shape
    own, excess = shape / variance, (value / variance - 1.0).ravel()
    every = where.modulations
    worst: Swell | None = None
    for covariate, waves in every.items():
        along = np.concatenate([own[None], own * waves[:, :, None]]).reshape(len(waves) + 1, -1)
        statistic, degrees = _judged(along, excess)
        if degrees > 0:
            p_value = min(1.0, len(every) * chi2_tail(statistic, degrees))
            if worst is None or p_value < worst.p_value:
                worst = Swell(covariate, WORDS[covariate], statistic, degrees, p_value)
    return worst


def _judged(along: FloatArray, excess: FloatArray) -> tuple[float, int]:
    """Return what all directions but the first say, at whose best the excess is."""
    energy = np.sum(along**2, axis=1)
    some = energy > 0.0
    scale = np.sqrt(2.0 * energy[some])
    alike = 2.0 * (along[some] @ along[some].T) / np.outer(scale, scale)
    strength, ways = np.linalg.eigh(alike)
    keep = strength > ALIKE * strength[-1]
    score = ways[:, keep].T @ (along[some] @ excess / scale)
    return float(np.sum(score**2 / strength[keep])), int(keep.sum()) - 1


def _waves(x: FloatArray) -> FloatArray:
    span = float(np.ptp(x))
    share = (x - x.min()) / span if span > 0.0 else np.zeros_like(x)
    return np.asarray(np.cos(np.pi * np.arange(1, WAVES + 1)[:, None] * share), np.float64)
