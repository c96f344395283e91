"""The sensor's low-pass: a second-order Butterworth filter, solved exactly in blocks.

The input is constant over each substep; under that the discrete state space is exact. A
block of substeps becomes a few small matrix products, the same for real time and for fast
mode, so that both give the same numbers.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def butterworth_step(cutoff_hz: float, period_s: float) -> tuple[FloatArray, FloatArray]:
    """Return (Ad, Bd) of H(s) = w^2 / (s^2 + sqrt(2) w s + w^2) under a constant input.

    State (output, its derivative). Closed form of the matrix exponential with the poles
    at w (-1 +- i) / sqrt(2).

    Args:
        cutoff_hz: -3 dB frequency, w / 2 pi.
        period_s: length of a substep.

    Returns:
        Ad, shape (2, 2); Bd, shape (2,).
    """
    w = 2.0 * math.pi * cutoff_hz
    real = w / math.sqrt(2.0)
    decay = math.exp(-real * period_s)
    c, s = math.cos(real * period_s), math.sin(real * period_s)
    ad = decay * np.array([[c + s, s / real], [-w * w * s / real, c - s]])
    # With a constant input u the filter settles at (u, 0): Bd = (I - Ad) (1, 0).
    bd = np.array([1.0 - ad[0, 0], -ad[1, 0]])
    return ad, bd


@dataclass(frozen=True, slots=True, eq=False)
class BlockFilter:
    """Matrices that take a block of substeps to its outputs and its final state."""

    samples: int  # outputs a block
    substeps: int  # substeps an output
    free: FloatArray  # (samples, 2): outputs from the state at the start
    forced: FloatArray  # (samples, samples * substeps): outputs from the input
    end_free: FloatArray  # (2, 2)
    end_forced: FloatArray  # (2, samples * substeps)
    free_by_reach: FloatArray  # (samples * substeps + 1, 2): output after so many substeps
    response: FloatArray  # (samples * substeps,): output so many substeps after a unit input

    def run(
        self, state: FloatArray, inputs: FloatArray, early: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return outputs (samples, k) and the final state (2, k).

        Args:
            state: at the start of the block, shape (2, k).
            inputs: one row a substep, shape (samples * substeps, k).
            early: substeps by which each output is taken too early, 0 to `substeps`, need
                not be whole, shape (samples,).
        """
        free, forced = (self.free, self.forced) if early is None else self._early(early)
        outputs = free @ state + forced @ inputs
        return outputs, self.end_free @ state + self.end_forced @ inputs

    def _early(self, early: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `free` and `forced` of outputs taken early: between two whole substeps."""
        whole = np.minimum(np.floor(early).astype(np.int64), self.substeps - 1)
        part = (early - whole)[:, None]
        reach = self.substeps * np.arange(1, self.samples + 1) - whole
        matrices = []
        for steps in (reach, reach - 1):
            delay = steps[:, None] - 1 - np.arange(self.samples * self.substeps)
            forced = np.where(delay >= 0, self.response[np.maximum(delay, 0)], 0.0)
            matrices.append((self.free_by_reach[steps], forced))
        (free, forced), (free_before, forced_before) = matrices
        return (1 - part) * free + part * free_before, (1 - part) * forced + part * forced_before


@lru_cache(maxsize=16)
def block_filter(cutoff_hz: float, period_s: float, substeps: int, samples: int) -> BlockFilter:
    """Return the filter for blocks of `samples` outputs, each after `substeps` substeps.

    Args:
        cutoff_hz: -3 dB frequency.
        period_s: length of a substep.
        substeps: substeps from one output to the next.
        samples: outputs a block.
    """
    ad, bd = butterworth_step(cutoff_hz, period_s)
    total = samples * substeps
    powers = np.empty((total + 1, 2, 2))
    powers[0] = np.eye(2)
    for k in range(total):
        powers[k + 1] = ad @ powers[k]
    response = powers[:total] @ bd  # (total, 2): state k substeps after a unit input
    forced = np.zeros((samples, total))
    for j in range(samples):
        reach = (j + 1) * substeps
        forced[j, :reach] = response[:reach, 0][::-1]
    return BlockFilter(
        samples=samples,
        substeps=substeps,
        free=powers[substeps::substeps, 0, :].copy(),
        forced=forced,
        end_free=powers[total],
        end_forced=response[::-1].T.copy(),
        free_by_reach=powers[:, 0, :].copy(),
        response=response[:, 0].copy(),
    )
