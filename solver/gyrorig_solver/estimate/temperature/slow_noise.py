"""Least squares of bias windows with correlated noise: white, flicker and random walk.

The windows of a recording are transformed by an orthonormal DCT, in which flicker and random walk
are nearly uncorrelated (`estimate.noise.noise_model`). The levels of the noise are estimated from
the residual of each model. A random walk of the bias therefore competes with the model, and does
not look like a dependence on the temperature.

The constant is the mean of each recording. The bias also changes from one power-on to the next. If
there are several recordings, this change is estimated by restricted likelihood.

What to use when: `SlowFit.solve` for one design.

Source: Harville, Maximum likelihood approaches to variance component estimation, J. Am. Stat.
Assoc. 72 (1977) 320, for the restricted likelihood; the expected power of a residual is v (1 - h),
with the leverage h.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.noise.noise_levels import (
    PRIOR_LOG_STD,
    fit_noise_levels,
    nominal_levels,
)
from gyrorig_solver.estimate.noise.noise_model import (
    NoiseModel,
    Sampling,
    dct_frequencies_hz,
    unit_densities,
)
from gyrorig_solver.estimate.noise.residual_spectrum import Spectrum

NOISE_ITERATIONS = 8
LEVEL_TOLERANCE = 0.02  # relative change of the levels
# of a row; with a larger leverage, its residual has no information about the noise
MAX_LEVERAGE = 0.95
RUN_GRID_POINTS = 60  # number of standard deviations between recordings that are tried
RUN_RANGE = (1e-3, 1e1)  # of these standard deviations, relative to the scatter of the means
INTERCEPT_STD = 10.0  # rad/s, practically no prior of the constant


@dataclass(frozen=True, slots=True, eq=False)
class SlowData:
    """Windows of recordings, and single values, ready for least squares."""

    # (n - 1, 3), DCT coefficients of each recording, without the constant
    spectra: tuple[FloatArray, ...]
    means: FloatArray  # (g, 3), of recordings, then single values
    mean_variance: FloatArray  # (g, 3), known part: of single values; zero for recordings
    counts: tuple[int, ...]  # windows of each recording
    rate_hz: float

    @classmethod
    def of(
        cls,
        biases: Sequence[FloatArray],
        step_s: float,
        values: FloatArray,
        stds: FloatArray,
    ) -> "SlowData":
        """Transform biases (n, 3) of recordings; `values` and `stds`: single values, (m, 3)."""
        means = [bias.mean(axis=0) for bias in biases]
        variance = np.concatenate([np.zeros((len(means), 3)), stds**2])
        return cls(
            tuple(transform(bias) for bias in biases),
            np.concatenate([np.array(means).reshape(len(means), 3), values]),
            variance,
            tuple(bias.shape[0] for bias in biases),
            1.0 / step_s,
        )

    @property
    def sampling(self) -> Sampling:
        """The sampling of the windows."""
        return Sampling(self.rate_hz, 1, None, 0.0, False)

    @property
    def frequency_hz(self) -> FloatArray:
        """The frequencies of all rows of the recordings, shape (rows,)."""
        parts = [dct_frequencies_hz(count, self.rate_hz)[1:] for count in self.counts]
        return np.concatenate(parts) if parts else np.zeros(0)


def transform(columns: FloatArray) -> FloatArray:
    """Return the DCT of the columns of one recording without the constant, (n - 1, k)."""
    return np.asarray(dct(columns, axis=0, norm="ortho")[1:], dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class SlowDesign:
    """The design in the same rows as the data."""

    spectrum: FloatArray  # (rows, q)
    means: FloatArray  # (g, q)
    prior_std: FloatArray  # (q,)

    @classmethod
    def of(
        cls, columns: Sequence[FloatArray], single: FloatArray, prior_std: FloatArray
    ) -> "SlowDesign":
        """Transform columns (n, q) of each recording; `single`: of single values, (m, q)."""
        width = prior_std.size
        means = [column.mean(axis=0) for column in columns]
        return cls(
            np.concatenate([np.zeros((0, width)), *(transform(column) for column in columns)]),
            np.concatenate([np.array(means).reshape(len(means), width), single]),
            prior_std,
        )


@dataclass(frozen=True, slots=True, eq=False)
class SlowFit:
    """Sizes of a design with correlated noise, their covariance and the model's evidence.

    The last of the q + 1 sizes is the constant.
    """

    sizes: FloatArray  # (q + 1, 3)
    covariance: FloatArray  # (3, q + 1, q + 1)
    noise: NoiseModel | None  # None without recordings
    run_std: FloatArray  # (3,), of the bias from one recording to the next
    # (3,), nats of each axis, without the prior of the parameters that the caller profiles
    axis_evidence: FloatArray
    log_likelihood: float  # nats
    residual: FloatArray  # (rows, 3)
    variance: FloatArray  # (rows, 3)
    degrees: FloatArray  # (3,), effective degrees of freedom of the noise that limits the sizes

    @property
    def log_evidence(self) -> float:
        """The evidence of all axes, nats."""
        return float(self.axis_evidence.sum())

    @classmethod
    def solve(
        cls, data: SlowData, design: SlowDesign, start: NoiseModel | None = None
    ) -> "SlowFit":
        """Fit sizes and noise levels in turn."""
        rows = np.concatenate([np.zeros((0, 3)), *data.spectra])
        noise, residual = start, rows
        variance, leverage = np.ones_like(rows), np.zeros_like(rows)
        # Without recordings, the levels are not used.
        for iteration in range(NOISE_ITERATIONS if len(rows) else 0):
            if noise is None or iteration:
                previous = noise
                noise = _fit_levels(data, residual, leverage, noise)
                if previous is not None and _is_settled(previous, noise):
                    break
            variance = noise.density(data.frequency_hz) * (data.rate_hz / 2.0)
            residual, leverage = _regress(rows, design, variance)
        return _summarize(data, design, rows, variance, noise)


def _is_settled(before: NoiseModel, after: NoiseModel) -> bool:
    floor = 1e-12 * after.levels[:, :1]
    return bool(
        np.allclose(
            before.levels[:, :3] + floor,
            after.levels[:, :3] + floor,
            rtol=LEVEL_TOLERANCE,
            atol=0.0,
        )
    )


def _fit_levels(
    data: SlowData, residual: FloatArray, leverage: FloatArray, start: NoiseModel | None
) -> NoiseModel:
    free = np.maximum(1.0 - leverage, 1.0 - MAX_LEVERAGE)
    density = residual**2 * (2.0 / data.rate_hz) / free
    spectrum = Spectrum(data.frequency_hz, density, free.mean(axis=1))
    levels = None if start is None else start.levels
    return fit_noise_levels(spectrum, data.sampling, levels)


def _regress(
    rows: FloatArray, design: SlowDesign, variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the residual and the leverage of each row, from only the rows of recordings."""
    residual, leverage = np.empty_like(rows), np.zeros_like(rows)
    prior = np.diag(design.prior_std**-2.0)
    for axis in range(3):
        root = variance[:, axis] ** -0.5
        whitened = design.spectrum * root[:, None]
        covariance = np.linalg.inv(whitened.T @ whitened + prior)
        sizes = covariance @ (whitened.T @ (rows[:, axis] * root))
        residual[:, axis] = rows[:, axis] - design.spectrum @ sizes
        leverage[:, axis] = np.einsum("ij,jk,ik->i", whitened, covariance, whitened)
    return residual, leverage


def _summarize(
    data: SlowData,
    design: SlowDesign,
    rows: FloatArray,
    variance: FloatArray,
    noise: NoiseModel | None,
) -> SlowFit:
    width, groups = design.prior_std.size, data.means.shape[0]
    with_constant = np.concatenate([design.means, np.ones((groups, 1))], axis=1)
    precision = np.diag(np.append(design.prior_std, INTERCEPT_STD) ** -2.0)
    sizes, covariance = np.zeros((width + 1, 3)), np.zeros((3, width + 1, width + 1))
    run_std, degrees = np.zeros(3), np.zeros(3)
    evidence, likelihood = np.zeros(3), 0.0
    for axis in range(3):
        root = variance[:, axis] ** -0.5
        whitened = np.concatenate([design.spectrum, np.zeros((len(rows), 1))], axis=1)
        whitened = whitened * root[:, None]
        information = whitened.T @ whitened + precision
        vector = whitened.T @ (rows[:, axis] * root)
        white = np.zeros(groups)
        if noise is not None:
            white_variance = float(noise.levels[axis, 0]) * data.rate_hz / 2.0
            white[: len(data.counts)] = white_variance / np.array(data.counts)
        known = data.mean_variance[:, axis] + white
        means = _MeanRows(with_constant, data.means[:, axis], known)
        run_std[axis], mean_nats = means.fit_scatter(information, vector)
        weight = 1.0 / (known + run_std[axis] ** 2 + 1e-30)
        information = information + (with_constant * weight[:, None]).T @ with_constant
        covariance[axis] = np.linalg.inv(information)
        sizes[:, axis] = covariance[axis] @ (vector + with_constant.T @ (weight * means.values))
        residual = rows[:, axis] - design.spectrum @ sizes[:-1, axis]
        log_likelihood = -0.5 * float(
            np.sum(np.log(variance[:, axis]) + residual**2 / variance[:, axis])
        )
        likelihood += log_likelihood + mean_nats
        shrink = sizes[:-1, axis] / design.prior_std
        evidence[axis] = log_likelihood + mean_nats - 0.5 * float(shrink @ shrink)
        evidence[axis] += 0.5 * float(np.linalg.slogdet(covariance[axis])[1])
        evidence[axis] -= float(np.sum(np.log(design.prior_std))) + np.log(INTERCEPT_STD)
        degrees[axis] = (
            max(groups - width - 1, 1)
            if noise is None
            else _noise_degrees(data, noise, axis, design.spectrum, covariance[axis][:-1, :-1])
        )
    if noise is not None:
        evidence -= [0.5 * _prior_misfit(axis_levels) for axis_levels in noise.levels]
    return SlowFit(
        sizes, covariance, noise, run_std, evidence, likelihood,
        rows - design.spectrum @ sizes[:-1], variance, degrees,
    )  # fmt: skip


def _noise_degrees(
    data: SlowData,
    noise: NoiseModel,
    axis: int,
    spectrum: FloatArray,
    covariance: FloatArray,
) -> float:
    """Return the effective degrees of freedom of the noise in the rows that determine the sizes.

    The relative variance of the noise there follows from the information on the levels. It is
    2 / degrees, as that of a sum of squares (Welch and Satterthwaite, JCGM 100:2008, G.4.2).
    """
    shape = unit_densities(data.frequency_hz, noise.sampling)[:3]
    shares = noise.levels[axis, :3, None] * shape
    total = shares.sum(axis=0)
    shares /= total
    leverage = np.einsum("ij,jk,ik->i", spectrum, covariance, spectrum) / total
    if not leverage.any():
        return np.inf
    free = np.maximum(1.0 - leverage * 2.0 / data.rate_hz, 1.0 - MAX_LEVERAGE)
    information = 0.5 * (shares * free) @ shares.T
    information += np.diag([1e-6, PRIOR_LOG_STD**-2.0, PRIOR_LOG_STD**-2.0])
    weight = shares @ leverage / leverage.sum()
    return 2.0 / float(weight @ np.linalg.solve(information, weight))


def _prior_misfit(levels: FloatArray) -> float:
    ratio = levels[1:3] / nominal_levels(float(levels[0]))[1:3]
    return float(np.sum((np.log(ratio) / PRIOR_LOG_STD) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class _MeanRows:
    """The means of recordings and single values of one axis, with an unknown common scatter."""

    design: FloatArray  # (g, q + 1)
    values: FloatArray  # (g,)
    known: FloatArray  # (g,), variance without the scatter

    def fit_scatter(self, information: FloatArray, vector: FloatArray) -> tuple[float, float]:
        """Return the standard deviation with the largest restricted likelihood, and its nats."""
        if self.values.size < 2:
            return 0.0, 0.0
        scale = float(np.std(self.values)) + 1e-12
        best_std, best_nats = 0.0, -np.inf
        for std in [0.0, *(scale * np.geomspace(*RUN_RANGE, RUN_GRID_POINTS))]:
            variance = self.known + std**2
            if not variance.all():
                continue
            weight = 1.0 / variance
            total = information + (self.design * weight[:, None]).T @ self.design
            right = vector + self.design.T @ (weight * self.values)
            sizes = np.linalg.solve(total, right)
            # The completed square of the means and of the other rows together.
            square = float(np.sum(weight * self.values**2) - right @ sizes)
            nats = -0.5 * (float(np.sum(np.log(variance))) + square)
            restricted = nats - 0.5 * float(np.linalg.slogdet(total)[1])
            if restricted > best_nats:
                best_std, best_nats = float(std), restricted
        weight = 1.0 / (self.known + best_std**2 + 1e-30)
        total = information + (self.design * weight[:, None]).T @ self.design
        sizes = np.linalg.solve(total, vector + self.design.T @ (weight * self.values))
        residual = self.values - self.design @ sizes
        return best_std, -0.5 * float(np.sum(residual**2 * weight - np.log(weight)))
