"""Low-pass of the sensor: a second-order Butterworth filter, solved exactly in blocks.

The input is constant over each substep, so that the discrete state space is exact. A block of
substeps becomes a few small matrix products, the same in real and in simulated time, so that both
give the same numbers.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def butterworth_delay_s(cutoff_hz: float) -> float:
    """Return the group delay at zero frequency, sqrt(2) / w."""
    return math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz)


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
    """Matrices that map a block of substeps to its outputs and its final state."""

    samples: int  # outputs per block
    substeps: int  # substeps per output
    free: FloatArray  # (samples, 2): outputs from the state at the start
    forced: FloatArray  # (samples, samples * substeps): outputs from the input
    end_free: FloatArray  # (2, 2)
    end_forced: FloatArray  # (2, samples * substeps)
    free_by_reach: FloatArray  # (samples * substeps + 1, 2): output after k substeps
    response: FloatArray  # (samples * substeps,): output k substeps after a unit input

    def run(
        self, state: FloatArray, inputs: FloatArray, early_substeps: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return outputs (samples, k) and the final state (2, k).

        Args:
            state: at the start of the block, shape (2, k).
            inputs: one row per substep, shape (samples * substeps, k).
            early_substeps: substeps by which each output is taken too early, 0 to `substeps`, can
                be fractional, shape (samples,).
        """
        free, forced = (
            (self.free, self.forced)
            if early_substeps is None
            else self._matrices_for_early_outputs(early_substeps)
        )
        outputs = free @ state + forced @ inputs
        return outputs, self.end_free @ state + self.end_forced @ inputs

    def _matrices_for_early_outputs(
        self, early_substeps: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return `free` and `forced` for early outputs, interpolated between substeps."""
        whole_substeps = np.minimum(np.floor(early_substeps).astype(np.int64), self.substeps - 1)
        fraction = (early_substeps - whole_substeps)[:, None]
        reach = self.substeps * np.arange(1, self.samples + 1) - whole_substeps
        matrices = []
        for steps in (reach, reach - 1):
            delay = steps[:, None] - 1 - np.arange(self.samples * self.substeps)
            forced = np.where(delay >= 0, self.response[np.maximum(delay, 0)], 0.0)
            matrices.append((self.free_by_reach[steps], forced))
        (free, forced), (free_before, forced_before) = matrices
        return (1 - fraction) * free + fraction * free_before, (
            1 - fraction
        ) * forced + fraction * forced_before


@lru_cache(maxsize=16)
def block_filter(cutoff_hz: float, period_s: float, substeps: int, samples: int) -> BlockFilter:
    """Return the filter for blocks of `samples` outputs, each after `substeps` substeps.

    Args:
        cutoff_hz: -3 dB frequency.
        period_s: length of a substep.
        substeps: substeps from one output to the next.
        samples: outputs per block.
    """
    ad, bd = butterworth_step(cutoff_hz, period_s)
    total_substeps = samples * substeps
    powers = np.empty((total_substeps + 1, 2, 2))
    powers[0] = np.eye(2)
    for k in range(total_substeps):
        powers[k + 1] = ad @ powers[k]
    response = powers[:total_substeps] @ bd  # (total, 2): state k substeps after a unit input
    forced = np.zeros((samples, total_substeps))
    for j in range(samples):
        reach = (j + 1) * substeps
        forced[j, :reach] = response[:reach, 0][::-1]
    return BlockFilter(
        samples=samples,
        substeps=substeps,
        free=powers[substeps::substeps, 0, :].copy(),
        forced=forced,
        end_free=powers[total_substeps],
        end_forced=response[::-1].T.copy(),
        free_by_reach=powers[:, 0, :].copy(),
        response=response[:, 0].copy(),
    )
