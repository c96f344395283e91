"""View of the explain report: its texts, table rows and figures."""

from collections.abc import Mapping, Sequence
from typing import Any

from gyrorig_solver.calibration import cause_of_parameter
from gyrorig_solver.discover import FALSE_ALARM_RATE
from gyrorig_solver.findings import (
    UNEXPLAINED_FIGURE,
    CauseEntry,
    FindingsDocument,
    amount_text,
    cause_title,
    figure_key_at,
    next_experiment_lines,
    place_text,
)
from gyrorig_solver.findings.findings_document import ChangeEntry, GainEntry
from gyrorig_solver.findings.findings_wording import (
    cause_headline,
    deg_per_s_text,
    lower_title,
    named_causes_text,
    p_value_text,
    parameter_bias_sigma,
    parameter_changes,
    size_text,
    verdict_words,
)
from gyrorig_solver.model import (
    DEG_PER_RAD,
    cause_display_unit,
    cause_equation,
    format_quantity,
    format_short,
    group_of,
    plural,
)
from gyrorig_solver.model.catalogue import catalogue

MIN_SHIFT_SIGMA, MIN_ROWS = 0.3, 2  # smaller changes of parameters are shown in two rows only
TONES = {"adequate": "good", "explained": "limited", "unexplained": "refused"}
SURE_POSTERIOR, SMALL_POSTERIOR = 0.999, 0.001
DEPENDENCE_CAPTIONS = {
    "own_rate": "Mean residual against the rate about the same axis. A curve suggests a "
    "scale-factor non-linearity.",
    "pan": "Residual divided by pan rate, against pan. A wave suggests the gears or the "
    "misalignment.",
    "tilt": "Residual divided by pan rate, against tilt. A trend suggests axes that are not "
    "perpendicular, or payload sag.",
    "time": "Delay of the samples against time. A trend or a step suggests the clocks.",
    "temperature": "Mean residual against temperature. A trend suggests a thermal bias.",
}


def findings_view(document: FindingsDocument, figures: Mapping[str, str]) -> dict[str, Any]:
    """Return the texts, rows and figures for the template."""
    heading, text = verdict_words(document)
    return {
        "board": document.board.id,
        "sensor": document.board.sensor or "unknown sensor",
        "created": document.created,
        "software": document.software,
        "tone": TONES[document.verdict],
        "verdict_title": heading + named_causes_text(document),
        "verdict_text": text,
        "summaries": _summaries(document),
        "tiles": _tiles(document),
        "causes": [_cause_view(document, cause, figures) for cause in document.causes],
        "rest": _unexplained_view(document, figures),
        "left": figures.get("left", ""),
        "two_models": any(cause.harm_sigma is not None for cause in document.causes),
        "density": figures.get("density", ""),
        "on_what": [
            {"svg": figures[f"on-{name}"], "words": words}
            for name, words in DEPENDENCE_CAPTIONS.items()
            if f"on-{name}" in figures
        ],
        "unseen": [_undetected_row(entry) for entry in document.minimal_detectable],
        "unseen_title": "Detection limits of "
        + plural(len(document.minimal_detectable), "cause and axis", "causes and axes"),
        "false_alarms": f"{100.0 * FALSE_ALARM_RATE:g} %",
        "hidden": _untestable_rows(document),
        "hidden_title": plural(len({entry.cause for entry in document.not_testable}), "cause"),
        "raw": document.raw,
        "many": len(document.recording) > 1,
        "changes": _change_rows(document.effect_on_calibration),
        "gain_how": document.gain.how if document.gain else "",
        "elsewhere": _gain_text(document.elsewhere),
        "base": _base_model_text(document),
        "remarks": document.remarks,
        "next_program": _next_program_view(document),
        "recordings": document.recording,
    }


def _next_program_view(document: FindingsDocument) -> dict[str, Any] | None:
    proposed = document.next_experiment
    if proposed is None:
        return None
    return {
        "program": proposed.program,
        "seconds": "" if proposed.seconds is None else f"{proposed.seconds:.0f}",
        "sentences": next_experiment_lines(document),
    }


def _summaries(document: FindingsDocument) -> list[dict[str, str]]:
    """Return every cause, and the unexplained residual, in a few lines each."""
    summaries = [_summary(document, cause) for cause in document.causes]
    unexplained = document.unexplained
    if unexplained is not None:
        p_value = unexplained.p_value
        summaries.append(
            {
                "name": "Unexplained part of the residual",
                "effect": (
                    f"This part depends {unexplained.best_covariate}. {unexplained.harm}"
                ).strip(),
                "remedy": "",
                "confidence": "" if p_value is None else p_value_text(p_value),
            }
        )
    return summaries


def _summary(document: FindingsDocument, cause: CauseEntry) -> dict[str, str]:
    """Return one cause in a few lines: effect on the result, remedy, confidence."""
    confidence = []
    if cause.evidence.p_value is not None:
        confidence.append(p_value_text(cause.evidence.p_value))
    posterior = cause.evidence.posterior
    if posterior is not None:
        confidence.append(f"posterior probability {_probability_text(posterior)}")
    if cause.one_of:
        confidence.append(f"could also be: {', or '.join(map(lower_title, cause.one_of))}")
    return {
        "name": cause_headline(cause),
        "effect": _effect_text(document, cause),
        "remedy": cause.remedy[:1].upper() + cause.remedy[1:],
        "confidence": "; ".join(confidence),
    }


def _effect_text(document: FindingsDocument, cause: CauseEntry) -> str:
    """Return how much the calibration is wrong if a cause is ignored."""
    bias_sigma = parameter_bias_sigma(document, cause)
    if bias_sigma is None:
        term = catalogue().get(cause.cause)
        return "" if term is None else _sentence(term.effect_if_ignored)
    changes = parameter_changes(document, cause)
    name = f" ({max(changes, key=lambda change: change.sigma).parameter})" if changes else ""
    return (
        "Without this cause in the fit, the calibration is wrong by up to "
        f"{format_short(bias_sigma)} standard uncertainties{name}."
    )


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".") + "." if text else ""


def _tiles(document: FindingsDocument) -> list[dict[str, str]]:
    gain, tiles = document.gain, []
    if gain is not None:
        before, after = gain.residual_rms_before, gain.residual_rms_after
        if before is not None and after is not None:
            tiles.append(
                _tile(
                    "residual on held-out data",
                    f"{deg_per_s_text(before)} →",
                    deg_per_s_text(after),
                    "deg/s rms",
                )
            )
        if gain.turn_error_before is not None and gain.turn_error_after is not None:
            tiles.append(
                _tile(
                    "angle error on held-out data",
                    f"{format_short(DEG_PER_RAD * gain.turn_error_before)} →",
                    format_short(DEG_PER_RAD * gain.turn_error_after),
                    "deg, rms over moves",
                )
            )
        tiles += _gain_tile("log-likelihood ratio, held-out data", gain)
    if len(document.causes) > 1 and document.effect_on_calibration:
        largest_change = max(document.effect_on_calibration, key=lambda change: change.sigma)
        if largest_change.sigma > 0.0:
            tiles.append(
                _tile(
                    "largest change of a parameter",
                    "",
                    f"{format_short(largest_change.sigma)} u",
                    f"{largest_change.parameter}, in standard uncertainties",
                )
            )
    if document.elsewhere is not None:
        tiles += _gain_tile("log-likelihood ratio, other recording", document.elsewhere)
    return tiles


def _gain_tile(name: str, gain: GainEntry) -> list[dict[str, str]]:
    if gain.held_out_log_likelihood is None:
        return []
    return [_tile(name, "", f"{_nats_text(gain)} nats", _interval_text(gain))]


def _tile(name: str, before: str, value: str, note: str) -> dict[str, str]:
    return {"name": name, "before": before, "value": value, "note": note}


def _cause_view(
    document: FindingsDocument, cause: CauseEntry, figures: Mapping[str, str]
) -> dict[str, Any]:
    components = () if cause.where == "all" else tuple(cause.where.split(", "))
    names = [entry.name for entry in document.recording]
    number = names.index(cause.recording) + 1 if cause.recording in names else None
    key = figure_key_at(cause.cause, components, number, cause.occurrence)
    p_value = cause.evidence.p_value
    return {
        "title": cause_headline(cause),
        "id": cause.cause,
        "part": cause.part,
        "one_of": [lower_title(other) for other in cause.one_of],
        "equation": cause_equation(cause.cause),
        "seen_as": cause.evidence.seen_as[:1].upper() + cause.evidence.seen_as[1:],
        "sizes": [
            (
                "when" if name == "time" else name,
                size_text(cause.cause, name, size) + _time_reference(name),
            )
            for name, size in cause.parameters.items()
        ],
        "p_value": "" if p_value is None else p_value_text(p_value),
        "remedy": cause.remedy,
        "figure": figures.get(key, ""),
        "compared": _compared_rows(cause),
        "gain": _gain_text(cause.gain),
        "changes": _change_rows(parameter_changes(document, cause)),
    }


def _compared_rows(cause: CauseEntry) -> list[dict[str, str]]:
    """Return the named cause and its rejected alternatives, each with its posterior probability."""
    if not cause.rivals:
        return []
    rows = [
        {
            "name": cause_title(rival.cause),
            "difference": ""
            if rival.delta_log_likelihood is None
            else f"{rival.delta_log_likelihood:+.1f}",
            "reason": rival.reason,
            **_probability_bar(rival.posterior),
        }
        for rival in cause.rivals
    ]
    named = {"name": cause_title(cause.cause), "difference": "0.0", "reason": "named"}
    return [named | _probability_bar(cause.evidence.posterior), *rows]


def _probability_bar(posterior: float | None) -> dict[str, str]:
    """Return a posterior probability in words, and the length of its bar in percent."""
    if posterior is None:
        return {"probability": "", "percent": ""}
    return {"probability": _probability_text(posterior), "percent": f"{100.0 * posterior:.1f}"}


def _probability_text(posterior: float) -> str:
    if posterior > SURE_POSTERIOR:
        return f"above {SURE_POSTERIOR}"
    return f"below {SMALL_POSTERIOR}" if posterior < SMALL_POSTERIOR else f"{posterior:.3g}"


def _time_reference(name: str) -> str:
    return " after the recording's first sample" if name == "time" else ""


def _gain_text(gain: GainEntry | None) -> str:
    if gain is None or gain.held_out_log_likelihood is None:
        return ""
    text = f"{_nats_text(gain)} nats ({_interval_text(gain)})"
    if gain.residual_rms_before is not None and gain.residual_rms_after is not None:
        text += (
            f"; residual {deg_per_s_text(gain.residual_rms_before)} to "
            f"{deg_per_s_text(gain.residual_rms_after)} deg/s rms"
        )
    return text + (f"; {gain.how}" if gain.how else "")


def _nats_text(gain: GainEntry) -> str:
    return f"{gain.held_out_log_likelihood or 0.0:+.1f}"


def _interval_text(gain: GainEntry) -> str:
    if not gain.interval or None in gain.interval:
        return "no interval"
    low, high = gain.interval
    return f"95 %: {low:+.1f} to {high:+.1f}"


def _change_rows(changes: Sequence[ChangeEntry]) -> list[dict[str, str]]:
    rows = []
    for rank, change in enumerate(sorted(changes, key=lambda change: change.sigma, reverse=True)):
        if change.before is None or change.after is None or change.std is None:
            continue
        if rank >= MIN_ROWS and change.sigma < MIN_SHIFT_SIGMA:
            break
        group = group_of(change.parameter)
        if group is not None:
            factor, unit = group.factor, "" if group.unit == "1" else group.unit
        else:
            cause = cause_of_parameter(change.parameter)
            factor, unit = cause_display_unit(cause, "", change.unit)
        before, _ = format_quantity(factor * change.before, factor * change.std)
        after, std = format_quantity(factor * change.after, factor * change.std)
        rows.append(
            {
                "parameter": change.parameter,
                "before": f"{before} {unit}".strip(),
                "after": f"{after} ± {std} {unit}".strip(),
                "sigma": f"{change.sigma:.1f}",
            }
        )
    return rows


def _unexplained_view(
    document: FindingsDocument, figures: Mapping[str, str]
) -> dict[str, Any] | None:
    unexplained = document.unexplained
    if unexplained is None:
        return None
    return {
        "words": f"Part of the residual depends {unexplained.best_covariate}"
        + ("" if unexplained.p_value is None else f" ({p_value_text(unexplained.p_value)})")
        + ".",
        "harm": unexplained.harm,
        "figure": figures.get(UNEXPLAINED_FIGURE, ""),
        "others": [dependence.covariate for dependence in unexplained.others],
    }


def _undetected_row(cause: Any) -> dict[str, str]:
    return {
        "what": cause_title(cause.cause) + place_text(cause.where),
        "id": cause.cause,
        "size": amount_text(cause.cause, cause.size, cause.unit),
        "typical": ""
        if cause.typical is None
        else amount_text(cause.cause, cause.typical, cause.unit),
        "moves": cause.would_move or "no parameter",
        "sigma": "" if cause.by_sigma is None else format_short(cause.by_sigma),
    }


def _untestable_rows(document: FindingsDocument) -> list[dict[str, str]]:
    """Return the reasons why causes cannot be tested, each with all its causes."""
    by_reason: dict[str, list[str]] = {}
    for cause in document.not_testable:
        by_reason.setdefault(cause.reason, []).append(
            cause_title(cause.cause) + place_text(cause.where)
        )
    return [
        {"what": "; ".join(dict.fromkeys(names)), "why": why} for why, names in by_reason.items()
    ]


def _base_model_text(document: FindingsDocument) -> str:
    base = document.base
    text = f"Base model: {', '.join(base.terms)}."
    if base.reduced_chi2 is not None:
        text += f" Reduced chi-square {format_short(base.reduced_chi2)}."
    if base.whiteness_p is not None:
        text += f" The whiteness test of its residual gives {p_value_text(base.whiteness_p)}."
    return text
