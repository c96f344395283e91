"""The clock from the least delay of each window, smoothed: a second opinion beside the envelope.

State: offset and frequency; the frequency walks at random with intensity q per sqrt(s).
The least of n delays of mean mu lies mu/n above the floor, with that standard deviation
if they are exponential; what they are, the windows' own scatter says. The walk's
intensity is the most likely one by the filter's prediction errors (Schweppe 1965; the
smoother is Rauch, Tung and Striebel, AIAA J. 3, 1965; equations in docs/clocks.md).
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.clocks.envelope import Envelope

WINDOW_S = 1.0
# Crystals on a desk walk 1e-9 to 1e-7 per sqrt(s) (notes, section 2); a resonator more.
WALKS = 10.0 ** np.arange(-9.5, -6.4, 0.25)
GATE_SIGMAS = 5.0  # a window above the floor by more holds a stall, and no floor
SKEW_SIGMA = 1e-3  # of the first window: ceramic resonators reach 640 ppm
_PIECE = 1 << 16  # samples detrended at a time: they stay in the processor's cache
_LAGS = 10  # over which windows are asked for memory of each other


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """The least detrended delay of each window that has samples."""

    at_s: FloatArray  # (w,), device time, the middle
    least_s: FloatArray  # (w,), expected excess over the floor taken off, trend put back
    excess_s: FloatArray  # (w,), what was taken off
    sigma_s: float  # of one, by their own scatter


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """The floor as the smoother has it."""

    floor: Envelope
    sigma_s: FloatArray  # (w,), predicted
    walk: float  # frequency random walk, per sqrt(s)
    memory: float  # sum of squared autocorrelations of the prediction errors
    windows: Windows


def least_delays(
    x: FloatArray, y: FloatArray, trend: Envelope, window_s: float, mean_s: float
) -> Windows:
    """Return the least delay of each window.

    Args:
        x: device time, not decreasing, shape (n,).
        y: delay, shape (n,).
        trend: taken out before the least is sought: 50 ppm are 50 us in a window of 1 s.
        window_s: their length.
        mean_s: of the delays above the floor, without stalls.
    """
    edges = x[0] + window_s * np.arange(int((x[-1] - x[0]) / window_s) + 1)
    rows = np.searchsorted(x, edges)
    counts = np.diff(rows, append=x.size)
    rows, middle, counts = rows[counts > 0], edges[counts > 0] + 0.5 * window_s, counts[counts > 0]
    least = np.empty(rows.size)
    start = 0
    while start < rows.size:
        stop = max(start + 1, int(np.searchsorted(rows, rows[start] + _PIECE)))
        a, b = int(rows[start]), int(rows[stop]) if stop < rows.size else x.size
        least[start:stop] = np.minimum.reduceat(y[a:b] - trend.at(x[a:b]), rows[start:stop] - a)
        start = stop
    excess = mean_s / counts
    scatter = _scatter_s(least - excess)
    return Windows(middle, least - excess + trend.at(middle), excess, scatter)


def _scatter_s(values: FloatArray) -> float:
    """Return the deviation of neighbours from each other, robustly."""
    if values.size < 5:
        return 0.0
    bend = values[2:] - 2.0 * values[1:-1] + values[:-2]
    return float(np.median(np.abs(bend)) * 1.4826 / np.sqrt(6.0))


def smooth(x: FloatArray, y: FloatArray, line: Envelope, mean_s: float) -> Smoothed | None:
    """Return the smoothed floor, None where there are too few windows.

    Args:
        x: device time, not decreasing, shape (n,).
        y: delay, shape (n,).
        line: a first straight trend.
        mean_s: of the delays above the floor, without stalls.
    """
    windows = least_delays(x, y, line, WINDOW_S, mean_s)
    if windows.at_s.size < 2 * _LAGS:
        return None
    rough, _ = _smoothed_floor(windows, 1e-7, _not_stalled(windows, line))
    windows = least_delays(x, y, rough, WINDOW_S, mean_s)
    used = _not_stalled(windows, rough)
    walk, left = _likely_walk(windows, used)
    # Where the clock keeps its rate for long, long windows see a lower floor.
    balance_s = (mean_s * (x[-1] - x[0]) / x.size / walk) ** 0.4
    window_s = float(np.clip(balance_s / 3.0, WINDOW_S, 10.0))
    if window_s > 1.5 * WINDOW_S and (x[-1] - x[0]) / window_s > 4 * _LAGS:
        rough, _ = _smoothed_floor(windows, walk, used)
        windows = least_delays(x, y, rough, window_s, mean_s)
        used = _not_stalled(windows, rough)
    floor, sigma_s = _smoothed_floor(windows, walk, used)
    used &= windows.least_s - floor.at(windows.at_s) < GATE_SIGMAS * _noise(windows)
    floor, sigma_s = _smoothed_floor(windows, walk, used)
    return Smoothed(floor, sigma_s, walk, left, windows)


def _noise(windows: Windows) -> FloatArray:
    return np.asarray(np.maximum(np.maximum(windows.excess_s, windows.sigma_s), 1e-9))


def _not_stalled(windows: Windows, trend: Envelope) -> BoolArray:
    """Return the windows not far above their neighbours' middle."""
    rest = windows.least_s - trend.at(windows.at_s)
    padded = np.pad(rest, 7, mode="edge")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 15), axis=1)
    return np.asarray(rest - middle < GATE_SIGMAS * _noise(windows), dtype=np.bool_)


def _filtered(
    windows: Windows, walk: float, used: BoolArray
) -> tuple[list[tuple[float, ...]], FloatArray, FloatArray]:
    """Return the states before and after each window, the prediction errors, their variances."""
    at, value = windows.at_s.tolist(), windows.least_s.tolist()
    variance, good = (_noise(windows) ** 2).tolist(), used.tolist()
    q, now = walk**2, at[0]
    first = good.index(True) if True in good else 0
    offset, skew, oo, os, ss = value[first], 0.0, 1.0, 0.0, SKEW_SIGMA**2
    states: list[tuple[float, ...]] = []
    error, spread = np.full(len(at), np.nan), np.full(len(at), np.nan)
    for k, (t, z, r, use) in enumerate(zip(at, value, variance, good, strict=True)):
        dt, now = t - now, t
        offset += skew * dt
        oo += 2.0 * dt * os + dt * dt * ss + q * dt**3 / 3.0
        os += dt * ss + q * dt * dt / 2.0
        ss += q * dt
        before = (offset, skew, oo, os, ss)
        if use:
            total = oo + r
            error[k], spread[k] = z - offset, total
            a, b = oo / total, os / total
            offset += a * (z - offset)
            skew += b * error[k]
            ss -= b * os
            oo, os = oo * r / total, os * r / total
        states.append((*before, offset, skew, oo, os, ss, dt))
    return states, error, spread


def _smoothed_floor(windows: Windows, walk: float, used: BoolArray) -> tuple[Envelope, FloatArray]:
    """Return the Rauch-Tung-Striebel floor and its predicted deviation."""
    states, _, _ = _filtered(windows, walk, used)
    n = len(states)
    floor, sigma = np.empty(n), np.empty(n)
    offset, skew, oo, os, ss = states[-1][5:10]
    floor[-1], sigma[-1] = offset, np.sqrt(max(oo, 0.0))
    for k in range(n - 2, -1, -1):
        bo, bs, boo, bos, bss = states[k + 1][:5]
        dt = states[k + 1][10]
        fo, fs, foo, fos, fss = states[k][5:10]
        det = boo * bss - bos * bos
        # Gain = P F' inverse(P-), with F = [[1, dt], [0, 1]].
        c00, c01, c10, c11 = foo + dt * fos, fos, fos + dt * fss, fss
        g00, g01 = (c00 * bss - c01 * bos) / det, (c01 * boo - c00 * bos) / det
        g10, g11 = (c10 * bss - c11 * bos) / det, (c11 * boo - c10 * bos) / det
        do, ds, poo, pos, pss = offset - bo, skew - bs, oo - boo, os - bos, ss - bss
        offset, skew = fo + g00 * do + g01 * ds, fs + g10 * do + g11 * ds
        u0, u1 = g00 * poo + g01 * pos, g00 * pos + g01 * pss
        v0, v1 = g10 * poo + g11 * pos, g10 * pos + g11 * pss
        oo = foo + u0 * g00 + u1 * g01
        os = fos + u0 * g10 + u1 * g11
        ss = fss + v0 * g10 + v1 * g11
        floor[k], sigma[k] = offset, np.sqrt(max(oo, 0.0))
    return Envelope(windows.at_s, floor), sigma


def _likely_walk(windows: Windows, used: BoolArray) -> tuple[float, float]:
    """Return the walk of greatest likelihood and the memory that it leaves in the errors.

    Errors count as far as four sigmas: delays have tails that the clock has not.
    """
    best, walk, left = -np.inf, float(WALKS[0]), 0.0
    for candidate in WALKS.tolist():
        _, error, spread = _filtered(windows, candidate, used)
        there = np.flatnonzero(np.isfinite(error))[2:]
        z = np.clip(error[there] / np.sqrt(spread[there]), -4.0, 4.0)
        likelihood = -0.5 * float(np.sum(z**2 + np.log(spread[there])))
        if likelihood > best:
            best, walk, left = likelihood, candidate, memory(z)
    return walk, left


def memory(z: FloatArray) -> float:
    """Return the sum of squared autocorrelations, what chance brings taken off."""
    z = z - np.mean(z)
    power = float(np.sum(z * z))
    if power <= 0.0 or z.size < 2 * _LAGS:
        return 0.0
    rho = np.array([float(np.sum(z[lag:] * z[:-lag])) / power for lag in range(1, _LAGS + 1)])
    return max(0.0, float(np.sum(rho**2)) - 2.5 * _LAGS / z.size)
