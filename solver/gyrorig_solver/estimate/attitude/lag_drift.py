"""The drift between the clock of the reference attitudes and that of the gyro.

A clock that is fast or slow, or that is corrected at times, changes the time offset during the
recording. The residual of a fit with one time offset shows it: the residual of each second,
compared with the change of the rate, gives the error of the time offset in that second. Two models
are fitted to these errors and compared. The first is a line (skew) with steps. The second is a line
with a saw-tooth: equal steps at regular intervals, of a clock that drifts and is corrected.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.attitude.attitude_solver import AttitudeSolver, inverse_band_dct
from gyrorig_solver.estimate.attitude.lag_sawtooth import Sawtooth, WindowLags
from gyrorig_solver.estimate.attitude.linearised_model import MIN_SLOPE_SHARE

WINDOW_S = 1.0  # of one value of the time offset
# Gains in chi-square. For the slope, 12 has a probability of 1 in 2000 by chance. A step is
# searched for in every window, and so needs a larger gain.
MIN_SKEW_GAIN = 12.0
MIN_STEP_GAIN = 30.0
# A saw-tooth has two values more than a step, which are searched for in 10 000 pairs.
MIN_SAWTOOTH_GAIN = 40.0
MAX_STEPS = 24
MIN_WINDOWS_PER_STEP = 4  # of motion, on both sides


@dataclass(frozen=True, slots=True, eq=False)
class LagDrift:
    """The error of the reference's times: a line with steps, and possibly a saw-tooth."""

    skew: float  # s/s
    step_time_s: tuple[float, ...]
    step_s: tuple[float, ...]
    middle_s: float
    sawtooth: Sawtooth | None = None
    sawtooth_rate: float = 0.0  # s/s, between two corrections

    @property
    def is_none(self) -> bool:
        """True if the clocks do not drift."""
        return self.skew == 0.0 and not self.step_time_s and self.sawtooth is None

    @property
    def step_std_s(self) -> float:
        """The uncertainty of the time offset from steps of the clocks, s."""
        tooth_s = 0.0 if self.sawtooth is None else self.sawtooth_rate * self.sawtooth.period_s
        return float(np.linalg.norm([*self.step_s, tooth_s])) / 2.0

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the correction of times, s, (n,); its mean over the times is not zero."""
        correction_s = self.skew * (time_s - self.middle_s)
        if self.sawtooth is not None:
            correction_s = correction_s + self.sawtooth_rate * self.sawtooth.at(time_s)
        for at_s, size_s in zip(self.step_time_s, self.step_s, strict=True):
            correction_s = correction_s + size_s * (time_s >= at_s)
        return np.asarray(correction_s, dtype=np.float64)

    def cuts(self, time_s: FloatArray) -> BoolArray:
        """Return after which times a step follows, (n,)."""
        steps_s = list(self.step_time_s)
        if self.sawtooth is not None and time_s.size:
            steps_s += self.sawtooth.corrections_s(float(time_s[0]), float(time_s[-1]))
        is_cut = np.zeros(time_s.size, dtype=np.bool_)
        for at_s in steps_s:
            before = int(np.searchsorted(time_s, at_s)) - 1
            if 0 <= before < time_s.size:
                is_cut[before] = True
        return is_cut


@dataclass(frozen=True, slots=True, eq=False)
class _StepModel:
    """A line with steps in addition to given functions, fitted to the lags of windows."""

    basis: FloatArray  # (n, 2 + j + s): constant, line, j given functions, s steps
    step_windows: tuple[int, ...]  # the first window after each step
    residual_s: FloatArray  # (n,)
    dispersion: float

    def cost(self, lags: WindowLags, dispersion: float) -> float:
        """Return the chi-square, with the gain that each step must have."""
        chi2 = float(lags.information @ self.residual_s**2)
        return chi2 / dispersion + MIN_STEP_GAIN * len(self.step_windows)


def estimate_drift(solver: AttitudeSolver) -> LagDrift:
    """Return the drift that the residual of a converged fit shows."""
    time_s, lag_s, information = _window_lags(solver)
    order = np.argsort(time_s)
    return fit_drift(time_s[order], lag_s[order], information[order])


def fit_drift(time_s: FloatArray, lag_s: FloatArray, information: FloatArray) -> LagDrift:
    """Return the line with steps, or with a saw-tooth, through errors of the time offset.

    Args:
        time_s: of each window, increasing, shape (n,).
        lag_s: error of each window, shape (n,).
        information: of each window, 1/s^2, shape (n,).
    """
    if not time_s.size:
        return LagDrift(0.0, (), (), 0.0)
    moving = information > 1e-3 * float(np.median(information))
    lags = WindowLags(time_s[moving], lag_s[moving], information[moving], WINDOW_S)
    middle_s = float(lags.information @ lags.time_s / max(lags.information.sum(), 1e-30))
    if lags.time_s.size < 2 * MIN_WINDOWS_PER_STEP:
        return LagDrift(0.0, (), (), middle_s)
    line = np.stack([np.ones(lags.time_s.size), lags.time_s - middle_s], axis=1)
    best = without = _fit_steps(lags, line)
    best_sawtooth: Sawtooth | None = None
    # The largest step can be in addition to the saw-tooth, or one of its corrections.
    for count in range(1 + min(len(without.step_windows), 1)):
        sawtooth = lags.fit_sawtooth(without.basis[:, : 2 + count])
        if sawtooth is None:
            continue
        model = _fit_steps(lags, np.column_stack([line, lags.sawtooth_means(sawtooth)]))
        dispersion = min(best.dispersion, model.dispersion)
        needed = best.cost(lags, dispersion) + MIN_SAWTOOTH_GAIN * (best_sawtooth is not None)
        if model.cost(lags, dispersion) + MIN_SAWTOOTH_GAIN < needed:
            best, best_sawtooth = model, sawtooth
    return _drift_of(lags, best, middle_s, best_sawtooth)


def _fit_steps(lags: WindowLags, basis: FloatArray) -> _StepModel:
    """Return the given functions with all significant steps, which are added in sequence."""
    root = np.sqrt(lags.information)
    steps: list[int] = []
    while True:
        residual_s = lags.lag_s - basis @ _weighted_fit(basis, lags.lag_s, root)
        dispersion = _dispersion(residual_s, root)
        gain, at = _best_step(basis, residual_s, root)
        if gain < MIN_STEP_GAIN * dispersion or len(steps) == MAX_STEPS:
            return _StepModel(basis, tuple(steps), residual_s, dispersion)
        steps.append(at)
        basis = np.column_stack([basis, np.arange(lags.time_s.size) >= at])


def _drift_of(
    lags: WindowLags, model: _StepModel, middle_s: float, sawtooth: Sawtooth | None = None
) -> LagDrift:
    """Return the drift of a fitted model, without a slope that is not significant."""
    root = np.sqrt(lags.information)
    values = _weighted_fit(model.basis, lags.lag_s, root)
    without = np.delete(model.basis, 1, axis=1)
    flat_s = lags.lag_s - without @ _weighted_fit(without, lags.lag_s, root)
    skew_gain = float(lags.information @ (flat_s**2 - model.residual_s**2))
    if skew_gain < MIN_SKEW_GAIN * model.dispersion:
        values = np.insert(_weighted_fit(without, lags.lag_s, root), 1, 0.0)
    first = model.basis.shape[1] - len(model.step_windows)
    order = np.argsort(model.step_windows, kind="stable").tolist()
    windows = [model.step_windows[k] for k in order]
    return LagDrift(
        float(values[1]),
        tuple(float(0.5 * (lags.time_s[k - 1] + lags.time_s[k])) for k in windows),
        tuple(float(values[first + k]) for k in order),
        middle_s,
        sawtooth,
        0.0 if sawtooth is None else float(values[2]),
    )


def _window_lags(solver: AttitudeSolver) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return time, error of the time offset, and its information, of each window with motion.

    The slope of the gyro's noise adds to the power of the slope. This share says nothing about the
    time offset. In a window with motion, it is small.
    """
    linearised = solver.linearise()
    root = np.sqrt(linearised.variance)
    times, scores, informations, noises, first = [], [], [], [], 0
    for segment, in_band in zip(solver.segments, solver.in_band, strict=True):
        count, coefficients = segment.track.begin_s.size, int(in_band.sum())
        part = slice(first, first + coefficients)
        first += coefficients
        residual = inverse_band_dct(linearised.residual[part] / root[part], count)
        column = inverse_band_dct(linearised.jacobian[part, :, 12] / root[part], count)
        noise = float(np.sum(linearised.slope_noise[part] / linearised.variance[part])) / count
        width = max(1, round(WINDOW_S / segment.track.step_s))
        starts = np.arange(0, max(count - width // 2, 1), width)
        edge_s = segment.track.edge_s
        ends = np.append(starts[1:], count)
        times.append((edge_s[starts] + edge_s[ends]) / 2.0)
        scores.append(np.add.reduceat(np.sum(column * residual, axis=1), starts))
        informations.append(np.add.reduceat(np.sum(column**2, axis=1), starts))
        noises.append(noise * np.diff(np.append(starts, count)))
    score, total = np.concatenate(scores), np.concatenate(informations)
    signal = total - np.concatenate(noises)
    moving = signal > MIN_SLOPE_SHARE * total
    # The variance of the score is `total`, and its derivative by the time offset is `signal`.
    lag_s = score[moving] / signal[moving]
    return np.concatenate(times)[moving], lag_s, signal[moving] ** 2 / total[moving]


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
    # Sums from each window to the last one.
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
