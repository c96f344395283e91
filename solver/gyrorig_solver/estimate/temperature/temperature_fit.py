"""Curve of the bias over temperature, with its order, the lag of the die and hysteresis.

Theory of operation. The bias of window k is c + f(T_die) + a h, where h is the state of a
hysteresis between its branches (`bias_series.heating_state`), and T_die follows the thermometer
with a lag (`model.board_temperature`). The noise consists of white noise, flicker and a random
walk, whose levels are estimated for each model (`slow_noise`). The curve with the largest evidence
is used. The evidence of a model without dependence is computed in the same way, with the random
walk that the data then need. A dependence is stated only if its evidence is larger by
`MIN_EVIDENCE_NATS`. Two hypotheses are tested: all axes depend on the temperature, or one of them
does. The second has a third of the evidence of an axis, because it can be any of the three.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray, TemperatureCurve
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.estimate.temperature.bias_series import (
    LOOP_SHARES,
    BiasSeries,
    BiasTable,
    heating_state,
    shows_loop,
)
from gyrorig_solver.estimate.temperature.curve_basis import CurveBasis, candidate_bases
from gyrorig_solver.estimate.temperature.slow_noise import SlowData, SlowDesign, SlowFit
from gyrorig_solver.numerics import chi2_upper_tail, student_factor

MIN_SPAN_K = 2.0  # a smaller change of the temperature does not determine a curve
MIN_EVIDENCE_NATS = 5.0
AMPLITUDE_STD = 0.05  # rad/s at the ends of the range: 20 deg/s over 125 K (MPU-6050)
LOOP_STD = 0.005  # rad/s
LAG_STD_S = 30.0  # between die and thermometer
LAG_GRID_S = (0.0, 10.0, -10.0, 25.0, -25.0, 50.0, -50.0, 90.0, -90.0)
LAG_REFINEMENTS = 3
LAG_STEP_S = 2.0  # for the derivative with respect to the lag
LOOP_FALSE_ALARM = 1e-3
MAX_COMPLEX_WEIGHT = 0.3  # of all curves that are more complex than the selected one
POINT_BINS = 24  # of the temperature, for figures
SPREAD_POINTS = 60  # temperatures at which curves are compared


@dataclass(frozen=True, slots=True, eq=False)
class Hysteresis:
    """The difference of the bias between heating and cooling at the same temperature."""

    width: FloatArray  # (3,), rad/s, heating minus cooling
    std: FloatArray  # (3,)
    p_value: float
    is_fitted: bool  # whether it is significant and part of the model
    loop_share: float  # of the span, over which the bias reaches its other branch
    span_k: float

    def change(self, die_degc: FloatArray) -> FloatArray:
        """Return the part of the bias by hysteresis, for successive temperatures (n,), (n, 3)."""
        state = heating_state(die_degc, self.span_k, self.loop_share)
        return np.asarray(0.5 * np.outer(state, self.width), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class BiasPoint:
    """The mean of a part of the data, for figures."""

    temperature_degc: float
    value: FloatArray  # (3,)
    heating: bool | None  # None: not known


@dataclass(frozen=True, slots=True, eq=False)
class TemperatureFit:
    """The curve of a quantity of three axes over temperature."""

    basis: CurveBasis
    curve: TemperatureCurve
    value: FloatArray  # (3,), at the reference temperature
    covariance: FloatArray  # (3, q + 1, q + 1), of the coefficients of each axis, then the value
    lag_s: float
    lag_std_s: float
    hysteresis: Hysteresis | None  # None: no recording heats and cools
    run_std: FloatArray  # (3,), from one recording or row to the next; nan if there is only one
    evidence_nats: float  # of the curve, of all axes or of one, relative to no dependence
    statistic: float  # twice the gain of the log-likelihood
    range_degc: tuple[float, float]
    points: tuple[BiasPoint, ...]  # of the data, for figures

    @property
    def reference_degc(self) -> float:
        """The temperature of `value`."""
        return self.basis.reference_degc

    @property
    def is_significant(self) -> bool:
        """Whether the data show a dependence on the temperature."""
        return self.evidence_nats > MIN_EVIDENCE_NATS

    def std(self, temperature_degc: FloatArray) -> FloatArray:
        """Return the standard uncertainty of the value at temperatures (n,), shape (n, 3)."""
        columns = self.basis.columns(np.asarray(temperature_degc, np.float64))
        design = np.concatenate([columns / self.basis.factors(), np.ones((len(columns), 1))], 1)
        variance = np.einsum("ni,aij,nj->na", design, self.covariance, design)
        return np.asarray(np.sqrt(np.clip(variance, 0.0, None)), dtype=np.float64)


def fit_temperature(
    series: Sequence[BiasSeries], step_s: float = 1.0, table: BiasTable | None = None
) -> TemperatureFit | None:
    """Fit the curve; None if the temperature changes too little.

    Args:
        series: of the recordings, all with windows of the same length.
        step_s: length of the windows.
        table: values without times.
    """
    problem = _Problem(tuple(series), step_s, table)
    if problem.span_k < MIN_SPAN_K:
        return None
    bases = candidate_bases(problem.range_degc, problem.reference_degc, problem.distinct_points)
    if not bases:
        return None
    cubic = bases[min(2, len(bases) - 1)]
    lag_s = problem.find_lag(cubic) if series else 0.0
    loop = problem.has_loop
    none = problem.fit(None, lag_s, loop=loop)
    fits = [problem.fit(basis, lag_s, loop=loop) for basis in bases]
    weights = _curve_weights(bases, fits)
    best = _choose(weights)
    basis, fit = bases[best], fits[best]
    # Use the curve with the largest evidence, because the selected one can be more complex.
    evidence_nats = max(_dependence_nats(f, none) for f in fits)
    spread = problem.spread_of_curves(basis, bases, fits, weights)
    hysteresis = None
    if loop:
        without = problem.fit(basis, lag_s, loop=False)
        hysteresis = _hysteresis(fit, without, problem, basis, lag_s)
        if hysteresis.is_fitted:
            lag_s, fit = problem.fit_loop(basis)
            without = problem.fit(basis, lag_s, loop=False)
            hysteresis = _hysteresis(fit, without, problem, basis, lag_s)
        if not hysteresis.is_fitted:
            fit, none = without, problem.fit(None, lag_s, loop=False)
    result = problem.summarize(basis, fit, none, lag_s, hysteresis, spread)
    return replace(result, evidence_nats=float(evidence_nats))


def _dependence_nats(fit: SlowFit, none: SlowFit) -> float:
    """Return the evidence of a dependence of all axes, or of that of one axis if it is larger.

    An axis that does not depend on the temperature costs the evidence of its superfluous sizes. If
    there are few data, this cost of two axes is larger than the evidence of the third.
    """
    axis_nats = fit.axis_evidence - none.axis_evidence
    return max(float(axis_nats.sum()), float(axis_nats.max()) - math.log(axis_nats.size))


def _curve_weights(bases: Sequence[CurveBasis], fits: Sequence[SlowFit]) -> FloatArray:
    """Return the Akaike weight of each curve; all splines together count as one polynomial.

    Source: Burnham and Anderson, Model Selection and Multimodel Inference, 2002, chapter 2.
    """
    splines = sum(1 for basis in bases if basis.knots.size)
    nats = np.array([fit.log_likelihood - 3.0 * b.size for b, fit in zip(bases, fits, strict=True)])
    prior = np.array([1.0 / splines if basis.knots.size else 1.0 for basis in bases])
    weights = prior * np.exp(nats - nats.max())
    return np.asarray(weights / weights.sum(), dtype=np.float64)


def _choose(weights: FloatArray) -> int:
    """Return the simplest curve for which all more complex curves together have little weight."""
    more_complex = weights[::-1].cumsum()[::-1] - weights
    return int(np.flatnonzero(more_complex <= MAX_COMPLEX_WEIGHT)[0])


def _hysteresis(
    fit: SlowFit, without: SlowFit, problem: "_Problem", basis: CurveBasis, lag_s: float
) -> Hysteresis:
    covariance, _ = problem.with_lag(basis, fit, lag_s, loop=True)
    widening = student_factor(fit.degrees)
    size, variance = fit.sizes[-2], covariance[:, -2, -2] * widening**2
    statistic = float(np.sum(size**2 / variance))
    p_value = chi2_upper_tail(statistic, 3)
    is_fitted = bool(p_value < LOOP_FALSE_ALARM and fit.log_evidence > without.log_evidence)
    # The state goes from -1 to 1.
    return Hysteresis(
        2.0 * size, 2.0 * np.sqrt(variance), p_value, is_fitted, problem.loop_share, problem.span_k
    )


class _Problem:
    """The data of a fit, with its designs."""

    def __init__(
        self, series: tuple[BiasSeries, ...], step_s: float, table: BiasTable | None
    ) -> None:
        self.series, self._table = series, table
        self._single_degc = np.zeros(0) if table is None else table.temperature_degc
        values = np.zeros((0, 3)) if table is None else table.value
        stds = np.zeros((0, 3)) if table is None else table.std
        self.data = SlowData.of([s.bias for s in series], step_s, values, stds)
        degc = np.concatenate([*(s.die_degc(0.0) for s in series), self._single_degc])
        self.range_degc = (float(degc.min()), float(degc.max()))
        self.reference_degc = round(float(degc.mean()), 2)
        self.span_k = self.range_degc[1] - self.range_degc[0]
        self.distinct_points = int(np.unique(np.round(degc, 2)).size)
        self.has_loop = any(shows_loop(s.die_degc(0.0)) for s in series)
        self.loop_share = LOOP_SHARES[0]
        self.lag_spread_s = 0.0  # of the lag for the different shapes of a loop

    def find_lag(self, basis: CurveBasis) -> float:
        """Return the lag with the largest posterior density."""
        start: NoiseModel | None = None
        limit_s = 0.25 * max(s.duration_s for s in self.series)
        density: dict[float, float] = {}

        def evaluate(lag_s: float) -> float:
            nonlocal start
            if lag_s not in density:
                fit = self.fit(basis, lag_s, loop=self.has_loop, start=start)
                start = start or fit.noise
                density[lag_s] = fit.log_evidence - 0.5 * (lag_s / LAG_STD_S) ** 2
            return density[lag_s]

        grid = [lag_s for lag_s in LAG_GRID_S if abs(lag_s) <= limit_s]
        best = max(grid, key=evaluate)
        for _ in range(LAG_REFINEMENTS):
            ordered = sorted(density)
            k = ordered.index(best)
            if not 0 < k < len(ordered) - 1:
                break
            x, y = np.array(ordered[k - 1 : k + 2]), [density[v] for v in ordered[k - 1 : k + 2]]
            second, first, _ = np.polyfit(x - best, y, 2)
            if second >= 0.0:
                break
            evaluate(round(float(np.clip(best - 0.5 * first / second, x[0], x[2])), 1))
            best = max(density, key=lambda lag_s: density[lag_s])
        return best

    def fit_loop(self, basis: CurveBasis) -> tuple[float, SlowFit]:
        """Return lag and fit with the most likely shape of the loop, which acts like a lag."""
        fits: dict[float, tuple[float, SlowFit]] = {}
        for share in LOOP_SHARES:
            self.loop_share = share
            lag_s = self.find_lag(basis)
            fits[share] = lag_s, self.fit(basis, lag_s, loop=True)
        self.loop_share = max(fits, key=lambda share: fits[share][1].log_likelihood)
        lags_s = [lag_s for lag_s, _ in fits.values()]
        self.lag_spread_s = max(abs(lag_s - fits[self.loop_share][0]) for lag_s in lags_s)
        return fits[self.loop_share]

    def fit(
        self,
        basis: CurveBasis | None,
        lag_s: float,
        *,
        loop: bool,
        start: NoiseModel | None = None,
    ) -> SlowFit:
        """Fit one curve, or no curve, at a lag."""
        return SlowFit.solve(self.data, self._design(basis, lag_s, loop), start)

    def summarize(
        self,
        basis: CurveBasis,
        fit: SlowFit,
        none: SlowFit,
        lag_s: float,
        hysteresis: Hysteresis | None,
        spread: FloatArray,
    ) -> TemperatureFit:
        """Return the result, with the uncertainties of lag, order and noise in the covariance."""
        loop = hysteresis is not None and hysteresis.is_fitted
        covariance, lag_std_s = self.with_lag(basis, fit, lag_s, loop=loop)
        keep = [*range(basis.size), fit.sizes.shape[0] - 1]
        widening = student_factor(fit.degrees)
        factors = np.append(basis.factors(), 1.0)
        total = covariance[:, keep][:, :, keep] * widening[:, None, None] ** 2 + spread
        selected = total * np.outer(factors, factors)
        is_one = self.data.means.shape[0] < 2
        return TemperatureFit(
            basis=basis,
            curve=basis.curve(fit.sizes[: basis.size], self.range_degc),
            value=fit.sizes[-1],
            covariance=selected,
            lag_s=lag_s,
            lag_std_s=float(np.hypot(lag_std_s, self.lag_spread_s)),
            hysteresis=hysteresis,
            run_std=np.full(3, np.nan) if is_one else fit.run_std,
            evidence_nats=_dependence_nats(fit, none),
            statistic=2.0 * (fit.log_likelihood - none.log_likelihood),
            range_degc=self.range_degc,
            points=self.points(lag_s),
        )

    def points(self, lag_s: float) -> tuple[BiasPoint, ...]:
        """Return means in bins of the temperature, of each branch, and single values."""
        points = []
        edges = np.linspace(*self.range_degc, POINT_BINS + 1)[1:-1]
        for series in self.series:
            degc = series.die_degc(lag_s)
            bins = np.digitize(degc, edges)
            heating = heating_state(degc, self.span_k) > 0.0
            for k, branch in itertools.product(range(POINT_BINS), (True, False)):
                rows = (bins == k) & (heating == branch)
                if rows.any():
                    mean = series.bias[rows].mean(axis=0)
                    points.append(BiasPoint(float(degc[rows].mean()), mean, branch))
        single = self.data.means[len(self.series) :]
        for degc_k, value in zip(self._single_degc, single, strict=True):
            points.append(BiasPoint(float(degc_k), value, None))
        return tuple(points)

    def spread_of_curves(
        self,
        chosen: CurveBasis,
        bases: Sequence[CurveBasis],
        fits: Sequence[SlowFit],
        weights: FloatArray,
    ) -> FloatArray:
        """Return the covariance of the sizes between the curves, (3, q + 1, q + 1)."""
        degc = np.linspace(*self.range_degc, SPREAD_POINTS)
        design = np.concatenate([chosen.columns(degc), np.ones((SPREAD_POINTS, 1))], axis=1)
        sizes = np.array(
            [
                np.linalg.lstsq(
                    design,
                    basis.columns(degc) @ fit.sizes[: basis.size] + fit.sizes[-1],
                    rcond=None,
                )[0]
                for basis, fit in zip(bases, fits, strict=True)
            ]
        )
        index = next(k for k, basis in enumerate(bases) if basis is chosen)
        difference = sizes - sizes[index]
        return np.asarray(np.einsum("m,mia,mja->aij", weights, difference, difference), np.float64)

    def with_lag(
        self, basis: CurveBasis, fit: SlowFit, lag_s: float, *, loop: bool
    ) -> tuple[FloatArray, float]:
        """Return the covariance of the sizes with the lag's uncertainty, and this uncertainty."""
        if not self.series:
            return fit.covariance, 0.0
        ahead, behind = (
            self._design(basis, lag_s + sign * LAG_STEP_S, loop) for sign in (1.0, -1.0)
        )
        sizes = fit.sizes[:-1]
        slope = (ahead.spectrum - behind.spectrum) @ sizes / (2.0 * LAG_STEP_S)
        mean_slope = (ahead.means - behind.means) @ sizes / (2.0 * LAG_STEP_S)
        design = self._design(basis, lag_s, loop)
        weight = 1.0 / fit.variance
        information, shifts = LAG_STD_S**-2.0, []
        for axis in range(3):
            cross = np.append(design.spectrum.T @ (weight[:, axis] * slope[:, axis]), 0.0)
            shift = fit.covariance[axis] @ cross
            direct = float(np.sum(weight[:, axis] * slope[:, axis] ** 2))
            information += max(direct - float(cross @ shift), 0.0)
            shift[-1] += float(np.mean(mean_slope[:, axis])) - 0.0
            shifts.append(shift)
        variance = 1.0 / information
        total = np.stack(
            [
                covariance + variance * np.outer(shift, shift)
                for covariance, shift in zip(fit.covariance, shifts, strict=True)
            ]
        )
        return total, float(np.sqrt(variance))

    def _design(self, basis: CurveBasis | None, lag_s: float, loop: bool) -> SlowDesign:
        prior = np.zeros(0) if basis is None else basis.prior_std(AMPLITUDE_STD)
        prior = np.append(prior, LOOP_STD) if loop else prior
        columns = []
        for series in self.series:
            degc = series.die_degc(lag_s)
            parts = [] if basis is None else [basis.columns(degc)]
            if loop:
                parts.append(heating_state(degc, self.span_k, self.loop_share)[:, None])
            columns.append(np.concatenate([np.zeros((degc.size, 0)), *parts], axis=1))
        single = np.zeros((self._single_degc.size, prior.size))
        if basis is not None:
            single[:, : basis.size] = basis.columns(self._single_degc)
        return SlowDesign.of(columns, single, prior)
