"""The answer to a session: what is hidden, sealed before a finder sees the recording."""

import math
from typing import Any

from tests.hidden.truth.detectable import detectable_of, sizes_of
from tests.hidden.truth.draws import Item, Session
from tests.hidden.truth.outside import NEARLY, SHAPES
from tests.hidden.truth.session import BOARD, ORIGIN_NS, RecordedSession, settings_of
from tests.hidden.truth.shapes import parameters
from tests.hidden.truth.sizing import COUNTED, IN_VARIANCE, Sizer

from gyrorig_daemon.emulator.injection import Quantity

SCHEMA = "gyrorig/hidden-answer/2"


def answer_of(session: Session, recorded: RecordedSession, sizer: Sizer) -> dict[str, Any]:
    """Return the whole truth about a session as plain values."""
    first_s, last_s = recorded.course.span_s
    span_ns = (ORIGIN_NS + round(first_s * 1e9), ORIGIN_NS + round(last_s * 1e9))
    truth = recorded.rig.truth_document(*span_ns)
    by_cause = {entry["cause"]: entry for entry in truth.get("hidden", {}).get("causes", [])}
    for board in truth["boards"].values():
        delay_s = math.sqrt(2.0) / (2.0 * math.pi * board["low_pass"]["cutoff_hz"])
        board["time_offset_s"] = board["tau_s"] + delay_s
    shapes = [SHAPES[item.name] for item in session.items if item.name in SHAPES]
    return {
        "schema": SCHEMA,
        "seed": session.rig.seed,
        "tier": session.tier,
        "kind": session.kind,
        "program": session.rig.program,
        "soak_k": session.rig.soak_k,
        "rig": {
            "ptu_baud": session.rig.ptu_baud,
            "command_time_ms": session.rig.command_time_ms,
        },
        "decoy": session.decoy,
        "causes": [
            _cause(item, by_cause.get(item.name), beside_others, session)
            for item, beside_others in zip(
                session.items, _times_beside_others(session, sizer), strict=True
            )
        ],
        "expected_groups": [group for shape in shapes for group in shape.groups],
        "near": next((shape.near for shape in shapes if shape.near), None),
        "expected_set": list(session.expected_set),
        "unobservable": [i.name for i in session.items if session.kind == "unobservable"],
        "ladder": None
        if session.rung is None
        else {"times": session.rung, "soak": session.rig.soak_k != 0.0},
        "held": None
        if session.held is None
        else {"program": session.held.program, "seed": session.held.seed},
        "span_s": [first_s, last_s],
        "power_up_raw_ns": ORIGIN_NS,
        "truth": truth,
    }


def _cause(
    item: Item, entry: dict[str, Any] | None, beside_others: float | None, session: Session
) -> dict[str, Any]:
    if entry is None:
        entry = _shape(item, session)
    size = entry["size"]["value"]
    seen = item.seen
    lambda_ = None if seen is None else seen.noncentrality
    counted, varied = item.name in COUNTED, item.name in IN_VARIANCE
    return {
        "cause": entry["cause"],
        "place": entry["where"],
        "board": entry["board"],
        "sign": -1 if size < 0.0 else 1,
        "size": entry["size"],
        "parameters": entry["parameters"],
        "statistic": "count" if counted else "variance" if varied else "mean",
        "noncentrality": lambda_,
        "beside_others": beside_others,
        "absorbed": None if seen is None else seen.absorbed,
        "sizes": sizes_of(item.name),
        "detectable": detectable_of(item.name),
        "times_detectable": None
        if lambda_ is None
        else math.sqrt(max(lambda_, 0.0) / detectable_of(item.name)),
        "wanted_times": item.wanted_times,
    }


def _shape(item: Item, session: Session) -> dict[str, Any]:
    shape, size = SHAPES[item.name], item.size or 0.0
    quantities = parameters(shape, size, settings_of(session.rig))
    prefix = "nearly" if item.name in NEARLY else "outside"
    return {
        "cause": f"{prefix}:{item.name}",
        "where": "all",
        "board": BOARD,
        "size": _plain(Quantity(size, shape.unit)),
        "parameters": {name: _plain(quantity) for name, quantity in quantities.items()},
    }


def _plain(quantity: Quantity) -> dict[str, Any]:
    value = list(quantity.value) if isinstance(quantity.value, tuple) else quantity.value
    return {"value": value, "unit": quantity.unit}


def _times_beside_others(session: Session, sizer: Sizer) -> list[float | None]:
    """Return each effect's non-centrality with the others taken off as well."""
    items = session.items
    if len(items) < 2:
        return [None if i.seen is None else i.seen.noncentrality for i in items]
    return sizer.beside_others(
        [None if i.name in (*COUNTED, *IN_VARIANCE) or i.size is None else i.order for i in items]
    )
