"""`gyrorig fleet`: statistics, drift and outliers of all boards in a store, and a page."""

from pathlib import Path
from typing import Any

import click

from gyrorig_solver.commands.terminal import Terminal, json_option
from gyrorig_solver.fleet.drift import (
    PARAMETER_COLUMNS,
    FleetOverview,
    OffsetComparison,
    build_overview,
    describe_offsets,
    groups_as_json,
)
from gyrorig_solver.fleet.drift.fleet_overview import read_origins
from gyrorig_solver.fleet.drift.shrinkage_files import write_shrinkage_estimates
from gyrorig_solver.fleet.page import Alert, fleet_alerts, write_fleet_page
from gyrorig_solver.fleet.store import open_existing_store
from gyrorig_solver.model import plural
from gyrorig_solver.storage import Storage, StorageOption

_ALERTS_SHOWN = 15


@click.command("fleet")
@click.argument("store", type=StorageOption())
@click.option(
    "--boards",
    type=click.Path(path_type=Path, dir_okay=False),
    help="A table (CSV) with the columns board, lot, site; recordings do not contain lots and "
    "sites.  [default: none]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="The folder for the page.  [default: STORE/fleet]",
)
@json_option
@click.pass_obj
def fleet_command(terminal: Terminal, store: Storage, boards: Path | None, out: Path | None) -> int:
    r"""Report drift, outliers and common errors of a fleet, and write a page about it.

    Lots, rigs and sites are tested before single boards: a shift of all boards of one rig comes
    from the rig. All statistics use the calibrations as they are. Shrinkage estimates are stored
    in STORE/shrunk and are never used as an input.

    \b
    Example:
      gyrorig fleet calibrations --boards boards.csv
    """
    open_existing_store(store)
    terminal.print_progress("reading the index")
    fleet = build_overview(store, None if boards is None else read_origins(boards))
    estimates_file = write_shrinkage_estimates(store, fleet)
    terminal.print_progress("writing the page")
    page = write_fleet_page(store, fleet, out)
    alerts = fleet_alerts(fleet)
    terminal.print_result(_fleet_text(fleet, alerts))
    if estimates_file is not None:
        terminal.print_result(f"Shrinkage estimates: {store.location}/{estimates_file}")
    terminal.print_result(f"Page: {page}")
    terminal.print_json({**_fleet_json(fleet, alerts, page), "shrunk": estimates_file})
    return 0


def _fleet_text(fleet: FleetOverview, alerts: list[Alert]) -> str:
    boards = fleet.boards
    verdicts = ", ".join(
        f"{boards.trust.count(name)} {name}" for name in ("good", "limited", "refused")
    )
    lines = [
        f"{plural(len(boards.board), 'board')} ({verdicts}), "
        f"{plural(sum(boards.version_count), 'version')}, {plural(fleet.nights, 'night')}"
    ]
    if not alerts:
        lines.append("No alerts.")
    for alert in alerts[:_ALERTS_SHOWN]:
        lines.append(f"- {alert.finding}")
        lines += [f"    {text}" for text in (alert.reason, alert.action) if text]
    if len(alerts) > _ALERTS_SHOWN:
        lines.append(f"and {len(alerts) - _ALERTS_SHOWN} more, on the page")
    lines += describe_offsets(fleet.offset_comparisons)
    return "\n".join(lines)


def _fleet_json(fleet: FleetOverview, alerts: list[Alert], page: str) -> dict[str, Any]:
    return {
        "boards": len(fleet.boards.board),
        "versions": sum(fleet.boards.version_count),
        "nights": fleet.nights,
        "worries": [
            {"kind": alert.kind, "what": alert.finding, "why": alert.reason, "do": alert.action}
            for alert in alerts
        ],
        "populations": [
            {
                "sensor": sensor,
                "parameter": name,
                "boards": fitted.boards,
                "mean": fitted.mean,
                "mean_std": fitted.mean_std,
                "spread": fitted.spread,
                "prior_dominated": int(fitted.prior_dominated.sum()),
            }
            for (sensor, name), fitted in fleet.populations.items()
        ],
        "constants": [_offset_json(comparison) for comparison in fleet.offset_comparisons],
        "groups": groups_as_json(fleet.groups),
        "drifting": [
            {
                "board": board,
                "parameters": [
                    name
                    for name, drifts in zip(PARAMETER_COLUMNS, is_drifting, strict=True)
                    if drifts
                ],
            }
            for board, is_drifting in zip(fleet.boards.board, fleet.drifting, strict=True)
            if is_drifting.any()
        ],
        "page": page,
    }


def _offset_json(comparison: OffsetComparison) -> dict[str, Any]:
    offset = comparison.result
    return {
        "kind": comparison.kind,
        "name": comparison.name,
        "parameter": offset.parameter,
        "boards": offset.boards,
        "answer": offset.answer,
        "offset": offset.offset,
        "spread": offset.spread,
        "share": offset.share,
        "p_value": offset.p_value,
        "equal_p": offset.homogeneity_p_value,
        "hides_truncation": comparison.hides_truncation,
    }
