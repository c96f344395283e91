"""From findings to what the explain page says: texts, rows and figures, ready to set."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gyrorig_solver.calibration.wording import quantity, short
from gyrorig_solver.findings.build import UNEXPLAINED, figure_key
from gyrorig_solver.findings.document import Cause, Change, FindingsDocument, Gain
from gyrorig_solver.findings.wording import (
    amount,
    headline,
    place,
    shown,
    size_text,
    title,
    verdict_words,
)
from gyrorig_solver.model.terms.catalogue import catalogue

_DEG = 180.0 / math.pi
FIRST_ROWS = 12  # of what could be there unseen; the rest folds away
WORTH_A_ROW, LEAST_ROWS = 0.3, 2  # standard deviations that a parameter moves by
TONES = {"adequate": "good", "explained": "limited", "unexplained": "refused"}
ON_WHAT = {
    "own_rate": "Mean residual by the axis' own rate, with 95 % bars: is the sensor linear?",
    "pan": "Residual per pan rate along pan: gears, and how the board sits.",
    "tilt": "Residual per pan rate along tilt: the axes, the payload.",
    "time": "How late the samples are, through the recording: the clocks.",
    "temperature": "Mean residual by temperature: the bias.",
}


def view_of(document: FindingsDocument, figures: Mapping[str, str]) -> dict[str, Any]:
    """Return what the template places.

    Args:
        document: the findings.
        figures: SVG texts by key; a key that is not there leaves its figure out.
    """
    heading, text = verdict_words(document)
    return {
        "board": document.board.id,
        "sensor": document.board.sensor or "unknown sensor",
        "created": document.created,
        "software": document.software,
        "tone": TONES[document.verdict],
        "verdict_title": heading,
        "verdict_text": text,
        "points": _points(document),
        "tiles": _tiles(document),
        "causes": [_cause(one, figures) for one in document.causes],
        "rest": _rest(document, figures),
        "left": figures.get("left", ""),
        "two_models": any(one.harm_sigma is not None for one in document.causes),
        "density": figures.get("density", ""),
        "on_what": [
            {"svg": figures[f"on-{name}"], "words": words}
            for name, words in ON_WHAT.items()
            if f"on-{name}" in figures
        ],
        "unseen": [_unseen(one) for one in document.minimal_detectable[:FIRST_ROWS]],
        "unseen_more": [_unseen(one) for one in document.minimal_detectable[FIRST_ROWS:]],
        "hidden": _hidden(document),
        "raw": document.raw,
        "many": len(document.recording) > 1,
        "changes": _changes(document.effect_on_calibration),
        "gain_how": document.gain.how if document.gain else "",
        "elsewhere": _gain_text(document.elsewhere),
        "base": _base(document),
        "remarks": document.remarks,
        "recordings": document.recording,
    }


def _points(document: FindingsDocument) -> list[str]:
    out = []
    for cause in document.causes:
        also = f" (or {', or '.join(map(_lower, cause.one_of))})" if cause.one_of else ""
        text = f"{headline(cause)}{also}."
        out.append(text + (f" At the rig: {cause.remedy}." if cause.remedy else ""))
    if document.unexplained is not None:
        text = f"What is left depends {document.unexplained.best_covariate}."
        out.append(f"{text} {document.unexplained.harm}".strip())
    return out


def _lower(cause: str) -> str:
    words = title(cause)
    return words[0].lower() + words[1:]


def _tiles(document: FindingsDocument) -> list[dict[str, str]]:
    gain, out = document.gain, []
    if gain is not None:
        before, after = gain.residual_rms_before, gain.residual_rms_after
        if before is not None and after is not None:
            out.append(_tile("residual, held out", f"{_dps(before)} →", _dps(after), "deg/s rms"))
        if gain.turn_error_before is not None and gain.turn_error_after is not None:
            out.append(
                _tile(
                    "turn error, held out",
                    f"{short(1e3 * _DEG * gain.turn_error_before)} →",
                    short(1e3 * _DEG * gain.turn_error_after),
                    "mdeg, rms over moves",
                )
            )
        if gain.held_out_log_likelihood is not None:
            out.append(_tile("worth on unseen data", "", f"{_nats(gain)} nats", _interval(gain)))
    if document.effect_on_calibration:
        most = max(document.effect_on_calibration, key=_sigma)
        if _sigma(most) > 0.0:
            out.append(
                _tile(
                    "moves the calibration by",
                    "",
                    f"{short(_sigma(most))} sd",
                    f"most of all {most.parameter}",
                )
            )
    away = document.elsewhere
    if away is not None and away.held_out_log_likelihood is not None:
        out.append(_tile("on another recording", "", f"{_nats(away)} nats", _interval(away)))
    silent = [d for d in document.minimal_detectable if d.by_sigma is not None]
    if silent:
        worst = max(silent, key=lambda d: d.by_sigma or 0.0)
        note = f"too little to show here: {_lower(worst.cause)}{place(worst.where)}"
        out.append(_tile("could be off unseen by", "", f"{short(worst.by_sigma or 0.0)} sd", note))
    return out


def _tile(name: str, before: str, value: str, note: str) -> dict[str, str]:
    return {"name": name, "before": before, "value": value, "note": note}


def _cause(cause: Cause, figures: Mapping[str, str]) -> dict[str, Any]:
    where = () if cause.where == "all" else tuple(cause.where.split(", "))
    key = figure_key(cause.cause, where)
    known = catalogue().get(cause.cause)
    chance = cause.evidence.p_value
    return {
        "title": headline(cause),
        "id": cause.cause,
        "part": cause.part,
        "one_of": [_lower(one) for one in cause.one_of],
        "seen_as": cause.evidence.seen_as[:1].upper() + cause.evidence.seen_as[1:],
        "sizes": [
            ("when" if name == "time" else name, size_text(size) + _since(name))
            for name, size in cause.parameters.items()
        ],
        "chance": "" if chance is None else _chance(chance),
        "statistic": "" if cause.gain is None else short(cause.evidence.statistic or 0.0),
        "remedy": cause.remedy,
        "harm": known.harm if known is not None else "",
        "figure": figures.get(key, ""),
        "rivals": [
            {
                "name": title(one.cause),
                "lost": ""
                if one.delta_log_likelihood is None
                else f"{one.delta_log_likelihood:+.1f}",
                "reason": one.reason,
            }
            for one in cause.rivals
        ],
        "gain": _gain_text(cause.gain),
        "changes": _changes(cause.effect_on_calibration),
    }


def _since(name: str) -> str:
    return " after the recording's first sample" if name == "time" else ""


def _chance(p_value: float) -> str:
    if p_value <= 1e-12:
        return "less than once in a million million recordings"
    return f"once in {short(1.0 / p_value)} recordings" if p_value < 1.0 else "always"


def _gain_text(gain: Gain | None) -> str:
    if gain is None or gain.held_out_log_likelihood is None:
        return ""
    text = f"{_nats(gain)} nats ({_interval(gain)})"
    if gain.residual_rms_before is not None and gain.residual_rms_after is not None:
        text += (
            f"; residual {_dps(gain.residual_rms_before)} to "
            f"{_dps(gain.residual_rms_after)} deg/s rms"
        )
    return text + (f"; {gain.how}" if gain.how else "")


def _nats(gain: Gain) -> str:
    return f"{gain.held_out_log_likelihood or 0.0:+.1f}"


def _interval(gain: Gain) -> str:
    if not gain.interval or None in gain.interval:
        return "no interval"
    low, high = gain.interval
    return f"95 %: {low:+.1f} to {high:+.1f}"


def _changes(changes: Sequence[Change]) -> list[dict[str, str]]:
    out = []
    for rank, one in enumerate(sorted(changes, key=_sigma, reverse=True)):
        if one.before is None or one.after is None or one.std is None:
            continue
        if rank >= LEAST_ROWS and _sigma(one) < WORTH_A_ROW:
            break
        factor, unit = shown(max(abs(one.before), abs(one.after)), one.unit)
        if one.parameter.startswith("scale"):
            factor, unit = 1.0, ""
        before, _ = quantity(factor * one.before, factor * one.std)
        after, std = quantity(factor * one.after, factor * one.std)
        out.append(
            {
                "parameter": one.parameter,
                "before": f"{before} {unit}".strip(),
                "after": f"{after} ± {std} {unit}".strip(),
                "sigma": f"{_sigma(one):.1f}",
            }
        )
    return out


def _sigma(change: Change) -> float:
    if change.before is None or change.after is None or not change.std:
        return 0.0
    return abs(change.after - change.before) / change.std


def _rest(document: FindingsDocument, figures: Mapping[str, str]) -> dict[str, Any] | None:
    rest = document.unexplained
    if rest is None:
        return None
    return {
        "words": f"What is left depends {rest.best_covariate}.",
        "chance": "" if rest.p_value is None else _chance(rest.p_value),
        "harm": rest.harm,
        "figure": figures.get(UNEXPLAINED, ""),
        "others": [one.covariate for one in rest.others],
    }


def _unseen(one: Any) -> dict[str, str]:
    return {
        "what": title(one.cause) + place(one.where),
        "id": one.cause,
        "size": amount(one.size, one.unit),
        "typical": "" if one.typical is None else amount(one.typical, one.unit),
        "moves": one.would_move or "nothing much",
        "sigma": "" if one.by_sigma is None else short(one.by_sigma),
    }


def _hidden(document: FindingsDocument) -> list[dict[str, str]]:
    """Return the reasons why causes cannot be seen, each with all its causes."""
    by_reason: dict[str, list[str]] = {}
    for one in document.not_testable:
        by_reason.setdefault(one.reason, []).append(title(one.cause) + place(one.where))
    return [
        {"what": "; ".join(dict.fromkeys(names)), "why": why} for why, names in by_reason.items()
    ]


def _base(document: FindingsDocument) -> str:
    base = document.base
    text = f"Base model: {', '.join(base.terms)}."
    if base.reduced_chi2 is not None:
        text += f" Its residual is {short(base.reduced_chi2)} times what the noise would leave."
    if base.whiteness_p is not None:
        text += f" Noise alone looks as odd {_chance(base.whiteness_p)}."
    return text


def _dps(value: float) -> str:
    return short(value * _DEG)
