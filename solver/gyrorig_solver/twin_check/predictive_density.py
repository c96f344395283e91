"""The density of measured rates under the prediction of a simulation.

The prediction of one draw is its noise-free rate f. The measured rate is

    y = f + sum_k d_k df/ds_k + b + noise

with unknown errors d_k of the start of each move and an unknown offset b of the bias since the
simulation's power-up. Both are Gaussian: d_k with the uncertainty of the position replies, b with
the scatter of the simulated sessions. They are integrated out. The noise has the density of the
simulation's noise, which is estimated from simulated minus noise-free rates. In the DCT it is
diagonal, see `estimate.noise.noise_model`; `received_noise` has the missing blocks. The unknowns
add a matrix of low rank.

The predictive density is the mean over the draws: log p(y) = log mean exp(log p(y | draw)).

What to use when: `RateDensity` for a recording.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.twin_check.observed_session import ObservedSession
from gyrorig_solver.twin_check.predicted_rates import SimulatedRates
from gyrorig_solver.twin_check.received_noise import (
    ReceivedDensity,
    ReceivedNoise,
    SimulatedNoise,
    constant_signals,
)

MIN_START_STD_S = 5e-6  # the poll fit states the scatter of the replies only
OFFSETS = 3  # the last unknowns, one per axis
FREE_OFFSET_FACTOR = 30.0  # of their standard deviation, if they are removed instead of predicted


class RateDensity:
    """The density of the rates of one recording under predictions."""

    def __init__(
        self, session: ObservedSession, nearest: SimulatedRates, noise: SimulatedNoise
    ) -> None:
        """Prepare the unknowns.

        Args:
            session: with the measured rates.
            nearest: a simulation, for the derivatives by the starts.
            noise: of the simulation.
        """
        self._session = session
        self._noise = ReceivedNoise.of(noise, session.block_samples)
        self._columns, self._std = _unknowns(session, nearest, noise)
        self._density = ReceivedDensity.of(self._noise, self._columns, self._std)

    @property
    def mean_log_density(self) -> float:
        """The mean of the log density over the noise and the unknowns, nats."""
        return self._density.mean

    def excess(self, predicted_rad_s: FloatArray) -> float:
        """Return the log density of the measured rates minus its mean, nats.

        Recordings with different missing samples have different means.

        Args:
            predicted_rad_s: block means, shape (n, 3).
        """
        return self._density.excess(self._residual(predicted_rad_s).T)

    def residual(self, predicted_rad_s: FloatArray) -> FloatArray:
        """Return measured minus predicted rates without the fitted unknowns, shape (n, 3).

        The offsets are removed regardless of their size. `offsets_rad_s` returns them.
        """
        residual = self._residual(predicted_rad_s)
        fitted = np.tensordot(self._fit_unknowns(residual), self._columns, axes=1).T
        return np.where(self._session.used[:, None], residual - fitted, 0.0)

    def offsets_rad_s(self, predicted_rad_s: FloatArray) -> FloatArray:
        """Return the fitted mean of measured minus predicted rates, shape (3,)."""
        return self._fit_unknowns(self._residual(predicted_rad_s))[-OFFSETS:]

    def _fit_unknowns(self, residual: FloatArray) -> FloatArray:
        """Return the unknowns of a residual (n, 3), with nearly free offsets, shape (j,)."""
        std = self._std.copy()
        std[-OFFSETS:] *= FREE_OFFSET_FACTOR
        scaled = self._density.whitened * std[:, None]
        score = scaled @ self._whiten(residual)
        solved = np.linalg.solve(np.eye(len(std)) + scaled @ scaled.T, score)
        return np.asarray(std * solved, dtype=np.float64)

    def white_spectrum(self, residual: FloatArray) -> FloatArray:
        """Return the DCT of a residual (n, 3) in units of its standard deviation, (3, n)."""
        return self._whiten(residual).reshape(3, -1)

    def white_column(self, signal: FloatArray, axis: int) -> FloatArray:
        """Return the DCT of a signal of one axis (n,) in units of the noise, (n,)."""
        spectrum = self._noise.spectrum(signal) / np.sqrt(self._noise.variance[axis])
        return np.asarray(spectrum, dtype=np.float64)

    def completed(self, residual: FloatArray) -> FloatArray:
        """Return a residual (n, 3) with the spectrum that it would have with all samples."""
        return self._noise.completed(residual)

    def _residual(self, predicted_rad_s: FloatArray) -> FloatArray:
        residual = self._session.rate_rad_s - predicted_rad_s
        return np.where(self._session.used[:, None], residual, 0.0)

    def _whiten(self, residual: FloatArray) -> FloatArray:
        return self._noise.whiten(residual.T).reshape(-1)


def log_mean_exp(values: FloatArray) -> float:
    """Return log(mean(exp(values)))."""
    largest = float(np.max(values))
    return largest + float(np.log(np.mean(np.exp(values - largest))))


def _unknowns(
    session: ObservedSession, nearest: SimulatedRates, noise: SimulatedNoise
) -> tuple[FloatArray, FloatArray]:
    """Return the signals of the unknowns, shape (j, 3, n), and their standard deviations (j,)."""
    starts = nearest.start_derivatives(session)
    start_std = np.concatenate([moves.start_std_s for moves in session.moves])
    columns = [column.T for _, column in starts]
    std = np.maximum(start_std, MIN_START_STD_S).tolist()
    if columns:
        columns.append(np.sum(columns, axis=0))
        std.append(max(session.reference.common_shift_std_s, MIN_START_STD_S))
    columns += list(constant_signals(session.used))
    std += noise.bias_std_rad_s.tolist()
    return np.stack(columns), np.array(std)
