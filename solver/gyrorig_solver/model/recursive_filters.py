"""Recursive linear filters of low order, applied along arrays.

What to use when: `filter_from_steady` for a sensor's low-pass, as if the first value had lasted
forever, and if only every n-th output is needed; `filter_from_rest` for a filter that starts at
rest. Both compute the outputs of a block of inputs by one matrix product; only the state between
blocks is a recursion. `scipy.signal` would take 0.3 s to import.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import expm
from scipy.linalg.lapack import dtbtrs

from gyrorig_solver.data import FloatArray

BLOCK_OUTPUTS, BLOCK_DECIMATED_OUTPUTS = 40, 16  # the fastest of the measured sizes
VALUES_TOGETHER = 65_536  # of the rows that fit into a cache
NEGLIGIBLE_MEMORY = 1e-17  # of the outputs before a block in those at its end: below rounding
ORDER = 2  # of the recursion


def filter_from_rest(
    numerator: FloatArray, denominator: FloatArray, signal: FloatArray
) -> FloatArray:
    """Return a signal (..., n) filtered by b(z)/a(z) from rest.

    Args:
        numerator: b, shape (p,).
        denominator: a, shape (q,), q at most 3, its first value 1.
        signal: filtered along its last axis.
    """
    return _cached_filter(numerator, denominator, 1, 0).apply(signal, from_steady=False)


def filter_from_steady(
    numerator: FloatArray,
    denominator: FloatArray,
    signal: FloatArray,
    step: int = 1,
    phase: int = 0,
) -> FloatArray:
    """Return a signal (..., n) filtered by b(z)/a(z), from the steady state of its first value.

    Args:
        numerator: b, shape (p,).
        denominator: a, shape (q,), q at most 3, its first value 1, with a gain at zero frequency.
        signal: filtered along its last axis, n a multiple of the step.
        step: only one output per this number of outputs is computed.
        phase: the index of the computed output among them.

    Returns:
        The computed outputs, shape (..., n / step).
    """
    return _cached_filter(numerator, denominator, step, phase).apply(signal, from_steady=True)


def _cached_filter(
    numerator: FloatArray, denominator: FloatArray, step: int, phase: int
) -> "_BlockFilter":
    return _block_filter(tuple(numerator.tolist()), tuple(denominator.tolist()), step, phase)


@dataclass(frozen=True, slots=True, eq=False)
class _BlockFilter:
    """A filter as matrices from a block of m inputs, and from earlier values, to its outputs.

    The values before a block are its last p - 1 inputs, the older ones first, and its last two
    outputs, the newer one first.
    """

    step: int
    dc_gain: float
    wanted: FloatArray  # (m, m / step), from the inputs to the wanted outputs
    last: FloatArray  # (m, 2), from the inputs to the block's last two outputs, the newer first
    wanted_before: FloatArray  # (p + 1, m / step), from the values before to the wanted outputs
    last_before: FloatArray  # (p + 1, 2), from the values before to the last two outputs
    feedback: tuple[float, float] | None  # trace and determinant of A; None: A is negligible
    feedforward: FloatArray  # (2, 2), transposed A minus its trace; A: see `_solve_state`

    def apply(self, signal: FloatArray, from_steady: bool) -> FloatArray:
        """Return the outputs of a signal (..., n), shape (..., n / step)."""
        n, size = signal.shape[-1], len(self.wanted)
        rows = signal.reshape(-1, n)
        outputs = np.empty((len(rows), -(-n // size), size // self.step))
        together = max(1, VALUES_TOGETHER // max(n, 1))
        blocks = np.zeros((min(together, len(rows)), outputs.shape[1], size))
        padded = blocks.reshape(len(blocks), -1)
        for first in range(0, len(rows) if n else 0, together):
            batch = rows[first : first + together]
            padded[: len(batch), :n] = batch
            self._apply_to_blocks(
                blocks[: len(batch)], from_steady, outputs[first : first + together]
            )
        wanted = outputs.reshape(len(rows), -1)[:, : n // self.step]
        return wanted.reshape(*signal.shape[:-1], n // self.step)

    def _apply_to_blocks(self, blocks: FloatArray, from_steady: bool, outputs: FloatArray) -> None:
        """Compute the outputs of the blocks of some rows, (rows, blocks, m)."""
        np.matmul(blocks, self.wanted, out=outputs)
        inputs = len(self.wanted_before) - ORDER
        before = np.zeros((*blocks.shape[:2], inputs + ORDER))
        if from_steady:
            first = blocks[:, 0, :1]
            before[:, 0, :inputs], before[:, 0, inputs:] = first, self.dc_gain * first
        before[:, 1:, :inputs] = blocks[:, :-1, len(self.wanted) - inputs :]
        last = outputs[..., : -ORDER - 1 : -1] if self.step == 1 else blocks @ self.last
        driven = last + before @ self.last_before
        before[:, 1:, inputs:] = self._solve_state(driven[:, :-1])
        outputs += before @ self.wanted_before

    def _solve_state(self, driven: FloatArray) -> FloatArray:
        """Return e of e_k = A e_{k-1} + u_k from rest, (rows, blocks, 2), for u of that shape.

        By the theorem of Cayley and Hamilton each of its values obeys a scalar recursion:
        e_k - tr(A) e_{k-1} + det(A) e_{k-2} = u_k + (A - tr(A)) u_{k-1}.
        """
        if self.feedback is None or not driven.size:
            return driven
        right_side = driven.copy()
        right_side[:, 1:] += driven[:, :-1] @ self.feedforward
        count = driven.shape[1]
        columns = np.ascontiguousarray(np.swapaxes(right_side, 1, 2)).reshape(-1, count)
        bands = np.empty((count, ORDER + 1))
        bands[:] = 1.0, -self.feedback[0], self.feedback[1]
        solution, _ = dtbtrs(bands.T, columns.T, uplo="L", diag="U", overwrite_b=True)
        return np.swapaxes(solution.T.reshape(-1, ORDER, count), 1, 2)


@lru_cache(maxsize=64)
def _block_filter(
    numerator: tuple[float, ...], denominator: tuple[float, ...], step: int, phase: int
) -> _BlockFilter:
    """Return the matrices of a filter; see `_BlockFilter`."""
    size = BLOCK_OUTPUTS if step == 1 else BLOCK_DECIMATED_OUTPUTS * step
    inputs = len(numerator) - 1
    feedback = np.zeros(ORDER + 1)
    feedback[: len(denominator)] = denominator
    # Each output is a sum over earlier inputs, earlier outputs and inputs. Two outputs come before.
    sums = np.zeros((ORDER + size, inputs + ORDER + size))
    sums[1, inputs] = sums[0, inputs + 1] = 1.0
    for k in range(size):
        sums[k + ORDER] = -feedback[1] * sums[k + 1] - feedback[2] * sums[k]
        for age, tap in enumerate(numerator):
            place = k - age if k < age else k - age + ORDER
            sums[k + ORDER, inputs + place] += tap
    outputs, last = sums[ORDER + phase :: step].T, sums[: -ORDER - 1 : -1].T
    first = inputs + ORDER
    transition = last[inputs:first]
    trace = float(np.trace(transition))
    has_memory = float(np.abs(transition).max()) > NEGLIGIBLE_MEMORY
    dc_sum = float(np.sum(denominator))
    return _BlockFilter(
        step,
        float(np.sum(numerator)) / dc_sum if dc_sum else 0.0,
        np.ascontiguousarray(outputs[first:]),
        np.ascontiguousarray(last[first:]),
        np.ascontiguousarray(outputs[:first]),
        np.ascontiguousarray(last[:first]),
        (trace, float(np.linalg.det(transition))) if has_memory else None,
        transition - trace * np.eye(ORDER),
    )


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
