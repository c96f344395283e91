"""The drift between the clock of the reference attitudes and that of the gyro.

A clock that is fast or slow, or that is set now and then, changes the time offset during the
recording. The residual of a fit with one time offset shows it: the residual of each second,
compared with the change of the rate, gives the error of the time offset in that second. A line
(skew) with steps is fitted to these errors.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.attitude.attitude_solver import AttitudeSolver, inverse_band_dct

WINDOW_S = 1.0  # of one value of the time offset
# Gains in chi-square: 12 for the slope is 1 in 2000 by chance. A step is looked for in every
# window, and so needs more.
MIN_SKEW_GAIN = 12.0
MIN_STEP_GAIN = 30.0
MAX_STEPS = 24
MIN_WINDOWS_PER_STEP = 4  # of motion, on both sides


@dataclass(frozen=True, slots=True, eq=False)
class LagDrift:
    """The error of the reference's times: a line with steps."""

    skew: float  # s/s
    step_time_s: tuple[float, ...]
    step_s: tuple[float, ...]
    middle_s: float

    @property
    def is_none(self) -> bool:
        """True without skew and without steps."""
        return self.skew == 0.0 and not self.step_time_s

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the correction of times, s, (n,); its mean over the times is not zero."""
        correction_s = self.skew * (time_s - self.middle_s)
        for at_s, size_s in zip(self.step_time_s, self.step_s, strict=True):
            correction_s = correction_s + size_s * (time_s >= at_s)
        return np.asarray(correction_s, dtype=np.float64)

    def cuts(self, time_s: FloatArray) -> BoolArray:
        """Return after which of the times a step follows, (n,)."""
        is_cut = np.zeros(time_s.size, dtype=np.bool_)
        for at_s in self.step_time_s:
            before = int(np.searchsorted(time_s, at_s)) - 1
            if 0 <= before < time_s.size:
                is_cut[before] = True
        return is_cut


def estimate_drift(solver: AttitudeSolver) -> LagDrift:
    """Return the drift that the residual of a converged fit shows."""
    time_s, lag_s, information = _window_lags(solver)
    order = np.argsort(time_s)
    return fit_drift(time_s[order], lag_s[order], information[order])


def fit_drift(time_s: FloatArray, lag_s: FloatArray, information: FloatArray) -> LagDrift:
    """Return the line with steps through errors of the time offset.

    Args:
        time_s: of each window, increasing, shape (n,).
        lag_s: error of each window, shape (n,).
        information: of each window, 1/s^2, shape (n,).
    """
    moving = information > 1e-3 * float(np.median(information))
    time_s, lag_s, information = time_s[moving], lag_s[moving], information[moving]
    middle_s = float(information @ time_s / max(information.sum(), 1e-30))
    if time_s.size < 2 * MIN_WINDOWS_PER_STEP:
        return LagDrift(0.0, (), (), middle_s)
    root = np.sqrt(information)
    basis = np.stack([np.ones(time_s.size), time_s - middle_s], axis=1)
    steps: list[int] = []
    while len(steps) < MAX_STEPS:
        residual = lag_s - basis @ _weighted_fit(basis, lag_s, root)
        gain, at = _best_step(basis, residual, root)
        if gain < MIN_STEP_GAIN * _dispersion(residual, root):
            break
        steps.append(at)
        basis = np.column_stack([basis, np.arange(time_s.size) >= at])
    values = _weighted_fit(basis, lag_s, root)
    residual = lag_s - basis @ values
    without = np.delete(basis, 1, axis=1)
    rest = lag_s - without @ _weighted_fit(without, lag_s, root)
    skew_gain = float(np.sum((root * rest) ** 2) - np.sum((root * residual) ** 2))
    if skew_gain < MIN_SKEW_GAIN * _dispersion(residual, root):
        values = np.insert(_weighted_fit(without, lag_s, root), 1, 0.0)
    step_time_s = tuple(float(0.5 * (time_s[k - 1] + time_s[k])) for k in sorted(steps))
    sizes = [float(values[2 + k]) for k in np.argsort(steps, kind="stable")]
    return LagDrift(float(values[1]), step_time_s, tuple(sizes), middle_s)


def _window_lags(solver: AttitudeSolver) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return time, error of the time offset, and its information, of each window."""
    linearised = solver.linearise()
    root = np.sqrt(linearised.variance)
    times, scores, informations, first = [], [], [], 0
    for segment, in_band in zip(solver.segments, solver.in_band, strict=True):
        count, coefficients = segment.track.begin_s.size, int(in_band.sum())
        part = slice(first, first + coefficients)
        first += coefficients
        residual = inverse_band_dct(linearised.residual[part] / root[part], count)
        column = inverse_band_dct(linearised.jacobian[part, :, 12] / root[part], count)
        width = max(1, round(WINDOW_S / segment.track.step_s))
        starts = np.arange(0, max(count - width // 2, 1), width)
        edge_s = segment.track.edge_s
        ends = np.append(starts[1:], count)
        times.append((edge_s[starts] + edge_s[ends]) / 2.0)
        scores.append(np.add.reduceat(np.sum(column * residual, axis=1), starts))
        informations.append(np.add.reduceat(np.sum(column**2, axis=1), starts))
    information = np.maximum(np.concatenate(informations), 1e-30)
    return np.concatenate(times), np.concatenate(scores) / information, information


def _weighted_fit(basis: FloatArray, values: FloatArray, root: FloatArray) -> FloatArray:
    return np.asarray(
        np.linalg.lstsq(basis * root[:, None], values * root, rcond=None)[0], dtype=np.float64
    )


def _dispersion(residual: FloatArray, root: FloatArray) -> float:
    """Return the variance of the residual relative to its information, at least 1."""
    scaled = residual * root
    return max(1.0, float((1.4826 * np.median(np.abs(scaled - np.median(scaled)))) ** 2))


def _best_step(basis: FloatArray, residual: FloatArray, root: FloatArray) -> tuple[float, int]:
    """Return the largest gain of one more step, and the first window after it."""
    weight = root**2
    # Sums over all windows from each one on.
    score = np.cumsum((weight * residual)[::-1])[::-1]
    power = np.cumsum(weight[::-1])[::-1]
    cross = np.cumsum((weight[:, None] * basis)[::-1], axis=0)[::-1]
    gram = np.linalg.pinv(basis.T @ (weight[:, None] * basis))
    remaining = power - np.einsum("ni,ij,nj->n", cross, gram, cross)
    allowed = np.zeros(residual.size, dtype=np.bool_)
    allowed[MIN_WINDOWS_PER_STEP : residual.size - MIN_WINDOWS_PER_STEP] = True
    allowed &= remaining > 1e-3 * power
    if not allowed.any():
        return 0.0, 0
    gains = np.where(allowed, score**2 / np.maximum(remaining, 1e-30), 0.0)
    at = int(np.argmax(gains))
    return float(gains[at]), at
