"""How visible a hidden effect is: its energy against the true noise, less what is absorbed.

With d the noise-free difference that the hidden causes make, W the whitening by the true
noise and P the projection off what a calibration estimates anyway (gain, bias, time offset,
the delay of each move), the non-centrality is lambda = |P W d|^2: the expected excess of the
log-likelihood ratio, twice. An effect at lambda = (z_a + z_p)^2 is found with the power p at
the false alarm rate a (Baarda's minimal detectable bias). Energy goes with size squared, so
one run tells the size for any lambda as long as the effect is proportional to it.

Whitening is done in the space of the cosine transform, where stationary noise and a random
walk are nearly independent from one coefficient to the next. One-sided densities in front of
the samples: white N^2 |H|^2 with the low-pass H folded by the sampling, flicker B^2 / (pi f),
walk K^2 / (2 pi^2 f^2), rounding q^2 / (6 fs); a coefficient has the variance S(f) fs / 2.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.noise_free_rates import NoiseFreeRates

FloatArray = NDArray[np.float64]

_ALIAS_IMAGES = 40  # images of the spectrum; the low-pass leaves nothing beyond
_RANK_TOLERANCE = 1e-9  # a combination of base shapes weaker than this is rounding


@dataclass(frozen=True, slots=True)
class Visibility:
    """How much of an effect can be seen."""

    noncentrality: float  # after what the base parameters absorb
    absorbed: float  # share of the whitened energy that they absorb, 0 to 1


def detectable_noncentrality(alpha: float = 0.01, tests: int = 36, power: float = 0.8) -> float:
    """Return the non-centrality that one of `tests` two-sided tests finds with a power.

    Args:
        alpha: false alarm rate of all tests together.
        tests: how many there are.
        power: wanted probability of detection.
    """
    normal = NormalDist()
    return (normal.inv_cdf(1.0 - 0.5 * alpha / tests) + normal.inv_cdf(power)) ** 2


def visibility(
    rates: NoiseFreeRates,
    board: Mapping[str, Any],
    moves_s: Sequence[tuple[str, float]],
    span_s: tuple[float, float],
    start_delays: bool = True,
) -> Visibility:
    """Return how visible the difference in a board's rates is.

    Args:
        rates: of the board, with and without what is hidden.
        board: its truth document.
        moves_s: axis and begin of each move, since power-up.
        span_s: what part of the time is recorded, since power-up.
        start_delays: whether a delay of each move is estimated, besides the common one.
    """
    return NuisanceProjector(rates, board, moves_s, span_s, start_delays).visibility(rates)


class NuisanceProjector:
    """What of a signal is left beside all that a calibration estimates, in units of noise."""

    def __init__(
        self,
        rates: NoiseFreeRates,
        board: Mapping[str, Any],
        moves_s: Sequence[tuple[str, float]],
        span_s: tuple[float, float],
        start_delays: bool = True,
    ) -> None:
        """Span the space around a board's aligned rates; arguments as of `visibility`."""
        self.inside = (rates.time_s >= span_s[0]) & (rates.time_s <= span_s[1])
        self.time_s = rates.time_s[self.inside]
        self.variances = coefficient_variances(board, len(self.time_s))
        plain = rates.aligned_rad_s[self.inside]
        gain, bias = np.array(board["STM"]), np.array(board["bias_rad_s"])
        stage = (plain - bias) @ np.linalg.inv(gain).T
        nuisance_signals = [np.outer(stage[:, k], unit) for unit in np.eye(3) for k in range(3)]
        slope = rates.slope_rad_s2[self.inside] @ np.linalg.inv(gain).T
        axis_slopes = {
            "tilt": np.outer(slope[:, 0], gain[:, 0]),
            "pan": slope[:, 1:] @ gain[:, 1:].T,
        }
        nuisance_signals.append(axis_slopes["tilt"] + axis_slopes["pan"])
        if start_delays:
            nuisance_signals += _move_delay_signals(self.time_s, axis_slopes, moves_s)
        basis = np.stack(
            [_whitened(shape, self.variances).ravel() for shape in nuisance_signals], axis=1
        )
        norms = np.linalg.norm(basis, axis=0)
        basis = basis[:, norms > 0.0] / norms[norms > 0.0]
        orthogonal, values, _ = np.linalg.svd(basis, full_matrices=False)
        self._nuisance_basis = orthogonal[:, values > _RANK_TOLERANCE * values.max(initial=0.0)]

    def project(self, rows: FloatArray) -> FloatArray:
        """Return what is left of a signal in rad/s inside the span, (n, 3), as (3 n - 3,)."""
        white = _whitened(rows, self.variances).ravel()
        return np.asarray(white - self._nuisance_basis @ (self._nuisance_basis.T @ white))

    def projected_effect(self, rates: NoiseFreeRates) -> FloatArray:
        """Return what is left of the difference that hidden causes make, (3 n - 3,)."""
        return self.project((rates.hidden_rad_s - rates.aligned_rad_s)[self.inside])

    def visibility(self, rates: NoiseFreeRates) -> Visibility:
        """Return how visible the difference is that hidden causes make."""
        whitened = _whitened((rates.hidden_rad_s - rates.plain_rad_s)[self.inside], self.variances)
        total_energy, projected = float((whitened**2).sum()), self.projected_effect(rates)
        noncentrality = float(projected @ projected)
        return Visibility(
            noncentrality, 1.0 - noncentrality / total_energy if total_energy > 0.0 else 0.0
        )


def coefficient_variances(board: Mapping[str, Any], count: int) -> FloatArray:
    """Return the noise variance of each cosine coefficient but the mean's, (count - 1, 3)."""
    odr_hz = float(board["odr_hz"])
    f = np.arange(1, count) * odr_hz / (2.0 * count)
    cutoff_hz = float(board["low_pass"]["cutoff_hz"])
    alias_hz = f[:, None] + odr_hz * np.arange(-_ALIAS_IMAGES, _ALIAS_IMAGES + 1)
    folded_response = (1.0 / (1.0 + (alias_hz / cutoff_hz) ** 4)).sum(axis=1)
    white, flicker, walk = (
        np.array(board[name]) ** 2
        for name in (
            "noise_density_rad_s_rthz",
            "bias_instability_rad_s",
            "rate_random_walk_rad_s_rts",
        )
    )
    density = np.outer(folded_response, white) + np.outer(1.0 / (math.pi * f), flicker)
    density += np.outer(1.0 / (2.0 * (math.pi * f) ** 2), walk)
    density += float(board["gyro_scale_rad_s"]) ** 2 / (6.0 * odr_hz)
    return np.asarray(0.5 * odr_hz * density)


def cosine_coefficients(rows: FloatArray) -> FloatArray:
    """Return the orthonormal cosine transform (type II) of each column, (n, k)."""
    n = len(rows)
    mirrored = np.concatenate([rows, rows[::-1]])
    spectrum = np.fft.rfft(mirrored, axis=0)[:n]
    rotated = spectrum * np.exp(-0.5j * math.pi * np.arange(n) / n)[:, None]
    coefficients = rotated.real / math.sqrt(2.0 * n)
    coefficients[0] /= math.sqrt(2.0)
    return np.asarray(coefficients)


def _whitened(rows: FloatArray, variances: FloatArray) -> FloatArray:
    """Without the mean, which a bias absorbs, (n - 1, 3)."""
    return np.asarray(cosine_coefficients(rows)[1:] / np.sqrt(variances))


def _move_delay_signals(
    time_s: FloatArray, axis_slopes: Mapping[str, FloatArray], moves_s: Sequence[tuple[str, float]]
) -> list[FloatArray]:
    """What a delay of each move would add: the axis' slope until its next move."""
    signals = []
    for axis, slope in axis_slopes.items():
        begins = sorted(begin_s for name, begin_s in moves_s if name == axis)
        for begin_s, end_s in pairwise([*begins, math.inf]):
            during = (time_s >= begin_s) & (time_s < end_s)
            if during.any():
                signals.append(slope * during[:, None])
    return signals
