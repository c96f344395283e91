"""The fleet's page: static files that a browser opens from a disk or from a server.

    STORE/fleet/index.html  *.js  style.css  data.js  history/00.js ... ff.js

What to use when: `write_fleet_page` after `build_overview`. A page from a disk cannot fetch
files, so the data are scripts that call one function. The histories of boards and groups are in
256 scripts, loaded when a board or group is opened. Links lead to the calibrations and reports
in the store.
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

from gyrorig_solver.fleet.column_units import column_label, column_unit
from gyrorig_solver.fleet.drift import (
    PARAMETER_COLUMNS,
    FleetOverview,
    describe_offsets,
    groups_as_json,
)
from gyrorig_solver.fleet.drift.fleet_overview import GROUP_KINDS
from gyrorig_solver.fleet.page.alerts import fleet_alerts
from gyrorig_solver.fleet.page.history_scripts import (
    GroupDriftChart,
    group_charts,
    group_key,
    history_scripts,
    history_shard,
    shared_chart_data,
)
from gyrorig_solver.fleet.store import StoreIndex
from gyrorig_solver.storage import Folder, Storage, storage_at

PAGE_FOLDER = "fleet"
_WEB_FILES = ("index.html", "drifts.js", "groups.js", "app.js", "style.css")
_SIGNIFICANT_DIGITS = 7
_HISTOGRAM_BINS = 41


def write_fleet_page(
    store: Path | Storage, overview: FleetOverview, out: Path | None = None
) -> str:
    """Write the fleet's page and return where its `index.html` is.

    The page goes into the folder `fleet` of the store, or into `out`.

    Raises:
        MachineError: the folder or the bucket cannot be written.
        InputError: the index is damaged.
    """
    storage = storage_at(store)
    page_storage: Storage = storage if out is None else Folder(out)
    prefix = f"{PAGE_FOLDER}/" if out is None else ""
    web_folder = files("gyrorig_solver.fleet.page") / "web"
    for name in _WEB_FILES:
        page_storage.write(prefix + name, (web_folder / name).read_bytes())
    charts = group_charts(overview)
    data = _page_data(overview, charts, "../" if out is None else _store_link(storage, out))
    page_storage.write(
        f"{prefix}data.js", _script("FLEET", json.dumps(data, separators=(",", ":")))
    )
    for name, text in history_scripts(StoreIndex(storage), overview, charts):
        page_storage.write(f"{prefix}history/{name}.js", _script("HISTORY", f'"{name}",{{{text}}}'))
    return f"{page_storage.location}/{prefix}index.html"


def _page_data(
    overview: FleetOverview, charts: dict[str, GroupDriftChart], store_link: str
) -> dict[str, Any]:
    boards = overview.boards
    return {
        "made": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        "software": version("gyrorig"),
        "up": store_link,
        "nights": overview.nights,
        "versions": sum(boards.version_count),
        "parameters": list(PARAMETER_COLUMNS),
        "labels": [column_label(name) for name in PARAMETER_COLUMNS],
        # values are in SI units; the page multiplies by the factor
        "factors": [column_unit(name)[0] for name in PARAMETER_COLUMNS],
        "units": [column_unit(name)[1] for name in PARAMETER_COLUMNS],
        "alerts": [
            {
                "kind": alert.kind,
                "finding": alert.finding,
                "reason": alert.reason,
                "action": alert.action,
                "filter": alert.search_filter,
            }
            for alert in fleet_alerts(overview)
        ],
        "kinds": _population_entries(overview),
        "offsets": describe_offsets(overview.offset_comparisons),
        "groups": _group_entries(overview, charts),
        **shared_chart_data(overview),
        "boards": {
            "id": boards.board,
            "shard": [history_shard(board) for board in boards.board],
            "sensor": _dictionary_encoded(boards.sensor),
            "verdict": _dictionary_encoded(boards.trust),
            "findings": _dictionary_encoded(boards.findings),
            **{kind: _dictionary_encoded(boards.group_names(kind)) for kind in GROUP_KINDS},
            "version": boards.version,
            "start": _rounded(boards.start_s, 10),
            "chi2": _rounded(boards.reduced_chi2, 4),
            "temperature": _rounded(boards.temperature_c, 4),
            "file": [name.removesuffix(".yaml") for name in boards.file],
            "drift": [
                _largest_drift(z, is_drifting) if is_drifting.any() else None
                for z, is_drifting in zip(overview.drift_z, overview.drifting, strict=True)
            ],
            "outlier": [bool(is_outlier) for is_outlier in overview.is_outlier],
            "value": {name: _rounded(boards.value[name]) for name in PARAMETER_COLUMNS},
            # one bit per parameter: the prior dominates its shrinkage estimate
            "prior": (overview.prior_dominated @ (1 << np.arange(len(PARAMETER_COLUMNS)))).tolist(),
        },
    }


def _group_entries(
    overview: FleetOverview, charts: dict[str, GroupDriftChart]
) -> list[dict[str, Any]]:
    """Return the statistics of rigs, lots and sites, their shifts and their history files."""
    entries: list[dict[str, Any]] = []
    for entry in groups_as_json(overview.groups):
        key = group_key(entry["kind"], entry["name"])
        shift_z = charts[key].z if key in charts else {}
        entries.append({**entry, "shift_z": shift_z, "shard": history_shard(key)})
    return entries


def _population_entries(overview: FleetOverview) -> list[dict[str, Any]]:
    """Return the distribution of each parameter over the boards of each sensor."""
    entries: list[dict[str, Any]] = []
    for (sensor, name), fitted in overview.populations.items():
        values = [
            float(value)
            for value, board_sensor in zip(
                overview.boards.value[name], overview.boards.sensor, strict=True
            )
            if board_sensor == sensor and math.isfinite(value)
        ]
        entries.append(
            {
                "sensor": sensor,
                "parameter": name,
                "boards": fitted.boards,
                "mean": fitted.mean,
                "mean_std": fitted.mean_std,
                "spread": fitted.spread,
                "outliers": int(fitted.is_outlier.sum()),
                "prior": int(fitted.prior_dominated.sum()),
                "bins": _histogram(values, fitted.mean, fitted.spread),
            }
        )
    return entries


def _histogram(values: Sequence[float], mean: float, spread: float) -> dict[str, Any]:
    """Return counts over five spreads on each side; the end bins include all beyond."""
    half = 5.0 * spread or max((abs(value - mean) for value in values), default=1.0) or 1.0
    counts = [0] * _HISTOGRAM_BINS
    for value in values:
        bin_index = int((value - mean + half) / (2.0 * half) * _HISTOGRAM_BINS)
        counts[min(max(bin_index, 0), _HISTOGRAM_BINS - 1)] += 1
    return {"low": mean - half, "high": mean + half, "counts": counts}


def _script(function: str, arguments: str) -> bytes:
    """Return a script with one call. Nothing in its arguments, which are JSON, can end it."""
    return f"{function}({arguments});\n".replace("</", "<\\/").encode()


def _dictionary_encoded(texts: Sequence[str]) -> dict[str, Any]:
    """Return the distinct texts, and the index of each text among them."""
    names = sorted(set(texts))
    number = {name: index for index, name in enumerate(names)}
    return {"names": names, "of": [number[text] for text in texts]}


def _rounded(
    values: Iterable[float | None], digits: int = _SIGNIFICANT_DIGITS
) -> list[float | None]:
    return [
        None if value is None or not math.isfinite(value) else float(f"{value:.{digits}g}")
        for value in values
    ]


def _largest_drift(z: Any, is_drifting: Any) -> list[float | int]:
    """Return the largest drift of one board in standard deviations, and its parameter's index."""
    index = max(range(len(z)), key=lambda k: abs(z[k]) if is_drifting[k] else -1.0)
    return [round(float(z[index]), 1), index]


def _store_link(storage: Storage, out: Path) -> str:
    """Return the link from a page in another folder to the store."""
    if not isinstance(storage, Folder):
        return storage.location.rstrip("/") + "/"
    try:
        relative = out.resolve().relative_to(storage.path.resolve())
    except ValueError:
        return storage.path.resolve().as_uri() + "/"
    return "../" * len(relative.parts)
