"""Findings where the reference tells no rates: nameless tests of a fit's residual, if it has one.

Turns by known angles and gravity between rests say what a motion came to, not how it went: there
is nothing over time that a cause could be seen in. Where a fit does keep a residual over time,
whether that depends on the rates, the speed or the time is tested: smooth functions of each,
whitened by the fit's own noise, beside gain, bias and lag.
"""

import math

import numpy as np
from scipy.fft import dct

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.result import Findings, NotTestable, Signature, Unexplained, Verdict
from gyrorig_solver.estimate.result import FitDiagnostics, GyroFit
from gyrorig_solver.model.terms.catalogue import catalogue

BAND_HZ = 5.0  # above it a reference's own smoothing is seen, see `estimate.attitude`
ALPHA = 0.005
KNOTS = 7
LEAST_BLOCKS = 256
WORDS = {
    "own_rate": "on each axis' own rate",
    "speed": "on the speed, as a gain",
    "time": "on the time, as a gain",
    "bias_time": "on the time, as a bias",
}


def findings_of_fit(fit: GyroFit) -> Findings:
    """Return what a fit against another reference than a unit's motion leaves."""
    signatures = () if fit.diagnostics is None else tuple(_signatures(fit.diagnostics, fit.gain))
    rest = [one for one in signatures if one.p_value < ALPHA]
    verdict: Verdict = "unexplained" if rest else "adequate"
    return Findings(
        verdict=verdict,
        causes=(),
        unexplained=Unexplained(rest[0], tuple(rest[1:]), 0.0) if rest else None,
        signatures=signatures,
        absent=(),
        not_testable=tuple(_not_testable(fit)),
        base_terms=fit.terms,
        base_reduced_chi2=fit.reduced_chi2,
        base_whiteness_p=signatures[0].p_value if signatures else math.nan,
        extended_reduced_chi2=fit.reduced_chi2,
        gain=None,
        changes=(),
        seconds=0.0,
    )


def _not_testable(fit: GyroFit) -> list[NotTestable]:
    compared = fit.reference.partition(";")[0] or "what the reference says"
    why = (
        f"compared was {compared}, not the rate at each moment; record the board on a pan-tilt "
        "unit, or beside reference attitudes"
    )
    return [
        NotTestable(term.cause, None, why)
        for term in catalogue().values()
        if term.kind in ("effect", "gauge", "stochastic")
        and term.cause not in ("axis_swap", "sign_flip", "wrong_full_scale")
    ]


def _signatures(data: FitDiagnostics, gain: FloatArray) -> list[Signature]:
    both = np.hstack([data.residual_rad_s, data.reference_rad_s])
    known: BoolArray = np.asarray(np.isfinite(both).all(axis=1), dtype=np.bool_)
    if known.sum() < LEAST_BLOCKS or not np.all(np.isfinite(gain)):
        return []
    rate = np.where(known[:, None], data.reference_rad_s @ gain.T, 0.0)
    residual = np.where(known[:, None], data.residual_rad_s, 0.0)
    time_s = data.time_s - data.time_s[0]
    step_s = float(np.median(np.diff(data.time_s)))
    speed = np.linalg.norm(rate, axis=1)
    white = _Whitener(data, step_s)
    found = []
    for name, words in WORDS.items():
        total, degrees, most = 0.0, 0, (0.0, 0)
        for axis in range(3):
            shapes = _shapes(name, rate[:, axis], speed, time_s) * known
            slope = np.gradient(rate[:, axis], step_s)
            base = np.vstack([rate.T, np.ones(rate.shape[0]), slope]) * known
            statistic, dof = white.statistic(axis, residual[:, axis], shapes, base)
            total, degrees = total + statistic, degrees + dof
            most = max(most, (statistic, axis))
        if degrees:
            p_value = min(1.0, chi2_tail(total, degrees) * len(WORDS))
            found.append(Signature(name, words, total, degrees, p_value, "xyz"[most[1]]))
    return sorted(found, key=lambda one: (one.p_value, -one.statistic))


def _shapes(name: str, rate: FloatArray, speed: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return smooth functions of a covariate, (k, n)."""
    if name == "own_rate":
        return _hats(rate, float(rate.min()), float(rate.max()))
    if name == "bias_time":
        return _hats(time_s, 0.0, float(time_s[-1]))
    of = speed if name == "speed" else time_s
    return _hats(of, 0.0, float(of.max())) * rate


def _hats(x: FloatArray, low: float, high: float) -> FloatArray:
    knots = np.linspace(low, high, KNOTS)
    width = max(float(knots[1] - knots[0]), 1e-12)
    return np.asarray(np.clip(1.0 - np.abs(x - knots[:, None]) / width, 0.0, None), np.float64)


class _Whitener:
    """Takes signals to coefficients of the fit's noise, up to the band."""

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
        """Return how much shapes explain of a residual beside the base, and their number."""
        own, left, signal = (self._white(axis, s) for s in (base, residual[None], shapes))
        basis = np.linalg.qr(own.T)[0]
        signal = signal - (signal @ basis) @ basis.T
        left = left[0] - (left[0] @ basis) @ basis.T
        energy = np.linalg.norm(signal, axis=1)
        signal = signal[energy > 1e-6 * max(float(energy.max()), 1e-30)]
        if not signal.shape[0]:
            return 0.0, 0
        _, strength, rows = np.linalg.svd(signal, full_matrices=False)
        rows = rows[strength > 1e-6 * strength[0]]
        # What the noise model misses of the residual as a whole is not held against a shape.
        spread = max(1.0, float(left @ left) / max(1, left.size - basis.shape[1]))
        return float(np.sum((rows @ left) ** 2)) / spread, int(rows.shape[0])

    def _white(self, axis: int, signals: FloatArray) -> FloatArray:
        spectrum = dct(signals, axis=-1, norm="ortho")[:, self._keep]
        return np.asarray(spectrum / self._deviation[axis], dtype=np.float64)
