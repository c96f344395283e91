"""Linear filters of low order, run along arrays.

What to use when: `steady` for a sensor's low-pass, begun as if the first value had always
been there; `recursed` for a filter begun at rest; `Thinned` where only every so many
outputs are wanted. A recursion is a triangular banded system, which LAPACK solves in
place; `scipy.signal` would take 0.3 s to import.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from scipy.linalg import expm
from scipy.linalg.lapack import dtbtrs

from gyrorig_solver.arrays import FloatArray


def recursed(numerator: FloatArray, denominator: FloatArray, signal: FloatArray) -> FloatArray:
    """Return a signal (..., n) behind b(z)/a(z), begun at rest.

    Args:
        numerator: b, shape (p,).
        denominator: a, shape (q,), its first value 1.
        signal: filtered along its last axis.
    """
    n = signal.shape[-1]
    moved = numerator[0] * signal
    some = np.empty_like(moved)
    for k in range(1, min(numerator.size, n)):
        np.multiply(signal[..., :-k], numerator[k], out=some[..., k:])
        moved[..., k:] += some[..., k:]
    return _solved(denominator, moved)


def steady(numerator: FloatArray, denominator: FloatArray, signal: FloatArray) -> FloatArray:
    """Return a signal (..., n) behind b(z)/a(z), its first value taken as from ever."""
    first = signal[..., :1]
    always = float(np.sum(numerator) / np.sum(denominator))
    found = recursed(numerator, denominator, signal - first)
    found += always * first
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Thinned:
    """A filter of which only one of every `step` outputs is wanted, exactly.

    b(z)/a(z) times what makes a(z) a polynomial of z^step: few sums over inputs, and a
    recursion as short as what is wanted.
    """

    taps: FloatArray  # (step, m), of the inputs of a block, and of the blocks before it
    denominator: FloatArray  # of the recursion from block to block
    always: float  # the gain at zero frequency

    @classmethod
    def of(cls, numerator: FloatArray, denominator: FloatArray, step: int, at: int) -> Self:
        """Return the filter for so many inputs to an output.

        Args:
            numerator: b, shape (p,).
            denominator: a, shape (q,), its first value 1; no pole twice.
            step: inputs to an output.
            at: which output of each block of inputs is wanted.
        """
        poles = np.roots(denominator)
        wide, slow = np.asarray(numerator, dtype=np.complex128), np.ones(1, dtype=np.complex128)
        for pole in poles:
            wide = np.convolve(wide, pole ** np.arange(step))
            slow = np.convolve(slow, [1.0, -(pole**step)])
        back = 1 + -(-max(0, wide.size - 1 - at) // step)
        latest = np.zeros(back * step)  # taps by how long before a block's end they look
        latest[step - 1 - at : step - 1 - at + wide.size] = wide.real
        taps = latest.reshape(back, step)[:, ::-1].T
        always = float(np.sum(numerator) / np.sum(denominator))
        return cls(np.ascontiguousarray(taps), slow.real, always)

    def steady(self, signal: FloatArray) -> FloatArray:
        """Return the outputs, (..., n / step), the first input taken as from ever.

        Args:
            signal: shape (..., n), n a multiple of the step.
        """
        step, back = self.taps.shape
        first = signal[..., :1]
        blocks = (signal - first).reshape(*signal.shape[:-1], -1, step)
        parts = blocks @ self.taps
        moved = parts[..., 0].copy()
        for k in range(1, min(back, moved.shape[-1])):
            moved[..., k:] += parts[..., :-k, k]
        found = _solved(self.denominator, moved)
        found += self.always * first
        return found


@lru_cache(maxsize=64)
def ramp_invariant(
    omega_rad_s: float, damping: float, step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return b and a of w^2 / (s^2 + 2 z w s + w^2), exact for inputs straight in a step.

    Source: Franklin, Powell, Workman, Digital Control of Dynamic Systems, 6.3.2
    (first-order hold, by one matrix exponential).
    """
    w, z = omega_rad_s, damping
    system = np.array([[-2.0 * z * w, -(w**2)], [1.0, 0.0]])
    output = np.array([0.0, w**2])
    whole = np.zeros((4, 4))
    whole[:2, :2] = system * step_s
    whole[0, 2] = step_s
    whole[2, 3] = 1.0
    power = expm(whole)
    over, held, risen = power[:2, :2], power[:2, 2], power[:2, 3]
    inside = held - risen + over @ risen
    through = float(output @ risen)
    denominator = np.poly(over)
    numerator = np.poly(over - np.outer(inside, output)) + (through - 1.0) * denominator
    return np.asarray(numerator, np.float64), np.asarray(denominator, np.float64)


def step_invariant(
    omega_rad_s: float, damping: float, step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return b and a of 1 / (s^2 + 2 z w s + w^2), exact for inputs held for a step.

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


def _solved(denominator: FloatArray, moved: FloatArray) -> FloatArray:
    """Return y of a(z) y = moved, (..., n), begun at rest; `moved` is lost."""
    n = moved.shape[-1]
    if denominator.size == 1 or moved.size == 0:
        return moved
    bands = np.empty((n, denominator.size))
    bands[:] = denominator
    rows = np.ascontiguousarray(moved.reshape(-1, n))
    found, _ = dtbtrs(bands.T, rows.T, uplo="L", diag="U", overwrite_b=True)
    return np.asarray(found.T.reshape(moved.shape), dtype=np.float64)
