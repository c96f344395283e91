"""Bias over temperature from recordings at rest: fitted, subtracted and reported.

What to use when: `measure_rests` for the windows of the bias; `RestTemperature.find` for the curve,
with which a board is solved again and its result is completed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.recording.recording_names import distinct_names
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.data.stream.count_stream import subtract_rates
from gyrorig_solver.discover import NamedCause
from gyrorig_solver.discover.cause_findings import CalibrationChange
from gyrorig_solver.discover.named_causes import name_outside_fit
from gyrorig_solver.estimate import GyroFit, TemperatureFit, fit_temperature
from gyrorig_solver.estimate.temperature import (
    BiasChange,
    BiasSeries,
    measure_bias_change,
)
from gyrorig_solver.findings import figure_key
from gyrorig_solver.model import BoardTemperature, Term, format_short
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.numerics import chi2_upper_tail
from gyrorig_solver.pipeline.board_data import BoardData, Session
from gyrorig_solver.pipeline.board_results import BoardExplanation

MAX_WINDOWS = 600  # of the longest recording
MIN_WINDOW_S = 1.0
MIN_WINDOWS = 20  # of a recording
KNOCK_SIGMA = 6.0  # a sample with this deviation from the others is a knock
SMOOTHING_S = 20.0  # of the thermometer
ACTING_SIGMA = 3.0  # an axis with a coefficient this many standard deviations from zero is named
CHANGE_REMARK = (
    "the bias changed by {} deg/s (standard deviations of x, y, z) during the recording. The "
    "uncertainty of the bias includes this change"
)
FOLLOWS_REASON = (
    "the bias follows the temperature ({}), but this fit assumes a constant bias. Solve with "
    "`--extend auto`, which fits the bias against the temperature"
)


@dataclass(frozen=True, slots=True, eq=False)
class RestWindows:
    """Means of the bias over windows of recordings at rest."""

    names: tuple[str, ...]
    times_s: tuple[FloatArray, ...]  # (n,) each
    biases: tuple[FloatArray, ...]  # (n, 3) each
    step_s: float

    @property
    def change(self) -> BiasChange:
        """The change of the bias."""
        return measure_bias_change(self.biases)


def measure_rests(sessions: Sequence[Session]) -> RestWindows | None:
    """Return the windows of all recordings; None if a recording is too short."""
    durations = [float(np.ptp(samples.time_s)) for _, samples, _ in sessions]
    step_s = max(MIN_WINDOW_S, max(durations) / MAX_WINDOWS)
    if min(durations) < MIN_WINDOWS * step_s:
        return None
    windows = [_bias_windows(session, step_s) for session in sessions]
    if any(window is None for window in windows):
        return None
    known = [window for window in windows if window is not None]
    return RestWindows(
        distinct_names([recording for recording, _, _ in sessions]),
        tuple(time_s for time_s, _ in known),
        tuple(bias for _, bias in known),
        step_s,
    )


def _bias_windows(session: Session, step_s: float) -> tuple[FloatArray, FloatArray] | None:
    """Return times and means of the windows of one recording; None if most are empty."""
    _, samples, reference = session
    begin_s = float(samples.time_s[0])
    count = int((samples.time_s[-1] - begin_s) / step_s)
    half = 0.5 * samples.period_s
    edges_s = np.stack([samples.time_s - half, samples.time_s + half], axis=1)
    at_rest = np.zeros(samples.time_s.size, dtype=np.bool_)
    for rest in getattr(reference, "rests", ()):
        at_rest |= (edges_s[:, 0] >= rest.begin_s - half) & (edges_s[:, 1] <= rest.end_s + half)
    used = np.flatnonzero(samples.usable & at_rest)
    window = np.minimum(((samples.time_s[used] - begin_s) / step_s).astype(np.int64), count - 1)
    rate = samples.gyro.values(used)
    keep = np.ones(used.size, dtype=np.bool_)
    for _ in range(2):  # the second pass is without knocks
        number = np.maximum(np.bincount(window[keep], minlength=count), 1)
        mean = np.stack(
            [np.bincount(window[keep], rate[keep, a], count) / number for a in range(3)], axis=1
        )
        deviation = np.abs(rate - mean[window])
        spread = 1.4826 * np.median(deviation, axis=0) + samples.quantum_rad_s
        keep = np.all(deviation < KNOCK_SIGMA * spread, axis=1)
    filled = np.bincount(window[keep], minlength=count) > 0
    if filled.mean() < 0.5:
        return None
    index = np.arange(count)
    bias = np.stack([np.interp(index, index[filled], mean[filled, a]) for a in range(3)], axis=1)
    centres_s = np.asarray(begin_s + (index + 0.5) * step_s, dtype=np.float64)
    return centres_s, np.asarray(bias, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class RestTemperature:
    """The curve of a board, from its recordings at rest."""

    fit: TemperatureFit
    temperatures: tuple[BoardTemperature, ...]  # of the recordings

    @classmethod
    def find(cls, data: BoardData) -> "RestTemperature | None":
        """Return the curve if the bias depends on the temperature, else None."""
        windows = measure_rests(data.sessions)
        if windows is None:
            return None
        temperatures = [_temperature(samples) for _, samples, _ in data.sessions]
        known = tuple(temperature for temperature in temperatures if temperature is not None)
        # Readings with and without an offset are not on one scale.
        scales = {samples.has_absolute_temperature for _, samples, _ in data.sessions}
        if len(known) < len(temperatures) or len(scales) > 1:
            return None
        series = [
            BiasSeries(name, time_s, bias, temperature, temperature.mean_degc)
            for name, time_s, bias, temperature in zip(
                windows.names, windows.times_s, windows.biases, known, strict=True
            )
        ]
        fit = fit_temperature(series, windows.step_s)
        return None if fit is None or not fit.is_significant else cls(fit, known)

    def removed_from(self, data: BoardData) -> BoardData:
        """Return data whose bias is the bias at the reference temperature."""
        changed = tuple(
            (recording, self._subtract(samples, temperature), reference)
            for (recording, samples, reference), temperature in zip(
                data.sessions, self.temperatures, strict=True
            )
        )
        return replace(data, changed_sessions=changed)

    def _subtract(self, samples: GyroSamples, temperature: BoardTemperature) -> GyroSamples:
        grid_s = temperature.time_s
        rise = temperature.die_temperature_rise(grid_s, self.fit.lag_s)
        bias = self.fit.curve.change(rise + temperature.mean_degc)
        hysteresis = self.fit.hysteresis
        if hysteresis is not None and hysteresis.is_fitted:
            bias += hysteresis.change(rise + temperature.mean_degc)

        def change(time_s: FloatArray) -> FloatArray:
            columns = [np.interp(time_s, grid_s, bias[:, axis]) for axis in range(3)]
            return np.stack(columns, axis=1)

        return subtract_rates(samples, change)

    def completed(self, fit: GyroFit) -> GyroFit:
        """Return a fit to the changed data with the curve, and the bias at its reference."""
        fit = _with_bias(fit, self.fit.value, self.fit.std(np.array([self.fit.reference_degc]))[0])
        return replace(fit, temperature=self.fit, terms=(*fit.terms, _thermal_bias().cause))

    def explained(self, explanation: BoardExplanation) -> BoardExplanation:
        """Return the findings of the changed data, with the curve as a named cause."""
        findings = explanation.findings
        findings = replace(
            findings,
            causes=(self.named(), *findings.causes),
            verdict="explained" if findings.verdict == "adequate" else findings.verdict,
        )
        series = explanation.report_series
        if series is not None:
            effect = self.fit.curve.change(series.temperature_degc)
            effects = {figure_key(cause): effect for cause in findings.causes[:1]}
            series = replace(
                series,
                measured_rad_s=series.measured_rad_s + effect,
                extended_rad_s=series.extended_rad_s + effect,
                effects={**effects, **series.effects},
            )
        return replace(explanation, findings=findings, temperature=self, report_series=series)

    def named(self, tests: int = 1) -> NamedCause:
        """Return the finding `thermal_bias`.

        Args:
            tests: the number of tests that share the false-alarm probability.
        """
        cubic, _ = self.fit.curve.as_cubic()
        order = len(cubic.coefficients)
        std = np.sqrt(np.clip(np.diagonal(self.fit.covariance, axis1=1, axis2=2), 0.0, None)).T
        acting = np.any(np.abs(cubic.coefficients) > ACTING_SIGMA * std[:order], axis=0)
        p_value = chi2_upper_tail(self.fit.statistic, 3 * self.fit.basis.size)
        named = name_outside_fit(
            _thermal_bias().with_order(order),
            np.append(cubic.coefficients.ravel(), self.fit.lag_s),
            np.append(std[:order].ravel(), self.fit.lag_std_s),
            tuple(axis for axis, acts in zip("xyz", acting, strict=True) if acts) or ("x",),
            statistic=self.fit.statistic,
            degrees_of_freedom=3 * self.fit.basis.size,
            p_value=min(1.0, tests * p_value),
        )
        return replace(named, changes=self._changes())

    def _changes(self) -> tuple[CalibrationChange, ...]:
        """Return the biases of a constant bias, and those at the reference temperature."""
        fit = self.fit
        mean = np.mean(
            np.concatenate([fit.curve.change(t.degc) for t in self.temperatures]),
            axis=0,
        )
        std = fit.std(np.array([fit.reference_degc]))[0]
        return tuple(
            CalibrationChange(f"bias.{axis}", float(v + m), float(v), float(s), "rad/s")
            for axis, v, m, s in zip("xyz", fit.value, mean, std, strict=True)
        )


def with_bias_change(fit: GyroFit, windows: RestWindows | None) -> GyroFit:
    """Return a fit whose uncertainty of the bias includes the change during the recordings."""
    if windows is None or not windows.change.is_significant.any():
        return fit
    change = windows.change.std
    std = np.array([fit.std[f"bias.{axis}"] for axis in "xyz"])
    text = ", ".join(format_short(value) for value in np.degrees(change))
    fit = _with_bias(fit, fit.bias_rad_s, np.hypot(std, change))
    return replace(fit, warnings=(*fit.warnings, CHANGE_REMARK.format(text)))


def with_unfitted_temperature(fit: GyroFit, curve: RestTemperature | None) -> GyroFit:
    """Return a fit with a constant bias, with a reason if the bias follows the temperature."""
    if curve is None:
        return fit
    degc = np.linspace(*curve.fit.range_degc, 50)
    span = np.ptp(curve.fit.curve.change(degc), axis=0)
    reason = FOLLOWS_REASON.format(f"by up to {format_short(float(np.degrees(span.max())))} deg/s")
    return replace(fit, limited_reasons=(*fit.limited_reasons, reason))


def _with_bias(fit: GyroFit, value: FloatArray, std: FloatArray) -> GyroFit:
    """Return a fit with other values and standard uncertainties of the bias."""
    covariance, stds = fit.covariance.copy(), dict(fit.std)
    for axis, name in enumerate(("bias.x", "bias.y", "bias.z")):
        stds[name] = float(std[axis])
        if name in fit.order:
            k = fit.order.index(name)
            covariance[k, k] = std[axis] ** 2
    return replace(fit, bias_rad_s=value.copy(), std=stds, covariance=covariance)


def _thermal_bias() -> Term:
    """Return the cause of the catalogue that is a polynomial of the temperature."""
    return next(term for term in catalogue().values() if term.polynomial_orders)


def _temperature(samples: GyroSamples) -> BoardTemperature | None:
    readings = samples.temperature_degc
    if readings is None:
        return None
    temperature = BoardTemperature.of(samples.time_s, readings)
    return None if temperature is None else temperature.smoothed(SMOOTHING_S)
