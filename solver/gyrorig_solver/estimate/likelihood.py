"""The rate-domain maximum-likelihood fit of one board against a reference motion.

Rounds of Gauss-Newton over (G, b, tau) and the reference's own unknowns; after each
round the noise levels are found again in the residual's spectrum and the samples are
judged again for spikes. All derivatives are analytic. See `normal` for the algebra,
`noise` for the density, `observability` for what is then allowed to be a number.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct, idct

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.information import NAMES, loosened, marginalise
from gyrorig_solver.estimate.noise import NoiseModel, Sampling, Spectrum, binned, fit_levels
from gyrorig_solver.estimate.normal import BlockModel, Normal, block_model, normal_equations
from gyrorig_solver.estimate.observability import Decision, decide, prior_std
from gyrorig_solver.estimate.series import Predicted, Series, low_pass_delay_s, predict
from gyrorig_solver.reference.motion import ReferenceMotion

ROUNDS = 12
CONVERGED_SIGMA = 1e-2  # largest last step, in standard deviations
FRESH_ROUNDS = 2  # rounds after which the reference's derivatives stay as they are
SPIKE_SIGMA = 6.0  # a sample this far off is no sample of the model's noise
SEARCH_S = 0.3  # the lag is looked for within this range first
MOVING_RAD_S = 0.003  # the reference turns faster than this: moving


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where the fit ended: parameters, what they rest on, and the residual."""

    estimate: FloatArray  # (13,), G row by row, b, time offset (whole lag)
    information: FloatArray  # (13, 13), nuisances and the common shift marginalised
    decision: Decision
    reference: ReferenceMotion
    noise: NoiseModel
    spectrum: Spectrum
    models: list[BlockModel]
    residuals: list[FloatArray]
    whitened: list[FloatArray]
    outliers: int
    used: int
    converged: bool

    @property
    def gain(self) -> FloatArray:
        """G, shape (3, 3)."""
        return self.estimate[:9].reshape(3, 3)

    @property
    def bias_rad_s(self) -> FloatArray:
        """Shape (3,)."""
        return self.estimate[9:12]


def solve_likelihood(
    series: list[Series],
    sampling: Sampling,
    reference: ReferenceMotion,
    stamp_std_s: float = 0.0,
) -> Solution:
    """Fit one board against a reference motion.

    Args:
        series: of one board, from `build_series`.
        sampling: how they were sampled.
        reference: the stage's motion on the same time axis.
        stamp_std_s: what is not known of the samples' own times, one shift of all.

    Raises:
        InputError: no sample has a reference.
    """
    sampling = replace(sampling, differentiated=reference.differentiated)
    work = _Work(series, sampling, reference)
    work.begin()
    converged = False
    for _ in range(ROUNDS):
        step = work.round()
        if step < CONVERGED_SIGMA:
            converged = True
            break
    return work.solution(converged, stamp_std_s)


class _Work:
    """The fit under way."""

    def __init__(
        self, series: list[Series], sampling: Sampling, reference: ReferenceMotion
    ) -> None:
        self._series, self._sampling, self._reference = series, sampling, reference
        self._gain, self._bias, self._lag_s = np.eye(3), np.zeros(3), 0.0
        self._good = [s.good for s in series]
        self._predicted: list[Predicted] = []
        self._rounds = 0
        self._models: list[BlockModel] = []

    def begin(self) -> None:
        """Find a lag by correlation, then gain and bias by plain least squares."""
        if not self._series:
            raise InputError("no stretch of samples is long enough", "record for longer")
        self._lag_s = max(
            (_correlation_lag(s, self._reference) for s in self._series), key=lambda x: x[1]
        )[0]
        self._predict()
        if not any(m.used.any() for m in self._models):
            raise InputError(
                "no sample lies where the reference motion is known",
                "check that unit and board were recorded together",
            )
        information = np.diag(prior_std(NAMES[:12]) ** -2.0) * 1e-6
        score = information @ np.concatenate([np.eye(3).ravel(), np.zeros(3)])
        for model in self._models:
            design = np.column_stack([model.rate, np.ones(model.used.size)])[model.used]
            gram, moment = design.T @ design, design.T @ model.measured[model.used]
            for axis in range(3):
                index = [3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis]
                information[np.ix_(index, index)] += gram
                score[index] += moment[:, axis]
        start = np.linalg.solve(information, score)
        self._gain, self._bias = start[:9].reshape(3, 3), start[9:]
        self._judge()
        self._fit_noise()

    def round(self) -> float:
        """Take one Gauss-Newton step; return its largest size in standard deviations."""
        marginal = marginalise(self._normal(), self._reference, self._shared_count())
        decision = decide(marginal.information, NAMES)
        step = decision.inverse @ marginal.score
        self._marginal, self._decision = marginal.information, decision
        self._gain = self._gain + step[:9].reshape(3, 3)
        self._bias = self._bias + step[9:12]
        self._lag_s += float(np.clip(step[12], -0.05, 0.05))
        self._reference = self._reference.moved(self._as_reference(marginal.nuisance(step)))
        self._rounds += 1
        self._predict()
        self._judge()
        self._fit_noise()
        sigma = np.sqrt(np.clip(np.diag(decision.covariance), 0.0, None))
        return float(np.max(np.abs(step) / np.where(sigma > 0.0, sigma, np.inf)))

    def solution(self, converged: bool, stamp_std_s: float) -> Solution:
        """Return the result, the common shift of the reference put into the offset."""
        delay_s = low_pass_delay_s(self._series[0])
        estimate = np.concatenate([self._gain.ravel(), self._bias, [self._lag_s + delay_s]])
        common = float(np.hypot(self._reference.common_std_s, stamp_std_s))
        information = loosened(self._marginal, 12, common)
        noise = self._noise
        return Solution(
            estimate=estimate,
            information=information,
            decision=decide(information, NAMES),
            reference=self._reference,
            noise=noise,
            spectrum=self._spectrum,
            models=self._models,
            residuals=self._residuals,
            whitened=[_whiten(r, noise) for r in self._residuals],
            outliers=sum(
                int(np.sum(s.good & ~g)) for s, g in zip(self._series, self._good, strict=True)
            ),
            used=sum(int(g.sum()) for g in self._good),
            converged=converged,
        )

    def _shared_count(self) -> int:
        return int(self._models[0].shared.shape[0])

    def _normal(self) -> Normal:
        parts = [
            normal_equations(m, self._gain, r, self._noise)
            for m, r in zip(self._models, self._residuals, strict=True)
        ]
        total = parts[0]
        for part in parts[1:]:
            total = total + part
        return total

    def _as_reference(self, nuisance: FloatArray) -> FloatArray:
        """Reorder (shared, local) as the reference has them: local first."""
        g = self._shared_count()
        return np.concatenate([nuisance[g:], nuisance[:g]])

    def _predict(self) -> None:
        # Once near the solution the derivatives hardly change, and they cost most.
        fresh = self._rounds < FRESH_ROUNDS
        found = [predict(s, self._reference, self._lag_s, fresh) for s in self._series]
        if not fresh:
            found = [
                replace(new, shared=old.shared, local=old.local)
                for new, old in zip(found, self._predicted, strict=True)
            ]
        self._predicted = found
        self._blocks()

    def _blocks(self) -> None:
        self._models = [
            block_model(s, p, g & p.known)
            for s, p, g in zip(self._series, self._predicted, self._good, strict=True)
        ]

    def _judge(self) -> None:
        """Set spikes aside, by each sample's own residual against a robust deviation."""
        good: list[BoolArray] = []
        for series, predicted in zip(self._series, self._predicted, strict=True):
            residual = series.rate_rad_s - predicted.rate @ self._gain.T - self._bias
            use = series.good & predicted.known
            if not use.any():
                good.append(series.good)
                continue
            middle = np.median(residual[use], axis=0)
            deviation = 1.4826 * np.median(np.abs(residual[use] - middle), axis=0)
            limit = SPIKE_SIGMA * np.maximum(deviation, self._sampling.quantum_rad_s)
            spike = np.any(np.abs(residual - middle) > limit, axis=1)
            good.append(series.good & ~spike)
        self._good = good
        self._blocks()
        self._residuals = [m.residual(self._gain, self._bias) for m in self._models]

    def _fit_noise(self) -> None:
        spectra = [dct(r, axis=0, norm="ortho") for r in self._residuals]
        # Missing blocks are zeros; their share of the power is given back.
        filled = [
            c / np.sqrt(max(float(np.mean(m.used)), 1e-3))
            for c, m in zip(spectra, self._models, strict=True)
        ]
        self._spectrum = binned(filled, self._sampling.rate_hz)
        self._noise = fit_levels(self._spectrum, self._sampling)


def _whiten(residual: FloatArray, noise: NoiseModel) -> FloatArray:
    spectrum = dct(residual, axis=0, norm="ortho") / np.sqrt(noise.variance(residual.shape[0]))
    return np.asarray(idct(spectrum, axis=0, norm="ortho"), dtype=np.float64)


def _correlation_lag(series: Series, reference: ReferenceMotion) -> tuple[float, float]:
    """Return the lag at which measured and reference speeds agree best, and how well.

    Speeds (norms) do not care how the sensor is mounted. The mean is taken out of both.
    """
    predicted = predict(series, reference, 0.0, derivatives=False)
    use = series.good & predicted.known
    if use.sum() < 10:
        return 0.0, -1.0
    bias = np.median(series.rate_rad_s[use], axis=0)
    measured = np.where(use, np.linalg.norm(series.rate_rad_s - bias, axis=1), 0.0)
    turning = np.where(use, np.linalg.norm(predicted.rate, axis=1), 0.0)
    if np.std(turning[use]) < MOVING_RAD_S:
        return 0.0, -1.0
    measured = np.where(use, measured - measured[use].mean(), 0.0)
    turning = np.where(use, turning - turning[use].mean(), 0.0)
    size = 1 << (2 * measured.size - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(measured, size) * np.conj(np.fft.rfft(turning, size)), size)
    period_s = float(series.time_s[-1] - series.time_s[0]) / (series.time_s.size - 1)
    reach = int(SEARCH_S / period_s)
    lags = np.arange(-reach, reach + 1)
    score = product[lags]
    best = int(np.argmax(score))
    quality = float(score[best] / (np.linalg.norm(measured) * np.linalg.norm(turning) + 1e-30))
    return float(lags[best]) * period_s, quality
