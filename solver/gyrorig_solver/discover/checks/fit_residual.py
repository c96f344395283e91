"""Residual tests for references without a rate at each moment.

Known turns and gravity between rests give the sum of a motion, not its course, therefore no cause
can be searched over time. Where the fit has a residual over time, its dependence on rates, speed
and time is tested by smooth functions, whitened by the fit's noise, with gain, bias and lag.
"""

import math

import numpy as np
from scipy.fft import dct

from gyrorig_solver.data.arrays import BoolArray, FloatArray
from gyrorig_solver.discover.cause_findings import (
    CauseFindings,
    DependenceTest,
    UnexplainedResidual,
    UntestableCause,
    Verdict,
)
from gyrorig_solver.estimate.gyro_fit import FitDiagnostics, GyroFit
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.numerics import chi2_upper_tail

BAND_HZ = 5.0  # above it a reference's own smoothing is seen, see `estimate.attitude.attitude_fit`
FALSE_ALARM_RATE = 0.005
KNOTS = 7
MIN_BLOCKS = 256
DESCRIPTIONS = {
    "own_rate": "on the rate about the same axis",
    "speed": "on the speed (the gain changes)",
    "time": "on the time (the gain changes)",
    "bias_time": "on the time (the bias changes)",
}


def findings_from_fit(fit: GyroFit) -> CauseFindings:
    """Return the findings of a fit whose reference is not a unit's motion: residual tests only."""
    tests = () if fit.diagnostics is None else tuple(_dependence_tests(fit.diagnostics, fit.gain))
    significant = [test for test in tests if test.p_value < FALSE_ALARM_RATE]
    verdict: Verdict = "unexplained" if significant else "adequate"
    return CauseFindings(
        verdict=verdict,
        causes=(),
        unexplained=UnexplainedResidual(significant[0], tuple(significant[1:]), 0.0)
        if significant
        else None,
        dependence_tests=tests,
        detection_limits=(),
        untestable=tuple(_untestable_causes(fit)),
        base_terms=fit.terms,
        base_reduced_chi2=fit.reduced_chi2,
        base_whiteness_p=tests[0].p_value if tests else math.nan,
        extended_reduced_chi2=fit.reduced_chi2,
        gain=None,
        changes=(),
        duration_s=0.0,
    )


def _untestable_causes(fit: GyroFit) -> list[UntestableCause]:
    compared = fit.reference.partition(";")[0] or "a quantity of the board"
    why = (
        f"the reference ({compared}) does not give the rate at every time; record the board on a "
        "pan-tilt unit, or with reference attitudes"
    )
    return [
        UntestableCause(term.cause, None, why)
        for term in catalogue().values()
        if term.kind in ("effect", "gauge", "stochastic")
        and term.cause not in ("axis_swap", "sign_flip", "wrong_full_scale")
    ]


def _dependence_tests(data: FitDiagnostics, gain: FloatArray) -> list[DependenceTest]:
    finite_inputs = np.hstack([data.residual_rad_s, data.reference_rad_s])
    known: BoolArray = np.asarray(np.isfinite(finite_inputs).all(axis=1), dtype=np.bool_)
    if known.sum() < MIN_BLOCKS or not np.all(np.isfinite(gain)):
        return []
    rate = np.where(known[:, None], data.reference_rad_s @ gain.T, 0.0)
    residual = np.where(known[:, None], data.residual_rad_s, 0.0)
    time_s = data.time_s - data.time_s[0]
    step_s = float(np.median(np.diff(data.time_s)))
    speed = np.linalg.norm(rate, axis=1)
    whitener = _SpectrumWhitener(data, step_s)
    tests = []
    for name, description in DESCRIPTIONS.items():
        total_statistic, degrees, strongest = 0.0, 0, (0.0, 0)
        for axis in range(3):
            shapes = _smooth_functions(name, rate[:, axis], speed, time_s) * known
            slope = np.gradient(rate[:, axis], step_s)
            base = np.vstack([rate.T, np.ones(rate.shape[0]), slope]) * known
            statistic, dof = whitener.statistic(axis, residual[:, axis], shapes, base)
            total_statistic, degrees = total_statistic + statistic, degrees + dof
            strongest = max(strongest, (statistic, axis))
        if degrees:
            p_value = min(1.0, chi2_upper_tail(total_statistic, degrees) * len(DESCRIPTIONS))
            tests.append(
                DependenceTest(
                    name, description, total_statistic, degrees, p_value, "xyz"[strongest[1]]
                )
            )
    return sorted(tests, key=lambda test: (test.p_value, -test.statistic))


def _smooth_functions(
    name: str, rate: FloatArray, speed: FloatArray, time_s: FloatArray
) -> FloatArray:
    """Return smooth functions of a covariate, (k, n)."""
    if name == "own_rate":
        return _hat_functions(rate, float(rate.min()), float(rate.max()))
    if name == "bias_time":
        return _hat_functions(time_s, 0.0, float(time_s[-1]))
    of = speed if name == "speed" else time_s
    return _hat_functions(of, 0.0, float(of.max())) * rate


def _hat_functions(x: FloatArray, low: float, high: float) -> FloatArray:
    knots = np.linspace(low, high, KNOTS)
    width = max(float(knots[1] - knots[0]), 1e-12)
    return np.asarray(np.clip(1.0 - np.abs(x - knots[:, None]) / width, 0.0, None), np.float64)


class _SpectrumWhitener:
    """Transforms signals to coefficients of unit noise variance, up to the band limit."""

    def __init__(self, data: FitDiagnostics, step_s: float) -> None:
        n = data.time_s.size
        frequency = np.arange(n) / (2.0 * n * step_s)
        self._keep = (frequency > 0.0) & (frequency <= BAND_HZ)
        logs = np.log(np.maximum(data.frequency_hz, 1e-9))
        at = np.log(frequency[self._keep])
        density = [
            np.exp(np.interp(at, logs, np.log(np.maximum(column, 1e-30))))
            for column in data.spectrum_model.T
        ]
        self._deviation = np.sqrt(np.stack(density) / (2.0 * step_s))

    def statistic(
        self, axis: int, residual: FloatArray, shapes: FloatArray, base: FloatArray
    ) -> tuple[float, int]:
        """Return the score statistic of shapes and its degrees of freedom."""
        base_signals, left, signal = (self._whiten(axis, s) for s in (base, residual[None], shapes))
        basis = np.linalg.qr(base_signals.T)[0]
        signal = signal - (signal @ basis) @ basis.T
        left = left[0] - (left[0] @ basis) @ basis.T
        energy = np.linalg.norm(signal, axis=1)
        signal = signal[energy > 1e-6 * max(float(energy.max()), 1e-30)]
        if not signal.shape[0]:
            return 0.0, 0
        _, strength, rows = np.linalg.svd(signal, full_matrices=False)
        rows = rows[strength > 1e-6 * strength[0]]
        # An excess of the whole residual over the noise model does not count as a shape.
        spread = max(1.0, float(left @ left) / max(1, left.size - basis.shape[1]))
        return float(np.sum((rows @ left) ** 2)) / spread, int(rows.shape[0])

    def _whiten(self, axis: int, signals: FloatArray) -> FloatArray:
        spectrum = dct(signals, axis=-1, norm="ortho")[:, self._keep]
        return np.asarray(spectrum / self._deviation[axis], dtype=np.float64)
