"""Texts of a twin check: verdict, errors of the simulation, and plain values for JSON.

What to use when: `summarise` for the terminal, `to_plain` for `--json`; `differences` for the
errors of a simulation.
"""

from collections.abc import Sequence
from typing import Any

from gyrorig_protocol.twin import Scalar, Twin
from gyrorig_solver.model import cause_display_unit, cause_equation, format_quantity, plural
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.twin_check.feature_comparison import FamilyComparison
from gyrorig_solver.twin_check.gain_wording import (
    cause_texts,
    manager_text,
    noise_rms,
    number_text,
    residual_rms,
)
from gyrorig_solver.twin_check.recording_check import BoardCheck, StageCheck
from gyrorig_solver.twin_check.twin_folder_check import TwinCheck

TWIN_ALONE = "twin without its causes"
MAX_SHOWN_EFFECTS = 3  # of those without a known cause; the JSON output lists all
EXPLAINABLE_SHARE = 0.2  # rms in units of the noise; below it, a share is not informative
MIN_COMPARED_SHARE = 0.95  # of a recording; below it, the check states what it compared
FALSE_ALARM = 0.01  # probability for one board in one recording, all statistics together


FITTED_NOTE = (
    "The twin was fitted to this recording, so the p-values are too large. Check a new recording "
    "to test the twin."
)


def tested(stage: StageCheck) -> list[FamilyComparison]:
    """Return the comparisons that can differ: that of rare events has only the rank."""
    return [
        comparison for comparison in stage.comparisons if not comparison.family.is_of_rare_events
    ]


def level(stage: StageCheck) -> float:
    """Return the limit of a p-value (Bonferroni); the density also counts as one statistic."""
    return FALSE_ALARM / (len(tested(stage)) + 1)


def differences(stage: StageCheck) -> list[FamilyComparison]:
    """Return the significant differences, the largest first."""
    different = [comparison for comparison in tested(stage) if comparison.p_value < level(stage)]
    return sorted(different, key=lambda comparison: -comparison.distance)


def is_different(stage: StageCheck) -> bool:
    """Return whether a statistic or the density differs."""
    return bool(differences(stage)) or stage.density_p_value < level(stage)


def difference_text(comparison: FamilyComparison) -> str:
    """Return one difference in plain words."""
    family, row = comparison.family, comparison.worst
    axis = f", axis {family.axis[row]}" if family.axis[row] else ""
    return (
        f"{family.title}: {number_text(comparison.size)} {family.unit} rms; largest at "
        f"{family.covariate} = {number_text(float(family.x[row]))}{axis}: measured "
        f"{number_text(float(family.values[row]))}, simulated "
        f"{number_text(float(comparison.mean[row]))} ± "
        f"{number_text(float(comparison.std[row]))} {family.unit}"
    )


def cause_views(twin: Twin) -> list[dict[str, str]]:
    """Return title, equation and fitted values of each cause."""
    return [
        {
            "title": title,
            "equation": cause_equation(cause.cause),
            "fitted_values": ", ".join(
                f"{name} {_scalar_text(cause.cause, name, value)}"
                for name, value in cause.parameters.items()
            ),
        }
        for title, cause in zip(cause_texts(twin), twin.causes, strict=True)
    ]


def _scalar_text(cause: str, name: str, value: Scalar) -> str:
    factor, unit = cause_display_unit(cause, name.partition(".")[0], value.unit)
    if not value.std:
        return f"{number_text(value.value * factor)} {unit}".strip()
    text, std = format_quantity(value.value * factor, value.std * factor)
    return f"{text.removeprefix('+')} ± {std} {unit}".strip()


def residual_share_text(board: BoardCheck) -> str:
    """Return the share of the residual without noise that the twin explains; empty if unknown."""
    noise = noise_rms(board.after)
    parts = []
    for stage, name in ((board.before, "default simulation"), (board.without_causes, TWIN_ALONE)):
        if stage is None:
            continue
        explainable = residual_rms(stage) ** 2 - noise**2
        if explainable <= (EXPLAINABLE_SHARE * noise) ** 2:
            continue
        explained = residual_rms(stage) ** 2 - residual_rms(board.after) ** 2
        parts.append(f"{100.0 * explained / explainable:.2f} % of the {name}'s")
    if not parts:
        return ""
    return (
        f"Of the mean square of the residual that is not noise, the twin explains "
        f"{' and '.join(parts)}."
    )


def verdict_text(board: BoardCheck) -> str:
    """Return the verdict; it never claims that the simulation is complete."""
    count = len(tested(board.after)) + 1
    if not is_different(board.after):
        text = (
            f"No difference found in {count} statistics. Differences smaller than their scatter "
            "cannot be seen."
        )
        text += compared_text(board)
        return text if board.is_held_out else f"{text} {FITTED_NOTE}"
    different = len(differences(board.after)) + (board.after.density_p_value < level(board.after))
    return (
        f"The twin differs from the measurement in {different} of {count} statistics."
        f"{compared_text(board)}"
    )


def compared_text(board: BoardCheck) -> str:
    """Return how much of a recording with gaps was compared; empty if it was all of it."""
    time_s = board.session.samples.time_s
    whole_s = float(time_s[-1] - time_s[0])
    if board.session.duration_s > MIN_COMPARED_SHARE * whole_s:
        return ""
    return (
        f" The check compared {board.session.duration_s:.1f} of {whole_s:.1f} s: the longest part "
        "without a gap of the samples."
    )


def failure_texts(check: TwinCheck) -> list[str]:
    """Return what could not be checked, and why."""
    return [
        f"{name if board is None else f'{board} in {name}'}: {fault}"
        for name, board, fault in check.failed
    ]


def unexplained_text(twin: Twin, board: str) -> str:
    """Return the effects that the twin lacks because no cause explained them; empty without any."""
    effects = twin.boards[board].unexplained
    if not effects:
        return ""
    shown = "; ".join(effects[:MAX_SHOWN_EFFECTS])
    others = len(effects) - MAX_SHOWN_EFFECTS
    more = f"; and {plural(others, 'more effect')}" if others > 0 else ""
    return (
        f"In the recordings of the twin, a part of the residual depends {shown}{more}. No known "
        "cause explains it, and the twin does not contain it."
    )


def random_cause_text(twin: Twin, board: str) -> str:
    """Return what the check cannot see because of random causes of the twin; empty without any.

    A random cause makes the draws differ. If it is named in place of another effect, the draws can
    differ from each other as much as from the measurement.
    """
    texts = [
        f"{cause.cause} ({cause.where}): the check cannot see {similar}"
        for cause in twin.causes
        if cause.board in (None, board) and (similar := _similar_in_draws(cause.cause))
    ]
    if not texts:
        return ""
    return f"The draws of the twin differ by the random cause {'; and '.join(texts)}."


def _similar_in_draws(cause: str) -> str:
    term = catalogue().get(cause)
    return "" if term is None else term.similar_in_draws


def single_event_text(twin: Twin, board: str, is_held_out: bool) -> str:
    """Return the causes of the twin that a recording does not repeat; empty if none."""
    events = [
        f"{cause.cause} in {cause.recording}"
        for cause in twin.causes
        if cause.recording is not None and cause.board in (None, board)
    ]
    if not is_held_out or not events:
        return ""
    return f"Single events of the fitted recordings are not repeated: {', '.join(events)}."


def lack_texts(twin: Twin, board: str, is_held_out: bool) -> list[str]:
    """Return what the simulation lacks, or may lack without a difference in the check."""
    texts = (
        unexplained_text(twin, board),
        single_event_text(twin, board, is_held_out),
        random_cause_text(twin, board),
    )
    return [text for text in texts if text]


def summarise(check: TwinCheck) -> str:
    """Return the lines for the terminal."""
    lines = [manager_text(check)]
    # The recordings that test the twin come first.
    for board in sorted(check.boards, key=lambda board: not board.is_held_out):
        kind = "not used for the fit" if board.is_held_out else "used for the fit"
        lines += ["", f"{board.board} in {board.recording} ({kind})"]
        lines.append(
            f"  log predictive density, nats/s   before {board.before.nats_per_s:.2f}   "
            f"{_without_causes_text(board)}after {board.after.nats_per_s:.2f}   noise alone "
            f"{board.after.ceiling_nats_per_s:.2f}   p {board.after.density_p_value:.2g}"
        )
        lines.append(f"  {verdict_text(board)}")
        lines += [f"    {difference_text(comparison)}" for comparison in differences(board.after)]
        lines += [f"  {text}" for text in lack_texts(check.twin, board.board, board.is_held_out)]
    return "\n".join(lines)


def _without_causes_text(board: BoardCheck) -> str:
    stage = board.without_causes
    return "" if stage is None else f"without causes {stage.nats_per_s:.2f}   "


def to_plain(check: TwinCheck) -> dict[str, Any]:
    """Return the result as plain values."""
    return {
        "schema": "gyrorig/twin-check/1",
        "draws": check.draws,
        "causes": [{"cause": cause.cause, "where": cause.where} for cause in check.twin.causes],
        "boards": [
            {
                **_board_plain(board),
                "unexplained": list(check.twin.boards[board.board].unexplained),
                "not_visible": random_cause_text(check.twin, board.board),
                "not_repeated": single_event_text(check.twin, board.board, board.is_held_out),
            }
            for board in check.boards
        ],
        "failed": [
            {"recording": name, "board": board, "error": str(fault)}
            for name, board, fault in check.failed
        ],
    }


def _board_plain(board: BoardCheck) -> dict[str, Any]:
    return {
        "board": board.board,
        "recording": board.recording,
        "sha256": board.sha256,
        "held_out": board.is_held_out,
        "different": is_different(board.after),
        "gain_nats_per_s": board.gain_nats_per_s if board.is_held_out else None,
        "recovered_share": board.recovered_share if board.is_held_out else None,
        **_parts_plain(board),
        "before": _stage_plain(board.before),
        "without_causes": None
        if board.without_causes is None
        else _stage_plain(board.without_causes),
        "after": _stage_plain(board.after),
    }


def _parts_plain(board: BoardCheck) -> dict[str, Any]:
    """Return the parts of the gain; None for a recording that was used for the fit."""
    share = board.cause_share if board.is_held_out else None
    return {
        "calibration_gain_nats_per_s": board.calibration_gain_nats_per_s
        if board.is_held_out
        else None,
        "cause_gain_nats_per_s": board.cause_gain_nats_per_s if board.is_held_out else None,
        "cause_share": None if share is None else share[0],
        "cause_share_std": None if share is None else share[1],
    }


def _stage_plain(stage: StageCheck) -> dict[str, Any]:
    return {
        "log_density_nats_per_s": stage.nats_per_s,
        "noise_alone_nats_per_s": stage.ceiling_nats_per_s,
        "noise_alone_std_nats_per_s": stage.ceiling_std_nats_per_s,
        "draws_nats_per_s": stage.draws_nats_per_s.tolist(),
        "p_value": stage.density_p_value,
        "residual_rms_deg_s": residual_rms(stage),
        "statistics": [_comparison_plain(comparison, stage) for comparison in stage.comparisons],
        "differences": [difference_text(comparison) for comparison in differences(stage)],
    }


def _comparison_plain(comparison: FamilyComparison, stage: StageCheck) -> dict[str, Any]:
    return {
        "key": comparison.family.key,
        "title": comparison.family.title,
        "distance": comparison.distance,
        "p_value": comparison.p_value,
        "different": comparison in differences(stage),
        "size": comparison.size,
        "unit": comparison.family.unit,
    }


def p_text(p_value: float) -> str:
    """Return a p-value for a table."""
    return "< 1e-6" if p_value < 1e-6 else f"{p_value:.2g}"


def by_key(comparisons: Sequence[FamilyComparison]) -> dict[str, FamilyComparison]:
    """Return comparisons by the key of their family."""
    return {comparison.family.key: comparison for comparison in comparisons}
