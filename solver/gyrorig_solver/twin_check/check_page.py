"""The page "Simulation before / after / measured": one self-contained HTML file.

What to use when: `render_check` for the text of the page, which the caller writes.
"""

from collections.abc import Sequence
from typing import Any

from gyrorig_solver.report.calibration_page import fill_template
from gyrorig_solver.twin_check.check_figures import (
    TIMING,
    draw_close_up,
    draw_family,
    draw_residuals,
    draw_rest_positions,
    draw_timing,
)
from gyrorig_solver.twin_check.check_wording import (
    TWIN_ALONE,
    by_key,
    cause_views,
    difference_text,
    differences,
    failure_texts,
    is_different,
    lack_texts,
    p_text,
    residual_share_text,
    verdict_text,
)
from gyrorig_solver.twin_check.gain_wording import gain_text, manager_text, residual_rms
from gyrorig_solver.twin_check.recording_check import BoardCheck
from gyrorig_solver.twin_check.twin_folder_check import TwinCheck

EDGES = ("start_pan", "start_tilt", "end_pan", "end_tilt")
NOT_DRAWN = (
    "bias", "clock", *TIMING, "stalls", "lost", "speed", "start_delay", "rest_position",
)  # fmt: skip


def render_check(check: TwinCheck) -> str:
    """Return the page as HTML."""
    differs = any(is_different(board.after) for board in check.boards)
    lacks = any(check.twin.boards[board.board].unexplained for board in check.boards)
    headline = "The twin still differs" if differs else "No difference found"
    if lacks and not differs:
        headline = "No difference found, but the twin lacks an effect without a known cause"
    elif check.failed and not differs:
        headline = "No difference found, but not all boards could be checked"
    view = {
        "title": "Simulation before / after / measured",
        "boards": ", ".join(dict.fromkeys(board.board for board in check.boards)),
        "created": check.twin.created,
        "tone": "limited" if differs or lacks or check.failed else "good",
        "headline": headline,
        "manager": manager_text(check),
        "gain": gain_text(check),
        "equations": cause_views(check.twin),
        "sections": [
            _section(board, lack_texts(check.twin, board.board, board.is_held_out))
            for board in sorted(check.boards, key=lambda board: not board.is_held_out)
        ],
        "draws": check.draws,
        "failures": failure_texts(check),
    }
    return fill_template("twin_check.html.j2", view)


def _section(board: BoardCheck, lacks: Sequence[str]) -> dict[str, Any]:
    before = by_key(board.before.comparisons)
    different = differences(board.after)
    rows = [
        {
            "title": comparison.family.title,
            "before": p_text(before[comparison.family.key].p_value)
            if comparison.family.key in before
            else "-",
            "after": p_text(comparison.p_value),
            "size": f"{comparison.size:.2g} {comparison.family.unit}",
            "bad": comparison in different,
        }
        for comparison in board.after.comparisons
    ]
    return {
        "name": f"{board.board} in {board.recording}",
        "kind": "not used for the fit" if board.is_held_out else "used for the fit",
        "verdict": " ".join((verdict_text(board), *lacks)),
        "tiles": [
            ("default simulation", board.before.nats_per_s, residual_rms(board.before)),
            *_calibrated_tile(board),
            ("twin", board.after.nats_per_s, residual_rms(board.after)),
            ("noise alone", board.after.ceiling_nats_per_s, None),
        ],
        "share": None
        if not board.is_held_out or board.recovered_share is None
        else f"{100.0 * board.recovered_share:.2f} %",
        "cause_share": _cause_share_text(board),
        "left": [difference_text(comparison) for comparison in different],
        "rows": rows,
        "residual_share": residual_share_text(board),
        "earlier": "default simulation" if board.without_causes is None else TWIN_ALONE,
        "edges": _edge_figures(board),
        "overlay": draw_close_up(board),
        "residuals": draw_residuals(board),
        "timing": draw_timing(board.after.comparisons),
        "rests": draw_rest_positions(by_key(board.after.comparisons).get("rest_position")),
        "figures": [
            {"svg": draw_family(comparison), "words": comparison.family.title.capitalize()}
            for comparison in board.after.comparisons
            if comparison.family.key not in (*NOT_DRAWN, *EDGES)
        ],
    }


def _edge_figures(board: BoardCheck) -> list[dict[str, str]]:
    """Draw the residual after the starts and ends of moves, of the twin and of the default."""
    earlier = by_key((board.without_causes or board.before).comparisons)
    known = by_key(board.after.comparisons)
    return [
        {
            "svg": draw_family(known[key], earlier.get(key)),
            "words": known[key].family.title.capitalize(),
        }
        for key in EDGES
        if key in known
    ]


def _calibrated_tile(board: BoardCheck) -> list[tuple[str, float, float]]:
    """Return the tile of the twin without its causes, if it has causes."""
    stage = board.without_causes
    return (
        []
        if stage is None
        else [("twin without its causes", stage.nats_per_s, residual_rms(stage))]
    )


def _cause_share_text(board: BoardCheck) -> str | None:
    """Return the share that the causes recover, for a recording that the fit did not use."""
    share = board.cause_share if board.is_held_out else None
    return None if share is None else f"{100.0 * share[0]:.1f} ± {100.0 * share[1]:.1f} %"
