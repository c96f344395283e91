"""The density of measured rates under the prediction of a simulation.

The prediction of one draw is its noise-free rate f. The measured rate is

    y = f + sum_k d_k df/ds_k + b + noise

with unknown errors d_k of the start of each move and an unknown offset b of the bias since the
simulation's power-up. Both are Gaussian: d_k with the uncertainty of the position replies, b with
the scatter of the simulated sessions. They are integrated out. The noise has the density of the
simulation's noise, which is estimated from simulated minus noise-free rates. In the DCT it is
diagonal, see `estimate.noise.noise_model`. The unknowns add a matrix of low rank.

The predictive density is the mean over the draws: log p(y) = log mean exp(log p(y | draw)).

What to use when: `estimate_noise` for the noise of a simulation, `RateDensity` for a recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct
from scipy.linalg import cho_factor, cho_solve

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import (
    NoiseModel,
    Periodogram,
    Sampling,
    bin_spectrum,
    fit_noise_levels,
)
from gyrorig_solver.twin_check.observed_session import ObservedSession
from gyrorig_solver.twin_check.predicted_rates import SimulatedRates

MIN_START_STD_S = 5e-6  # the poll fit states the scatter of the replies only
OFFSETS = 3  # the last unknowns, one per axis
FREE_OFFSET_FACTOR = 30.0  # of their standard deviation, if they are removed instead of predicted


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedNoise:
    """The noise of a simulation."""

    model: NoiseModel
    bias_std_rad_s: FloatArray  # (3,), scatter of a session's mean


def estimate_noise(noises: Sequence[FloatArray], sampling: Sampling) -> SimulatedNoise:
    """Return the noise of a simulation from pure noise of several sessions, (n, 3) each."""
    pieces = [Periodogram.of(noise, sampling.rate_hz) for noise in noises]
    model = fit_noise_levels(bin_spectrum(pieces), sampling)
    means = np.stack([noise.mean(axis=0) for noise in noises])
    return SimulatedNoise(model, np.sqrt((means**2).mean(axis=0)))


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
        n = session.block_count
        self._variance = noise.model.dct_variance(n).T  # (3, n)
        columns, std = _unknowns(session, nearest, noise)
        self._columns = columns
        self._std = std
        whitened = dct(columns, axis=-1, norm="ortho") / np.sqrt(self._variance)
        self._whitened = whitened.reshape(len(columns), -1)
        scaled = self._whitened * std[:, None]
        self._factor = cho_factor(np.eye(len(std)) + scaled @ scaled.T)
        used_share = float(session.used.mean())
        self._constant = -0.5 * used_share * float(np.log(2.0 * np.pi * self._variance).sum())
        self._constant -= float(np.log(np.diag(self._factor[0])).sum())

    def log_density(self, predicted_rad_s: FloatArray) -> float:
        """Return the log density of the measured rates, nats.

        Args:
            predicted_rad_s: block means, shape (n, 3).
        """
        white = self._whiten(self._residual(predicted_rad_s))
        score = self._std * (self._whitened @ white)
        explained = float(score @ cho_solve(self._factor, score))
        return self._constant - 0.5 * (float(white @ white) - explained)

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
        scaled = self._whitened * std[:, None]
        score = scaled @ self._whiten(residual)
        solved = np.linalg.solve(np.eye(len(std)) + scaled @ scaled.T, score)
        return np.asarray(std * solved, dtype=np.float64)

    def white_spectrum(self, residual: FloatArray) -> FloatArray:
        """Return the DCT of a residual (n, 3) in units of its standard deviation, (3, n)."""
        return self._whiten(residual).reshape(3, -1)

    def white_column(self, signal: FloatArray, axis: int) -> FloatArray:
        """Return the DCT of a signal of one axis (n,) in units of the noise, (n,)."""
        spectrum = dct(signal, norm="ortho") / np.sqrt(self._variance[axis])
        return np.asarray(spectrum, dtype=np.float64)

    def _residual(self, predicted_rad_s: FloatArray) -> FloatArray:
        residual = self._session.rate_rad_s - predicted_rad_s
        return np.where(self._session.used[:, None], residual, 0.0)

    def _whiten(self, residual: FloatArray) -> FloatArray:
        spectrum = dct(residual.T, axis=-1, norm="ortho") / np.sqrt(self._variance)
        return np.asarray(spectrum.reshape(-1), dtype=np.float64)


def noise_log_density(noise_rad_s: FloatArray, noise: SimulatedNoise) -> float:
    """Return the log density of pure noise (n, 3) under the model of this noise, nats."""
    variance = noise.model.dct_variance(noise_rad_s.shape[0])
    variance[0] += noise.bias_std_rad_s**2 * noise_rad_s.shape[0]
    spectrum = dct(noise_rad_s, axis=0, norm="ortho")
    return -0.5 * float((np.log(2.0 * np.pi * variance) + spectrum**2 / variance).sum())


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
    for axis in range(3):
        constant = np.zeros((3, session.block_count))
        constant[axis] = 1.0
        columns.append(constant)
        std.append(float(noise.bias_std_rad_s[axis]))
    return np.stack(columns), np.array(std)
