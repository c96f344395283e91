"""The fleet's page: files that a browser opens from a disk or a server alike.

    STORE/fleet/index.html  *.js  style.css  data.js  history/00.js ... ff.js

What to use when: `write_page` after `overview`. A page from a disk may not fetch files, so
data are scripts that call one function; the histories of boards and groups are in 256 of them,
loaded when one is opened. Links go to the calibrations and reports beside it in the store.
"""

import json
import math
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from gyrorig_solver.fleet.constants import in_words
from gyrorig_solver.fleet.groups import plain_groups
from gyrorig_solver.fleet.histories import (
    GroupChart,
    drawn,
    group_charts,
    group_key,
    histories,
    shard_of,
)
from gyrorig_solver.fleet.ledger import index_at
from gyrorig_solver.fleet.overview import KINDS, PARAMETERS, Overview
from gyrorig_solver.fleet.worries import Worry, unit_of, worries
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.folder import Folder
from gyrorig_solver.places.place import Place

FOLDER = "fleet"
_COPIED = ("index.html", "drifts.js", "groups.js", "app.js", "style.css")
_DIGITS = 7
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
    groups = group_charts(found)
    to.put(f"{below}data.js", _call("FLEET", _data(found, groups, up)))
    for name, text in histories(index_at(place), found, groups):
        to.put(f"{below}history/{name}.js", _script("HISTORY", f'"{name}",{{{text}}}'))
    return f"{to.text}/{below}index.html"


def _data(found: Overview, groups: dict[str, GroupChart], up: str) -> dict[str, Any]:
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
        "same": in_words(found.constants),
        "groups": _groups(found, groups),
        **drawn(found),
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


def _groups(found: Overview, charts: dict[str, GroupChart]) -> list[dict[str, Any]]:
    """Return what lots, rigs and sites are like, how far each moved, and where its history is."""
    told: list[dict[str, Any]] = []
    for one in plain_groups(found.groups):
        key = group_key(one["kind"], one["name"])
        moved = charts[key].z if key in charts else {}
        told.append({**one, "moved": moved, "shard": shard_of(key)})
    return told


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
