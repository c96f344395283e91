"""Causes beyond the base model that a solve includes, and remarks on those that it does not.

The solve includes known causes (the Earth's rotation) if the recording has the data for them. It
fits requested causes if the recordings can determine them. The order of a temperature polynomial is
chosen with windows that are left out of the fit; below 10 K there is no polynomial.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import FittedTerm, SessionFit, build_series, fit_likelihood, free_term
from gyrorig_solver.estimate.fitted_term import fixed_term
from gyrorig_solver.estimate.thermal_order import MIN_SPAN_K, choose_order
from gyrorig_solver.model import RecordingContext, Term, find_term, form_for, limit_to_recording
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.pipeline.recording_contexts import read_contexts
from gyrorig_solver.reference import ReferenceMotion

LoadedRecordings = Sequence[tuple[Recording, GyroSamples, ReferenceMotion]]
WINDOW_S = 5.0
THERMAL_LAGS_S = (0.0, -15.0, 15.0, -30.0, 30.0, -60.0, 60.0)  # of the die, or of the thermometer


@dataclass(frozen=True, slots=True, eq=False)
class TermSelection:
    """The causes that a solve includes, and remarks on those that it does not."""

    extensions: tuple[FittedTerm, ...] = ()
    contexts: tuple[RecordingContext, ...] = ()
    remarks: tuple[str, ...] = ()
    remedies: dict[str, str] = field(default_factory=dict)  # of values that the motion may not show


def select_terms(
    loaded: LoadedRecordings, extend: Sequence[str], named_terms: Sequence[FittedTerm] = ()
) -> TermSelection:
    """Return the causes to include in a fit of one board.

    Raises:
        UsageError: an id is not known, or no fit can show that cause.
        InputError: the metadata have impossible values.
    """
    check_fittable(extend)
    named_causes = {fitted_term.term.cause for fitted_term in named_terms}
    requested = tuple(
        dict.fromkeys(c for c in extend if find_term(c).kind != "known" and c not in named_causes)
    )
    has_latitude = any("latitude_deg" in r.metadata.get("gyrorig.site", {}) for r, _, _ in loaded)
    if not requested and not named_terms and not has_latitude:
        return TermSelection()
    settings = read_contexts(loaded)
    extensions: list[FittedTerm] = []
    remarks: list[str] = []
    for known_term in (term for term in catalogue().values() if term.kind == "known"):
        if all(known_term.is_known_at(setting.site) for setting in settings):
            extensions.append(fixed_term(known_term))
        elif has_latitude:
            remarks.append(known_term.unknown_site_remark)
    remedies: dict[str, str] = {}
    for fitted_term in named_terms:
        extensions.append(fitted_term)
        remedies |= dict.fromkeys(fitted_term.names, fitted_term.term.excitation)
    for cause in requested:
        extension, reason = _fittable_term(cause, loaded, settings)
        if extension is None:
            remarks.append(f"the cause {cause} was not fitted: {reason}")
            continue
        remarks += [f"{cause}: {reason}"] if reason else []
        for fitted_term in _per_recording(extension, len(loaded)):
            extensions.append(fitted_term)
            remedies |= dict.fromkeys(fitted_term.names, fitted_term.term.excitation)
    return TermSelection(tuple(extensions), tuple(settings), tuple(remarks), remedies)


def _per_recording(extension: FittedTerm, recordings: int) -> list[FittedTerm]:
    """Return a cause as it is, or one for each recording if it is a cause of a recording."""
    if recordings == 1 or extension.term.scope != "recording":
        return [extension]
    return [
        replace(extension, term=limit_to_recording(extension.term, k)) for k in range(recordings)
    ]


def check_fittable(causes: Sequence[str]) -> None:
    """Check that a fit can contain requested causes.

    Raises:
        UsageError: a cause is not known, or no fit can show it.
    """
    for cause in causes:
        _check_cause(cause)


def _check_cause(cause: str) -> None:
    requested_term = find_term(cause)
    if requested_term.kind == "gauge":
        raise UsageError(
            f"the option --extend names {cause}, but the motion cannot separate this error from "
            "the bias, the time offset and the sensor matrix",
            f"remove {cause} from --extend. To detect it, use {requested_term.excitation}",
        )
    if requested_term.kind not in ("effect", "known"):
        raise UsageError(
            f"the option --extend names {cause}, but this error changes only the noise or single "
            "samples, so a fit to the rates cannot estimate it",
            f"remove {cause} from --extend, and search for it with `gyrorig explain`. The search "
            f"needs {requested_term.excitation}",
        )
    if (
        any(p.role != "size" for p in requested_term.parameters)
        and not requested_term.depends_on_temperature
    ):
        raise UsageError(
            f"the solver cannot fit the cause {cause} directly, because it must first search for "
            "the form of this effect",
            "use `--extend auto` or `gyrorig explain`, which search for causes",
        )


def _fittable_term(
    cause: str, loaded: LoadedRecordings, settings: Sequence[RecordingContext]
) -> tuple[FittedTerm | None, str]:
    """Return a cause ready to be fitted, or None and the reason, with the remedy."""
    if find_term(cause).depends_on_temperature:
        readings = [s.temperature.degc for s in settings if s.temperature is not None]
        if len(readings) < len(settings):
            return None, "a recording has no temperature; record the temperature of the board"
        span_k = float(np.ptp(np.concatenate(readings)))
        if span_k < MIN_SPAN_K:
            return None, (
                f"the temperature changed by only {span_k:.1f} K, and a polynomial in temperature "
                f"needs {MIN_SPAN_K:.0f} K; warm the board and record again"
            )
        if find_term(cause).polynomial_orders:
            return _polynomial_term(find_term(cause), loaded, settings)
    has_bandwidth = any(samples.bandwidth_hz is not None for _, samples, _ in loaded)
    return free_term(form_for(find_term(cause), has_bandwidth)), ""


def _polynomial_term(
    term: Term, loaded: LoadedRecordings, settings: Sequence[RecordingContext]
) -> tuple[FittedTerm | None, str]:
    """Choose the order with windows of the base fit's residual that are left out of the fit."""
    sessions = []
    for (_, samples, reference), setting in zip(loaded, settings, strict=True):
        series, sampling = build_series(samples, reference.common_shift_std_s)
        sessions.append(SessionFit(series, sampling, reference, 0.0, setting))
    solution = fit_likelihood(sessions)
    lowest = np.array([1.0 / WINDOW_S])
    density = np.max([noise.density(lowest)[0] for noise in solution.noises], axis=0)
    std = np.sqrt(density / (2.0 * WINDOW_S))
    temperatures = []
    for lag_s in THERMAL_LAGS_S:
        windows = [
            _window_means(session, setting, solution.gain, lag_s)
            for session, setting in zip(solution.sessions, settings, strict=True)
        ]
        temperature, residual = (np.concatenate(part) for part in zip(*windows, strict=True))
        temperatures.append(temperature)
    choice = choose_order(temperatures, residual, std)
    lag_s = THERMAL_LAGS_S[choice.temperature_index]
    if choice.order == 0:
        return None, (
            f"over {choice.span_k:.1f} K, this cause does not improve the prediction of windows "
            "that were left out of the fit"
        )
    extension = free_term(term.with_order(choice.order))
    extension.values[-1] = lag_s
    lag_text = f", lag {lag_s:+.0f} s" if lag_s else ""
    return (
        extension,
        f"order {choice.order}{lag_text} over {choice.span_k:.1f} K, selected with windows that "
        "were left out of the fit",
    )


def _window_means(
    session: SessionFit, setting: RecordingContext, gain: FloatArray, lag_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the die's temperature and residual means of windows of one recording."""
    length = max(1, round(WINDOW_S * session.sampling.rate_hz))
    temperatures, residuals = [], []
    for series, residual, used in zip(
        session.series, session.residuals(gain), session.used, strict=True
    ):
        window_count = residual.shape[0] // length
        whole = slice(0, window_count * length)
        count = used[whole].reshape(window_count, length).sum(axis=1)
        mean = (
            residual[whole].reshape(window_count, length, 3).sum(axis=1)
            / np.maximum(count, 1)[:, None]
        )
        time_s = series.block_times_s()[whole].reshape(window_count, length).mean(axis=1)
        keep = count > length // 2
        temperature = setting.temperature
        temperature_rise = (
            np.zeros(window_count)
            if temperature is None
            else temperature.die_temperature_rise(time_s, lag_s)
        )
        temperatures.append(temperature_rise[keep])
        residuals.append(mean[keep] + session.bias_rad_s)
    return np.concatenate(temperatures), np.concatenate(residuals)
