"""The page "Simulation before / after / measured": one self-contained HTML file.

What to use when: `render_check` for the text of the page, which the caller writes.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.report.calibration_page import fill_template
from gyrorig_solver.report.figure_layout import (
    AXIS_COLOURS,
    BEFORE,
    INK,
    SOFT,
    draw_rates_over_time,
    stacked_panels,
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
from gyrorig_solver.twin_check.feature_comparison import FamilyComparison
from gyrorig_solver.twin_check.gain_wording import gain_text, manager_text, residual_rms
from gyrorig_solver.twin_check.observed_session import AXES
from gyrorig_solver.twin_check.recording_check import BoardCheck
from gyrorig_solver.twin_check.session_features import CLOCK_S, SENSOR_AXES
from gyrorig_solver.twin_check.twin_folder_check import TwinCheck

OVERLAY_S = 3.0  # of a detail view of moves
BAND_SIGMA = 2.0
TIMING = {
    "latency": "latency above the smallest, ms",
    "jitter": "interval of arrivals, ms",
    "answer_time": "answer of the unit, ms",
}
EDGES = ("start_pan", "start_tilt", "end_pan", "end_tilt")
NOT_DRAWN = ("bias", "clock", *TIMING, "stalls", "speed", "start_delay", "rest_position")


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
            _section(board, lack_texts(check.twin, board.board))
            for board in sorted(check.boards, key=lambda board: not board.is_held_out)
        ],
        "draws": check.draws,
        "failures": failure_texts(check),
    }
    return fill_template("twin_check.html.j2", view)


def _section(board: BoardCheck, lacks: Sequence[str]) -> dict[str, Any]:
    before = by_key(board.before.comparisons)
    close_up = _close_up(board)
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
        "overlay": close_up,
        "residuals": draw_rates_over_time(
            board.session.block_time_s,
            [(board.before.residual_rad_s, BEFORE), (board.after.residual_rad_s, None)],
            4.6,
        ),
        "timing": _timing_figure(board.after.comparisons),
        "rests": _rest_figure(by_key(board.after.comparisons).get("rest_position")),
        "figures": [
            {"svg": _family_figure(comparison), "words": comparison.family.title.capitalize()}
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
            "svg": _family_figure(known[key], earlier.get(key)),
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


def _close_up(board: BoardCheck) -> str:
    """Draw the rates in the window in which the default simulation has the largest error."""
    session = board.session
    window = max(2, round(OVERLAY_S * session.sampling.rate_hz))
    error = (board.before.residual_rad_s**2).sum(axis=1)
    moving = np.abs(np.gradient(session.stage_rate_rad_s, axis=0)).sum(axis=1) > 0.0
    summed = np.convolve(error * (1.0 + moving), np.ones(window), mode="valid")
    first = int(np.argmax(summed))
    rows = slice(first, first + window)
    figure, panels = stacked_panels(3, 5.2)
    for axis, panel in enumerate(panels):
        series: tuple[tuple[FloatArray, str, str], ...] = (
            (board.before.predicted_rad_s, BEFORE, "default simulation"),
            (board.after.predicted_rad_s, AXIS_COLOURS[axis], "twin"),
        )
        panel.plot(
            session.block_time_s[rows],
            np.degrees(session.rate_rad_s[rows, axis]),
            colour=INK,
            linewidth=0.0,
            markersize=2.2,
            label="measured",
        )
        for rates, colour, label in series:
            panel.plot(
                session.block_time_s[rows],
                np.degrees(rates[rows, axis]),
                colour=colour,
                linewidth=1.4,
                label=label,
            )
        panel.ylabel = f"{SENSOR_AXES[axis]}  deg/s"
        panel.has_key = axis == 0
    panels[-1].xlabel = "time, s"
    return figure.svg()


def _timing_figure(comparisons: Sequence[FamilyComparison]) -> str:
    """Draw the distributions of latencies, and the changes of the board's clock."""
    known = by_key(comparisons)
    drawn = [key for key in (*TIMING, "clock") if key in known]
    if not drawn:
        return ""
    figure, panels = stacked_panels(len(drawn), 1.5 * len(drawn))
    for key, panel in zip(drawn, panels, strict=True):
        comparison = known[key]
        x, values = comparison.family.x, comparison.family.values
        rows = slice(None)
        if key == "clock":  # the first value is the skew, which is much larger than its changes
            x, rows = np.log10(CLOCK_S[: values.size - 1]), slice(1, None)
            if not x.size:
                continue
        mean, spread = comparison.mean[rows], BAND_SIGMA * comparison.std[rows]
        panel.band(x, mean - spread, mean + spread, colour="var(--band)")
        panel.plot(x, mean, colour=SOFT, linewidth=1.0, linestyle="--", label="twin")
        panel.plot(x, values[rows], colour=INK, linewidth=0.0, markersize=5.0, label="measured")
        panel.ylabel = TIMING.get(key, "change of the clock, ppm")
        panel.xlabel = "log10 of the time between changes, s" if key == "clock" else "quantile"
        panel.has_key = key == drawn[0]
    return figure.svg()


def _rest_figure(comparison: FamilyComparison | None) -> str:
    """Draw the rest positions of the unit minus the commanded ones, over the draws of the twin."""
    if comparison is None:
        return ""
    family = comparison.family
    figure, panels = stacked_panels(len(AXES), 3.0)
    for name, panel in zip(AXES, panels, strict=True):
        rows = np.flatnonzero(
            [axis == name for axis in family.axis]
            & np.isfinite(family.values)
            & np.isfinite(comparison.mean)
        )
        x, mean = family.x[rows], comparison.mean[rows]
        spread = BAND_SIGMA * comparison.std[rows]
        panel.band(x, mean - spread, mean + spread, colour="var(--band)")
        panel.plot(x, mean, colour=SOFT, linewidth=1.0, linestyle="--", label="twin")
        panel.plot(
            x, family.values[rows], colour=INK, linewidth=0.0, markersize=4.0, label="measured"
        )
        panel.ylabel = f"{name}  {family.unit}"
        panel.has_key = name == AXES[0]
    panels[-1].xlabel = family.covariate
    return figure.svg()


def _family_figure(comparison: FamilyComparison, earlier: FamilyComparison | None = None) -> str:
    """Draw the measured features over the band of the twin's draws.

    Args:
        comparison: with the draws of the twin.
        earlier: the same of an earlier simulation, to show what the twin has changed.
    """
    family = comparison.family
    figure, panels = stacked_panels(3, 4.2)
    for axis, panel in enumerate(panels):
        rows = np.flatnonzero(
            [name == SENSOR_AXES[axis] for name in family.axis]
            & np.isfinite(family.values)
            & np.isfinite(comparison.mean)
        )
        x = family.x[rows]
        scale = np.log10(x) if family.key in ("spectrum", "allan") else x
        mean, spread = comparison.mean[rows], BAND_SIGMA * comparison.std[rows]
        panel.band(scale, mean - spread, mean + spread, colour="var(--band)")
        panel.plot(scale, mean, colour=SOFT, linewidth=1.0, linestyle="--", label="twin")
        if earlier is not None and earlier.family.values.shape == family.values.shape:
            panel.plot(
                scale,
                earlier.family.values[rows],
                colour=BEFORE,
                linewidth=1.4,
                markersize=3.0,
                label="before",
            )
        panel.plot(
            scale,
            family.values[rows],
            colour=AXIS_COLOURS[axis],
            linewidth=0.0,
            markersize=5.0,
            label="measured",
        )
        panel.ylabel = f"{SENSOR_AXES[axis]}  {family.unit}"
        panel.has_key = axis == 0
    label = family.covariate
    panels[-1].xlabel = f"log10 of {label}" if family.key in ("spectrum", "allan") else label
    return figure.svg()
