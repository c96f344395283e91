"""Which causes beyond the base model a solve takes in, and what it says of those it does not.

Known ones (the Earth's rotation) are taken where the recording says enough. Asked-for ones
are fitted where the recordings can carry them. A temperature polynomial has the order that
windows left out bear, and none below 10 K.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.extension import Extension, fitted, known
from gyrorig_solver.estimate.likelihood import solve_likelihood
from gyrorig_solver.estimate.series import build_series
from gyrorig_solver.estimate.session import SessionFit
from gyrorig_solver.estimate.thermal_order import LEAST_SPAN_K, choose_order
from gyrorig_solver.model.terms.bound import bound
from gyrorig_solver.model.terms.catalogue import term
from gyrorig_solver.model.terms.earth_rotation import earth_in_base
from gyrorig_solver.model.terms.scene import Setting
from gyrorig_solver.model.terms.thermal_bias import ThermalBias
from gyrorig_solver.reference.motion import ReferenceMotion
from gyrorig_solver.samples import GyroSamples
from gyrorig_solver.setting import settings_of

Found = Sequence[tuple[Recording, GyroSamples, ReferenceMotion]]
THERMAL = ("thermal_bias", "thermal_scale")
WINDOW_S = 5.0
LAGS_S = (0.0, -15.0, 15.0, -30.0, 30.0, -60.0, 60.0)  # of the die, or of the thermometer


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """The causes that take part, and words for those that do not."""

    extensions: tuple[Extension, ...] = ()
    settings: tuple[Setting, ...] = ()
    remarks: tuple[str, ...] = ()
    words: dict[str, str] = field(default_factory=dict)  # of values that stay hidden


def choose_extensions(
    found: Found, extend: Sequence[str], named: Sequence[Extension] = ()
) -> Chosen:
    """Return the causes to take into a fit of one board.

    Args:
        found: its recordings with samples and references.
        extend: ids of the catalogue that were asked for.
        named: causes as a search named them.

    Raises:
        UsageError: an id is not known, or no fit can show that cause.
        InputError: the metadata say what cannot be.
    """
    for cause in extend:
        _check(cause)
    there = {one.term.cause for one in named}
    wanted = tuple(dict.fromkeys(c for c in extend if term(c).kind != "known" and c not in there))
    placed = any("latitude_deg" in r.metadata.get("gyrorig.site", {}) for r, _, _ in found)
    if not wanted and not named and not placed:
        return Chosen()
    settings = settings_of(found)
    extensions: list[Extension] = []
    remarks: list[str] = []
    if all(earth_in_base(setting.site) is not None for setting in settings):
        extensions.append(known(term("earth_rotation")))
    elif placed:
        remarks.append(
            "the Earth's rotation is not taken out: the site says no heading; give heading_deg"
        )
    words: dict[str, str] = {}
    for one in named:
        extensions.append(one)
        words |= dict.fromkeys(one.names, one.term.excitation)
    for cause in wanted:
        extension, why = _one(cause, found, settings)
        if extension is None:
            remarks.append(f"{cause} was not fitted: {why}")
            continue
        remarks += [f"{cause}: {why}"] if why else []
        for one in _in_each(extension, len(found)):
            extensions.append(one)
            words |= dict.fromkeys(one.names, one.term.excitation)
    return Chosen(tuple(extensions), tuple(settings), tuple(remarks), words)


def _in_each(extension: Extension, recordings: int) -> list[Extension]:
    """Return a cause as it is, or one for each recording where it is a recording's."""
    if recordings == 1 or extension.term.scope != "recording":
        return [extension]
    return [replace(extension, term=bound(extension.term, k)) for k in range(recordings)]


def _check(cause: str) -> None:
    found = term(cause)
    if found.kind == "gauge":
        raise UsageError(
            f"{cause} is absorbed by the base parameters whole, so no motion shows it",
            f"leave it out; what tells it apart: {found.excitation}",
        )
    if found.kind not in ("effect", "known"):
        raise UsageError(
            f"{cause} cannot be fitted to the rates",
            f"leave it out; `gyrorig explain` looks for it, and what shows it: {found.excitation}",
        )
    if any(p.role != "size" for p in found.parameters) and cause not in THERMAL:
        raise UsageError(
            f"{cause} has a shape that has to be searched for",
            "`--extend auto` does that, and `gyrorig explain`",
        )


def _one(cause: str, found: Found, settings: Sequence[Setting]) -> tuple[Extension | None, str]:
    """Return a cause ready to be fitted, or None and why not, with the remedy."""
    if cause in THERMAL:
        readings = [s.temperature.degc for s in settings if s.temperature is not None]
        if len(readings) < len(settings):
            return None, "a recording has no temperature; record the board's thermometer"
        span_k = float(np.ptp(np.concatenate(readings)))
        if span_k < LEAST_SPAN_K:
            return None, (
                f"the temperature changed by {span_k:.1f} K only, and below {LEAST_SPAN_K:.0f} K "
                "a polynomial tells of the noise; warm the board and record again"
            )
        if cause == "thermal_bias":
            return _thermal_bias(found, settings)
    return fitted(term(cause)), ""


def _thermal_bias(found: Found, settings: Sequence[Setting]) -> tuple[Extension | None, str]:
    """Choose the order by windows of the base fit's residual that were left out."""
    sessions = []
    for (_, samples, reference), setting in zip(found, settings, strict=True):
        series, sampling = build_series(samples, reference.common_std_s)
        sessions.append(SessionFit(series, sampling, reference, 0.0, setting))
    solution = solve_likelihood(sessions)
    lowest = np.array([1.0 / WINDOW_S])
    density = np.max([noise.density(lowest)[0] for noise in solution.noises], axis=0)
    std = np.sqrt(density / (2.0 * WINDOW_S))
    looks = []
    for lag_s in LAGS_S:
        windows = [
            _windows(session, setting, solution.gain, lag_s)
            for session, setting in zip(solution.sessions, settings, strict=True)
        ]
        warmth, left = (np.concatenate(part) for part in zip(*windows, strict=True))
        looks.append(warmth)
    choice = choose_order(looks, left, std)
    lag_s = LAGS_S[choice.look]
    if choice.order == 0:
        return None, (
            f"over {choice.span_k:.1f} K windows left out are predicted no better with it"
        )
    extension = fitted(ThermalBias(choice.order))
    extension.values[-1] = lag_s
    late = f", lag {lag_s:+.0f} s" if lag_s else ""
    return extension, f"order {choice.order}{late} over {choice.span_k:.1f} K, by windows left out"


def _windows(
    session: SessionFit, setting: Setting, gain: FloatArray, lag_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the die's temperature and residual means of windows of one recording."""
    length = max(1, round(WINDOW_S * session.sampling.rate_hz))
    warmth, left = [], []
    for series, residual, used in zip(
        session.series, session.residuals(gain), session.used, strict=True
    ):
        many = residual.shape[0] // length
        whole = slice(0, many * length)
        count = used[whole].reshape(many, length).sum(axis=1)
        mean = residual[whole].reshape(many, length, 3).sum(axis=1) / np.maximum(count, 1)[:, None]
        time_s = series.block_times_s()[whole].reshape(many, length).mean(axis=1)
        keep = count > length // 2
        temperature = setting.temperature
        rise = np.zeros(many) if temperature is None else temperature.at(time_s, lag_s)
        warmth.append(rise[keep])
        left.append(mean[keep] + session.bias_rad_s)
    return np.concatenate(warmth), np.concatenate(left)
