"""The fleet's page: files that a browser opens from a disk or a server alike.

    STORE/fleet/index.html  app.js  style.css  data.js  history/00.js ... ff.js

What to use when: `write_page` after `overview`. A page from a disk may not fetch files, so
data are scripts that call one function; the histories of boards are in 256 of them, loaded
when a board is opened. Links go to the calibrations and reports beside it in the store.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.ledger import index_at
from gyrorig_solver.fleet.overview import KINDS, PARAMETERS, Overview
from gyrorig_solver.fleet.worries import Worry, unit_of, worries
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.folder import Folder
from gyrorig_solver.places.place import Place

FOLDER = "fleet"
_COPIED = ("index.html", "app.js", "style.css")
_SHARDS = 256
HISTORY_POINTS = 60  # the latest of each board
_DIGITS = 7
_MEASURED = ("temperature_degc", *PARAMETERS)
_BINS = 41


def write_page(store: Path | Place, found: Overview, out: Path | None = None) -> str:
    """Write the fleet's page and return where its `index.html` is.

    Args:
        store: whose index the histories come from; the page goes into its folder `fleet`.
        found: what to show.
        out: another folder to put it into; made if it is not there.

    Raises:
        MachineError: the folder or the bucket cannot be written.
        InputError: the index is damaged.
    """
    place = place_at(store)
    to: Place = place if out is None else Folder(out)
    below = f"{FOLDER}/" if out is None else ""
    here = files("gyrorig_solver.fleet") / "web"
    for name in _COPIED:
        to.put(below + name, (here / name).read_bytes())
    up = "../" if out is None else _way_up(place, out)
    to.put(f"{below}data.js", _call("FLEET", _data(found, up)))
    for name, text in _histories(index_at(place), found):
        to.put(f"{below}history/{name}.js", text)
    return f"{to.text}/{below}index.html"


def shard_of(board: str) -> str:
    """Return the two digits that name the file with a board's history."""
    return hashlib.sha256(board.encode()).hexdigest()[:2]


def _data(found: Overview, up: str) -> dict[str, Any]:
    boards = found.boards
    return {
        "made": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        "software": version("gyrorig"),
        "up": up,
        "nights": found.nights,
        "versions": sum(boards.versions),
        "wrong": found.wrong,
        "parameters": list(PARAMETERS),
        "units": [_spaced(unit_of(name)) for name in PARAMETERS],
        "worries": [_worry(one) for one in worries(found)],
        "kinds": _kinds(found),
        "boards": {
            "id": boards.board,
            "shard": [shard_of(one) for one in boards.board],
            "sensor": _coded(boards.sensor),
            "trust": _coded(boards.trust),
            "findings": _coded(boards.findings),
            **{kind: _coded(boards.group(kind)) for kind in KINDS},
            "version": boards.version,
            "start": _numbers(boards.start_s, 10),
            "chi2": _numbers(boards.chi2, 4),
            "temperature": _numbers(boards.temperature_c, 4),
            "file": [one.removesuffix(".yaml") for one in boards.file],
            "drift": [
                [round(float(z[at]), 1), int(at)] if yes.any() else None
                for z, yes in zip(found.drift_z, found.drifting, strict=True)
                for at in [_largest(z, yes)]
            ],
            "odd": [bool(one) for one in found.odd],
            "value": {name: _numbers(boards.value[name]) for name in PARAMETERS},
            # a bit a parameter: its shrunk value is more the fleet's than the board's own
            "prior": (found.prior_dominated @ (1 << np.arange(len(PARAMETERS)))).tolist(),
        },
    }


def _kinds(found: Overview) -> list[dict[str, Any]]:
    """Return what boards of each sensor are like, with the histogram of each parameter."""
    kinds: list[dict[str, Any]] = []
    for (sensor, name), one in found.populations.items():
        here = [s == sensor for s in found.boards.sensor]
        values = [
            float(v)
            for v, yes in zip(found.boards.value[name], here, strict=True)
            if yes and math.isfinite(v)
        ]
        kinds.append(
            {
                "sensor": sensor,
                "parameter": name,
                "unit": _spaced(unit_of(name)),
                "boards": one.boards,
                "mean": one.mean,
                "mean_std": one.mean_std,
                "spread": one.spread,
                "odd": int(one.odd.sum()),
                "prior": int(one.prior_dominated.sum()),
                "bins": _histogram(values, one.mean, one.spread),
            }
        )
    return kinds


def _histogram(values: Sequence[float], mean: float, spread: float) -> dict[str, Any]:
    """Return counts over the middle of a distribution; the two ends hold what is further out."""
    half = 5.0 * spread or max((abs(v - mean) for v in values), default=1.0) or 1.0
    counts = [0] * _BINS
    for value in values:
        at = int((value - mean + half) / (2.0 * half) * _BINS)
        counts[min(max(at, 0), _BINS - 1)] += 1
    return {"low": mean - half, "high": mean + half, "counts": counts}


def _spaced(unit: str) -> str:
    return f" {unit}" if unit else ""


def _worry(one: Worry) -> dict[str, Any]:
    return {"what": one.what, "why": one.why, "do": one.do, "kind": one.kind, "find": one.find}


def _histories(index: Index, overview: Overview) -> Iterator[tuple[str, bytes]]:
    """Yield what only an opened board shows, put together by the database: millions of points."""
    sql = f"""
        WITH latest AS (
            SELECT board, version, epoch(start) AS seconds, {", ".join(_MEASURED)} FROM rows
            WHERE status = 'ok' QUALIFY
            row_number() OVER (PARTITION BY board ORDER BY version DESC) <= {HISTORY_POINTS}
        ), points AS (
            SELECT board, version, '[' || version || ',' || {_joined("seconds", *_MEASURED)} || ']'
            AS point FROM latest
        ), boards AS (
            SELECT board, string_agg(point, ',' ORDER BY version) AS points FROM points
            GROUP BY board
        ), whole AS (
            SELECT board, to_json(board)::VARCHAR || ':{{"points":[' || points || '],"std":['
            || {_joined(*(f"{name}_std" for name in PARAMETERS))} || '],"shrunk":['
            || {_joined(*(f"{name}_shrunk" for name in PARAMETERS))} || ']}}' AS text
            FROM boards JOIN newest USING (board)
        )
        SELECT substr(sha256(board), 1, 2), string_agg(text, ',' ORDER BY board)
        FROM whole GROUP BY 1
    """  # noqa: S608 - ours
    boards = overview.boards
    newest: dict[str, Any] = {"board": np.array(boards.board, dtype=object)}
    for at, name in enumerate(PARAMETERS):
        newest[f"{name}_std"] = boards.std[name]
        newest[f"{name}_shrunk"] = overview.shrunk[:, at]
    found: dict[str, str] = {}
    if boards.board:
        with index.connect() as database:
            database.register("newest", newest)
            found = dict(database.execute(sql).fetchall())
    for name in (f"{n:02x}" for n in range(_SHARDS)):
        yield name, _script("HISTORY", f'"{name}",{{{found.get(name, "")}}}')


def _joined(*columns: str) -> str:
    """Return numbers of the database as the inside of a list of JSON."""
    return f"concat_ws(',', {', '.join(_number(name) for name in columns)})"


def _number(column: str) -> str:
    """Return a number of the database as JSON has it."""
    digits = {"seconds": 10}.get(column, _DIGITS)
    text = f"format('{{:.{digits}g}}', {column}::DOUBLE)"
    return f"CASE WHEN isfinite({column}) THEN {text} ELSE 'null' END"


def _call(function: str, value: Any) -> bytes:
    """Return a script that hands a value to the page."""
    return _script(function, json.dumps(value, separators=(",", ":")))


def _script(function: str, arguments: str) -> bytes:
    """Return a call. Nothing in its arguments, JSON, can end the script."""
    return f"{function}({arguments});\n".replace("</", "<\\/").encode()


def _coded(texts: Sequence[str]) -> dict[str, Any]:
    """Return texts that repeat as numbers of a list of them."""
    names = sorted(set(texts))
    number = {name: at for at, name in enumerate(names)}
    return {"names": names, "of": [number[text] for text in texts]}


def _numbers(values: Iterable[float | None], digits: int = _DIGITS) -> list[float | None]:
    return [
        None if one is None or not math.isfinite(one) else float(f"{one:.{digits}g}")
        for one in values
    ]


def _largest(z: Any, among: Any) -> int:
    return max(range(len(z)), key=lambda at: abs(z[at]) if among[at] else -1.0)


def _way_up(place: Place, out: Path) -> str:
    """Return the way from a page elsewhere to the store, as a link has it."""
    if not isinstance(place, Folder):
        return place.text.rstrip("/") + "/"
    try:
        inside = out.resolve().relative_to(place.path.resolve())
    except ValueError:
        return place.path.resolve().as_uri() + "/"
    return "../" * len(inside.parts)
