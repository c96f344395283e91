"""Kalman smoother of the clock on the least delay of each window.

The state is offset and frequency; the frequency is a random walk of intensity q per sqrt(s).
The least of n exponential delays of mean mu is mu/n above the floor, with the same standard
deviation; the scatter of the windows shows the actual noise. The intensity of the walk
maximises the likelihood of the prediction errors (Schweppe 1965; the smoother is Rauch, Tung and
Striebel, AIAA J. 3, 1965; equations in docs/clocks.md).
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, FloatArray
from gyrorig_solver.data.clocks.lower_envelope import Envelope

WINDOW_S = 1.0
# Crystals on a desk are assumed to walk 1e-9 to 1e-7 per sqrt(s); a resonator walks more.
WALK_CANDIDATES = 10.0 ** np.arange(-9.5, -6.4, 0.25)
GATE_SIGMAS = 5.0  # above the floor; such a window contains a stall
INITIAL_SKEW_SIGMA = 1e-3  # of the first window; ceramic resonators reach 640 ppm
_PIECE_SAMPLES = 1 << 16  # samples per piece, which stay in the processor cache
_LAGS = 10  # lags of the autocorrelation, in windows


@dataclass(frozen=True, slots=True, eq=False)
class DelayWindows:
    """The least detrended delay of each window that has samples."""

    at_s: FloatArray  # (w,), device time, the middle
    least_s: FloatArray  # (w,), minus the expected excess over the floor
    excess_s: FloatArray  # (w,), the expected excess
    sigma_s: float  # of one window, from their scatter


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedClock:
    """The smoothed latency floor."""

    floor: Envelope
    sigma_s: FloatArray  # (w,), predicted
    walk_per_sqrt_s: float  # frequency random walk, per sqrt(s)
    autocorrelation: float  # sum of squared autocorrelations of the prediction errors
    windows: DelayWindows


def least_delays(
    device_s: FloatArray, delay_s: FloatArray, trend: Envelope, window_s: float, mean_s: float
) -> DelayWindows:
    """Return the least delay of each window.

    Args:
        device_s: device time, not decreasing, shape (n,).
        delay_s: delay, shape (n,).
        trend: subtracted before the minimum is taken; 50 ppm are 50 us in a window of 1 s.
        window_s: length of the windows.
        mean_s: of the delays above the floor, without stalls.
    """
    edges = device_s[0] + window_s * np.arange(int((device_s[-1] - device_s[0]) / window_s) + 1)
    rows = np.searchsorted(device_s, edges)
    counts = np.diff(rows, append=device_s.size)
    rows, middle, counts = rows[counts > 0], edges[counts > 0] + 0.5 * window_s, counts[counts > 0]
    least_s = np.empty(rows.size)
    start = 0
    while start < rows.size:
        stop = max(start + 1, int(np.searchsorted(rows, rows[start] + _PIECE_SAMPLES)))
        a, b = int(rows[start]), int(rows[stop]) if stop < rows.size else device_s.size
        least_s[start:stop] = np.minimum.reduceat(
            delay_s[a:b] - trend.delay_at(device_s[a:b]), rows[start:stop] - a
        )
        start = stop
    excess_s = mean_s / counts
    sigma_s = _scatter_s(least_s - excess_s)
    return DelayWindows(middle, least_s - excess_s + trend.delay_at(middle), excess_s, sigma_s)


def _scatter_s(values: FloatArray) -> float:
    """Return a robust standard deviation from second differences."""
    if values.size < 5:
        return 0.0
    bend = values[2:] - 2.0 * values[1:-1] + values[:-2]
    return float(np.median(np.abs(bend)) * 1.4826 / np.sqrt(6.0))


def smooth_clock(
    device_s: FloatArray, delay_s: FloatArray, line: Envelope, mean_s: float
) -> SmoothedClock | None:
    """Return the smoothed floor, None if there are too few windows.

    Args:
        device_s: device time, not decreasing, shape (n,).
        delay_s: delay, shape (n,).
        line: a first straight trend.
        mean_s: of the delays above the floor, without stalls.
    """
    windows = least_delays(device_s, delay_s, line, WINDOW_S, mean_s)
    if windows.at_s.size < 2 * _LAGS:
        return None
    trend, _ = _rts_smoother(windows, 1e-7, _without_stalls(windows, line))
    windows = least_delays(device_s, delay_s, trend, WINDOW_S, mean_s)
    used = _without_stalls(windows, trend)
    walk, autocorrelation = _likeliest_walk(windows, used)
    # If the rate of the clock is stable, longer windows give a better floor.
    balance_s = (mean_s * (device_s[-1] - device_s[0]) / device_s.size / walk) ** 0.4
    window_s = float(np.clip(balance_s / 3.0, WINDOW_S, 10.0))
    if window_s > 1.5 * WINDOW_S and (device_s[-1] - device_s[0]) / window_s > 4 * _LAGS:
        trend, _ = _rts_smoother(windows, walk, used)
        windows = least_delays(device_s, delay_s, trend, window_s, mean_s)
        used = _without_stalls(windows, trend)
    floor, sigma_s = _rts_smoother(windows, walk, used)
    used &= windows.least_s - floor.delay_at(windows.at_s) < GATE_SIGMAS * _window_noise_s(windows)
    floor, sigma_s = _rts_smoother(windows, walk, used)
    return SmoothedClock(floor, sigma_s, walk, autocorrelation, windows)


def _window_noise_s(windows: DelayWindows) -> FloatArray:
    return np.asarray(np.maximum(np.maximum(windows.excess_s, windows.sigma_s), 1e-9))


def _without_stalls(windows: DelayWindows, trend: Envelope) -> BoolArray:
    """Return the mask of windows that are not far above the local median."""
    residual_s = windows.least_s - trend.delay_at(windows.at_s)
    padded = np.pad(residual_s, 7, mode="edge")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 15), axis=1)
    return np.asarray(residual_s - middle < GATE_SIGMAS * _window_noise_s(windows), dtype=np.bool_)


def _kalman_filter(
    windows: DelayWindows, walk: float, used: BoolArray
) -> tuple[list[tuple[float, ...]], FloatArray, FloatArray]:
    """Return predicted and filtered states, the prediction errors and their variances."""
    at, value = windows.at_s.tolist(), windows.least_s.tolist()
    variance, good = (_window_noise_s(windows) ** 2).tolist(), used.tolist()
    q, previous_s = walk**2, at[0]
    first = good.index(True) if True in good else 0
    offset, skew, oo, os, ss = value[first], 0.0, 1.0, 0.0, INITIAL_SKEW_SIGMA**2
    states: list[tuple[float, ...]] = []
    error, error_variance = np.full(len(at), np.nan), np.full(len(at), np.nan)
    for k, (t, z, r, use) in enumerate(zip(at, value, variance, good, strict=True)):
        dt, previous_s = t - previous_s, t
        offset += skew * dt
        oo += 2.0 * dt * os + dt * dt * ss + q * dt**3 / 3.0
        os += dt * ss + q * dt * dt / 2.0
        ss += q * dt
        before = (offset, skew, oo, os, ss)
        if use:
            total = oo + r
            error[k], error_variance[k] = z - offset, total
            a, b = oo / total, os / total
            offset += a * (z - offset)
            skew += b * error[k]
            ss -= b * os
            oo, os = oo * r / total, os * r / total
        states.append((*before, offset, skew, oo, os, ss, dt))
    return states, error, error_variance


def _rts_smoother(
    windows: DelayWindows, walk: float, used: BoolArray
) -> tuple[Envelope, FloatArray]:
    """Return the Rauch-Tung-Striebel floor and its predicted standard deviation."""
    states, _, _ = _kalman_filter(windows, walk, used)
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


def _likeliest_walk(windows: DelayWindows, used: BoolArray) -> tuple[float, float]:
    """Return the walk of maximum likelihood and the autocorrelation of its errors.

    Errors are limited to four sigmas, because delays have longer tails than the clock.
    """
    best_likelihood, walk, autocorrelation = -np.inf, float(WALK_CANDIDATES[0]), 0.0
    for candidate in WALK_CANDIDATES.tolist():
        _, error, variance = _kalman_filter(windows, candidate, used)
        innovations = np.flatnonzero(np.isfinite(error))[2:]
        z = np.clip(error[innovations] / np.sqrt(variance[innovations]), -4.0, 4.0)
        likelihood = -0.5 * float(np.sum(z**2 + np.log(variance[innovations])))
        if likelihood > best_likelihood:
            best_likelihood = likelihood
            walk = candidate
            autocorrelation = excess_autocorrelation(z)
    return walk, autocorrelation


def excess_autocorrelation(z: FloatArray) -> float:
    """Return the sum of squared autocorrelations minus its expectation for white noise."""
    z = z - np.mean(z)
    power = float(np.sum(z * z))
    if power <= 0.0 or z.size < 2 * _LAGS:
        return 0.0
    rho = np.array([float(np.sum(z[lag:] * z[:-lag])) / power for lag in range(1, _LAGS + 1)])
    return max(0.0, float(np.sum(rho**2)) - 2.5 * _LAGS / z.size)
