"""`gyrorig fleet`: what the boards of a store are like, what has moved, and a page of it."""

from pathlib import Path
from typing import Any

import click

from gyrorig_solver.commands.terminal import Terminal, json_option
from gyrorig_solver.fleet.constants import Constancy, in_words
from gyrorig_solver.fleet.groups import plain_groups
from gyrorig_solver.fleet.overview import PARAMETERS, Overview, overview, read_origins
from gyrorig_solver.fleet.page import write_page
from gyrorig_solver.fleet.shelf import opened
from gyrorig_solver.fleet.shrunk import keep_shrunk
from gyrorig_solver.fleet.worries import Worry, worries
from gyrorig_solver.places.choose import PlaceOption
from gyrorig_solver.places.place import Place

_SHOWN = 15


@click.command("fleet")
@click.argument("store", type=PlaceOption())
@click.option(
    "--boards",
    type=click.Path(path_type=Path, dir_okay=False),
    help="A table (CSV) with the columns board, lot, site: no recording knows lots and sites.  "
    "[default: none]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="The page's folder.  [default: STORE/fleet]",
)
@json_option
@click.pass_obj
def fleet_command(terminal: Terminal, store: Place, boards: Path | None, out: Path | None) -> int:
    r"""Say what to look at first in a fleet, and write its page.

    Lots, rigs and sites are asked before boards: what all boards of one rig show at once is
    the rig's. Every value here comes from the calibrations as they are; shrunk values are
    kept beside them, in STORE/shrunk, and never come back.

    \b
    Example:
      gyrorig fleet calibrations --boards boards.csv
    """
    opened(store)
    terminal.progress("reading the index")
    found = overview(store, None if boards is None else read_origins(boards))
    kept = keep_shrunk(store, found)
    terminal.progress("writing the page")
    page = write_page(store, found, out)
    told = worries(found)
    terminal.say(_said(found, told))
    if kept is not None:
        terminal.say(f"shrunk values: {store.text}/{kept}")
    terminal.say(f"the page: {page}")
    terminal.emit({**_plain(found, told, page), "shrunk": kept})
    return 0


def _said(found: Overview, told: list[Worry]) -> str:
    boards = found.boards
    trust = ", ".join(
        f"{boards.trust.count(name)} {name}" for name in ("good", "limited", "refused")
    )
    lines = [f"{len(boards.board)} boards ({trust}), {sum(boards.versions)} versions"]
    if not told:
        lines.append("nothing stands out")
    for one in told[:_SHOWN]:
        lines.append(f"- {one.what}")
        lines += [f"    {text}" for text in (one.why, one.do) if text]
    if len(told) > _SHOWN:
        lines.append(f"and {len(told) - _SHOWN} more, on the page")
    lines += in_words(found.constants)
    return "\n".join(lines)


def _plain(found: Overview, told: list[Worry], page: str) -> dict[str, Any]:
    return {
        "boards": len(found.boards.board),
        "versions": sum(found.boards.versions),
        "nights": found.nights,
        "worries": [
            {"kind": one.kind, "what": one.what, "why": one.why, "do": one.do} for one in told
        ],
        "populations": [
            {
                "sensor": sensor,
                "parameter": name,
                "boards": one.boards,
                "mean": one.mean,
                "mean_std": one.mean_std,
                "spread": one.spread,
                "prior_dominated": int(one.prior_dominated.sum()),
            }
            for (sensor, name), one in found.populations.items()
        ],
        "constants": [_constancy(one) for one in found.constants],
        "groups": plain_groups(found.groups),
        "drifting": [
            {
                "board": found.boards.board[at],
                "parameters": [n for n, yes in zip(PARAMETERS, row, strict=True) if yes],
            }
            for at, row in enumerate(found.drifting)
            if row.any()
        ],
        "page": page,
    }


def _constancy(one: Constancy) -> dict[str, Any]:
    told = one.told
    return {
        "kind": one.kind,
        "name": one.name,
        "parameter": told.parameter,
        "boards": told.boards,
        "answer": told.answer,
        "offset": told.offset,
        "spread": told.spread,
        "share": told.share,
        "p_value": told.p_value,
        "equal_p": told.equal_p,
        "hides_truncation": one.hides_truncation,
    }
