"""Recursive linear filters of low order, applied along arrays.

What to use when: `filter_from_steady` for a sensor's low-pass, as if the first value had lasted
forever; `filter_from_rest` for a filter that starts at rest; `DecimatingFilter` if only every n-th
output is needed. A recursion is a triangular banded system, which LAPACK solves in place;
`scipy.signal` would take 0.3 s to import.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from scipy.linalg import expm
from scipy.linalg.lapack import dtbtrs

from gyrorig_solver.data.arrays import FloatArray


def filter_from_rest(
    numerator: FloatArray, denominator: FloatArray, signal: FloatArray
) -> FloatArray:
    """Return a signal (..., n) filtered by b(z)/a(z) from rest.

    Args:
        numerator: b, shape (p,).
        denominator: a, shape (q,), its first value 1.
        signal: filtered along its last axis.
    """
    n = signal.shape[-1]
    moving_average = numerator[0] * signal
    scaled = np.empty_like(moving_average)
    for k in range(1, min(numerator.size, n)):
        np.multiply(signal[..., :-k], numerator[k], out=scaled[..., k:])
        moving_average[..., k:] += scaled[..., k:]
    return _solve_recursion(denominator, moving_average)


def filter_from_steady(
    numerator: FloatArray, denominator: FloatArray, signal: FloatArray
) -> FloatArray:
    """Return a signal (..., n) filtered by b(z)/a(z), from the steady state of its first value."""
    first = signal[..., :1]
    dc_gain = float(np.sum(numerator) / np.sum(denominator))
    filtered = filter_from_rest(numerator, denominator, signal - first)
    filtered += dc_gain * first
    return filtered


@dataclass(frozen=True, slots=True, eq=False)
class DecimatingFilter:
    """A filter of which only one of every `step` outputs is computed, exactly.

    b(z)/a(z) is multiplied by the factor that makes a(z) a polynomial of z^step: short sums over
    the inputs, and a recursion over the computed outputs only.
    """

    taps: FloatArray  # (step, m), of the inputs of a block and of the previous blocks
    denominator: FloatArray  # of the recursion over blocks
    dc_gain: float  # gain at zero frequency

    @classmethod
    def of(
        cls, numerator: FloatArray, denominator: FloatArray, step: int, output_phase: int
    ) -> Self:
        """Return the filter for `step` inputs per output.

        Args:
            numerator: b, shape (p,).
            denominator: a, shape (q,), its first value 1, without a double pole.
            step: inputs per output.
            output_phase: which output of each block of inputs is computed.
        """
        poles = np.roots(denominator)
        long_numerator, block_denominator = (
            np.asarray(numerator, dtype=np.complex128),
            np.ones(1, dtype=np.complex128),
        )
        for pole in poles:
            long_numerator = np.convolve(long_numerator, pole ** np.arange(step))
            block_denominator = np.convolve(block_denominator, [1.0, -(pole**step)])
        block_count = 1 + -(-max(0, long_numerator.size - 1 - output_phase) // step)
        taps_by_age = np.zeros(block_count * step)  # taps by their age at the end of a block
        taps_by_age[step - 1 - output_phase : step - 1 - output_phase + long_numerator.size] = (
            long_numerator.real
        )
        taps = taps_by_age.reshape(block_count, step)[:, ::-1].T
        dc_gain = float(np.sum(numerator) / np.sum(denominator))
        return cls(np.ascontiguousarray(taps), block_denominator.real, dc_gain)

    def filter_from_steady(self, signal: FloatArray) -> FloatArray:
        """Return the outputs, (..., n / step), from the steady state of the first input.

        Args:
            signal: shape (..., n), n a multiple of the step.
        """
        step, block_count = self.taps.shape
        rows = signal.reshape(-1, signal.shape[-1])
        moving_average = np.empty((len(rows), rows.shape[1] // step))
        for row, average in zip(rows, moving_average, strict=True):
            parts = (row - row[0]).reshape(-1, step) @ self.taps
            average[:] = parts[:, 0]
            for k in range(1, min(block_count, average.size)):
                average[k:] += parts[:-k, k]
        filtered = _solve_recursion(self.denominator, moving_average)
        filtered += self.dc_gain * rows[:, :1]
        return filtered.reshape(*signal.shape[:-1], moving_average.shape[1])


@lru_cache(maxsize=64)
def ramp_invariant(
    omega_rad_s: float, damping: float, step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return b and a of w^2 / (s^2 + 2 z w s + w^2), exact for piecewise linear inputs.

    Source: Franklin, Powell, Workman, Digital Control of Dynamic Systems, 6.3.2 (first-order hold,
    by one matrix exponential).
    """
    w, z = omega_rad_s, damping
    system = np.array([[-2.0 * z * w, -(w**2)], [1.0, 0.0]])
    output = np.array([0.0, w**2])
    augmented = np.zeros((4, 4))
    augmented[:2, :2] = system * step_s
    augmented[0, 2] = step_s
    augmented[2, 3] = 1.0
    exponential = expm(augmented)
    transition, step_response, ramp_response = (
        exponential[:2, :2],
        exponential[:2, 2],
        exponential[:2, 3],
    )
    input_matrix = step_response - ramp_response + transition @ ramp_response
    feedthrough = float(output @ ramp_response)
    denominator = np.poly(transition)
    numerator = (
        np.poly(transition - np.outer(input_matrix, output)) + (feedthrough - 1.0) * denominator
    )
    return np.asarray(numerator, np.float64), np.asarray(denominator, np.float64)


def step_invariant(
    omega_rad_s: float, damping: float, step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return b and a of 1 / (s^2 + 2 z w s + w^2), exact for piecewise constant inputs.

    Source: Astrom, Wittenmark, Computer-Controlled Systems, table 2.1; z below 1.
    """
    w, z = omega_rad_s, damping
    root = np.sqrt(1.0 - z * z)
    decay = float(np.exp(-z * w * step_s))
    cosine = float(np.cos(w * root * step_s))
    sine = float(np.sin(w * root * step_s)) * z / root
    numerator = np.array(
        [0.0, 1.0 - decay * (cosine + sine), decay * (decay + sine - cosine)], dtype=np.float64
    )
    return numerator / w**2, np.array([1.0, -2.0 * decay * cosine, decay * decay])


def _solve_recursion(denominator: FloatArray, right_side: FloatArray) -> FloatArray:
    """Return y of a(z) y = right_side, (..., n), from rest; `right_side` is overwritten."""
    n = right_side.shape[-1]
    if denominator.size == 1 or right_side.size == 0:
        return right_side
    bands = _bands(tuple(denominator.tolist()), n)
    rows = np.ascontiguousarray(right_side.reshape(-1, n))
    solution, _ = dtbtrs(bands.T, rows.T, uplo="L", diag="U", overwrite_b=True)
    return np.asarray(solution.T.reshape(right_side.shape), dtype=np.float64)


@lru_cache(maxsize=4)
def _bands(denominator: tuple[float, ...], n: int) -> FloatArray:
    """Return the bands of the triangular matrix of a recursion, (n, q); not to be written to."""
    bands = np.empty((n, len(denominator)))
    bands[:] = denominator
    return bands
