"""Saw-tooth of a clock that drifts and is corrected at regular intervals, from the lag over time.

What to use when: `fit_sawtooth` for the period and the phase that fit the errors of the time offset
in windows best, in addition to other functions of time.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray

MAX_TEETH = 20.0  # in a recording
MIN_TEETH = 1.0  # with fewer, a line with a step is as good
MIN_CORRECTIONS = 2  # in a recording
MIN_WINDOWS_PER_TOOTH = 4.0
TEETH_STEP = 0.1  # of the search: a correction is wrong by a tenth of a period
PHASES = 16
REFINEMENTS, STEPS_PER_SIDE = 5, 4
MIN_REMAINING = 1e-3  # of the energy, after the other functions are removed


@dataclass(frozen=True, slots=True)
class Sawtooth:
    """The times of a clock's corrections; between them, the error is a line."""

    period_s: float
    correction_s: float  # the time of one correction

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the error per unit of the rate of the clock, s, (n,)."""
        turns = (time_s - self.correction_s) / self.period_s
        return np.asarray(self.period_s * (turns - np.floor(turns) - 0.5), dtype=np.float64)

    def corrections_s(self, begin_s: float, end_s: float) -> tuple[float, ...]:
        """Return the times of all corrections in an interval."""
        first = np.ceil((begin_s - self.correction_s) / self.period_s)
        last = np.floor((end_s - self.correction_s) / self.period_s)
        return tuple((self.correction_s + self.period_s * np.arange(first, last + 1)).tolist())


@dataclass(frozen=True, slots=True, eq=False)
class WindowLags:
    """Errors of the time offset in windows of equal length."""

    time_s: FloatArray  # (n,), the middle of each window, increasing
    lag_s: FloatArray  # (n,)
    information: FloatArray  # (n,), 1/s^2
    window_s: float

    def sawtooth_means(self, sawtooth: Sawtooth) -> FloatArray:
        """Return the means of a saw-tooth over the windows, (n,)."""
        means = self.means_of_period(sawtooth.period_s, np.array([sawtooth.correction_s]))
        return np.asarray(means[0], dtype=np.float64)

    def means_of_period(self, period_s: float, times_s: FloatArray) -> FloatArray:
        """Return the means over the windows of saw-teeth of one period, (p, n)."""
        half_turns = 0.5 * self.window_s / period_s
        turns = (self.time_s - times_s[:, None]) / period_s
        before, after = _integral(turns - half_turns), _integral(turns + half_turns)
        mean = (after - before) / (2.0 * half_turns)
        return np.asarray(period_s * (mean - 0.5), dtype=np.float64)

    def fit_sawtooth(self, basis: FloatArray) -> Sawtooth | None:
        """Return the best-fitting saw-tooth in addition to other functions; None with few windows.

        Args:
            basis: the other functions, whose sizes are free, shape (n, k).
        """
        length_s = float(self.time_s[-1] - self.time_s[0])
        most = min(MAX_TEETH, length_s / (MIN_WINDOWS_PER_TOOTH * self.window_s))
        search = _SawtoothSearch(self, basis)
        middle_s = float(self.time_s[0]) + 0.5 * length_s
        for teeth in np.arange(MIN_TEETH, most, TEETH_STEP):
            period_s = length_s / float(teeth)
            # The correction nearest to the middle; its time hardly depends on the period.
            search.try_times(period_s, middle_s + period_s * (np.arange(PHASES) / PHASES - 0.5))
        teeth_step, phase_step = TEETH_STEP, 1.0 / PHASES
        sides = np.arange(-STEPS_PER_SIDE, STEPS_PER_SIDE + 1) / STEPS_PER_SIDE
        for _ in range(REFINEMENTS):
            if (centre := search.best) is None:
                return None
            for teeth in length_s / centre.period_s + teeth_step * sides:
                period_s = length_s / float(teeth)
                search.try_times(period_s, centre.correction_s + phase_step * period_s * sides)
            teeth_step, phase_step = teeth_step / STEPS_PER_SIDE, phase_step / STEPS_PER_SIDE
        return search.best


class _SawtoothSearch:
    """The best saw-tooth so far, in addition to other functions with free sizes."""

    def __init__(self, lags: WindowLags, basis: FloatArray) -> None:
        """Start without a saw-tooth; `basis`: the other functions, (n, k)."""
        self.best: Sawtooth | None = None
        self._gain, self._lags = 0.0, lags
        root = np.sqrt(lags.information)
        # Orthonormal functions in the metric of the information.
        self._root, self._others = root, np.linalg.qr(root[:, None] * basis)[0]
        whitened = root * lags.lag_s
        self._residual = whitened - self._others @ (self._others.T @ whitened)

    def try_times(self, period_s: float, times_s: FloatArray) -> None:
        """Compare saw-teeth of one period, with corrections at some times (p,), with the best."""
        shapes = self._lags.means_of_period(period_s, times_s) * self._root
        energy = np.einsum("pn,pn->p", shapes, shapes)
        remaining = energy - np.sum((shapes @ self._others) ** 2, axis=1)
        first_s, last_s = self._lags.time_s[0], self._lags.time_s[-1]
        corrections = np.floor((last_s - times_s) / period_s) - np.floor(
            (first_s - times_s) / period_s
        )
        is_seen = (remaining > MIN_REMAINING * energy) & (corrections >= MIN_CORRECTIONS)
        gains = np.where(is_seen, (shapes @ self._residual) ** 2, 0.0)
        gains /= np.where(is_seen, remaining, 1.0)
        k = int(np.argmax(gains))
        if gains[k] > self._gain:
            self._gain, self.best = float(gains[k]), Sawtooth(period_s, float(times_s[k]))


def _integral(turns: FloatArray) -> FloatArray:
    """Return the integral of the fraction of a turn, from zero."""
    whole = np.floor(turns)
    return np.asarray(0.5 * (whole + (turns - whole) ** 2), dtype=np.float64)
