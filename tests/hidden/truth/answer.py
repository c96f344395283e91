"""The answer to a session: the hidden effects and the true rig. The maker seals it."""

import math
from typing import Any

from tests.hidden.truth.detectable import compute_detectable, count_sizes
from tests.hidden.truth.draws import Item, Session
from tests.hidden.truth.outside import NEARLY, SHAPES
from tests.hidden.truth.session import BOARD, ORIGIN_NS, RecordedSession, make_settings
from tests.hidden.truth.shapes import list_parameters
from tests.hidden.truth.sizing import COUNTED, IN_VARIANCE, Sizer

from gyrorig_daemon.emulator.injection import Quantity

SCHEMA = "gyrorig/hidden-answer/2"


def make_answer(session: Session, recorded: RecordedSession, sizer: Sizer) -> dict[str, Any]:
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
            _describe_cause(item, by_cause.get(item.name), separate_noncentrality, session)
            for item, separate_noncentrality in zip(
                session.items, _compute_separate_noncentralities(session, sizer), strict=True
            )
        ],
        "expected_groups": [group for shape in shapes for group in shape.groups],
        "near": next((shape.near for shape in shapes if shape.near), None),
        "expected_set": list(session.expected_set),
        "unobservable": [item.name for item in session.items if session.kind == "unobservable"],
        "ladder": None
        if session.rung is None
        else {"times": session.rung, "soak": session.rig.soak_k != 0.0},
        "held": None
        if session.second_rig is None
        else {"program": session.second_rig.program, "seed": session.second_rig.seed},
        "span_s": [first_s, last_s],
        "power_up_raw_ns": ORIGIN_NS,
        "truth": truth,
    }


def _describe_cause(
    item: Item, entry: dict[str, Any] | None, separate_noncentrality: float | None, session: Session
) -> dict[str, Any]:
    if entry is None:
        entry = _describe_shape(item, session)
    size = entry["size"]["value"]
    visibility = item.visibility
    noncentrality = None if visibility is None else visibility.noncentrality
    is_counted, is_in_variance = item.name in COUNTED, item.name in IN_VARIANCE
    return {
        "cause": entry["cause"],
        "place": entry["where"],
        "board": entry["board"],
        "sign": -1 if size < 0.0 else 1,
        "size": entry["size"],
        "parameters": entry["parameters"],
        "statistic": "count" if is_counted else "variance" if is_in_variance else "mean",
        "noncentrality": noncentrality,
        "beside_others": separate_noncentrality,
        "absorbed": None if visibility is None else visibility.absorbed,
        "sizes": count_sizes(item.name),
        "detectable": compute_detectable(item.name),
        "times_detectable": None
        if noncentrality is None
        else math.sqrt(max(noncentrality, 0.0) / compute_detectable(item.name)),
        "wanted_times": item.wanted_times,
    }


def _describe_shape(item: Item, session: Session) -> dict[str, Any]:
    shape, size = SHAPES[item.name], item.size or 0.0
    quantities = list_parameters(shape, size, make_settings(session.rig))
    prefix = "nearly" if item.name in NEARLY else "outside"
    return {
        "cause": f"{prefix}:{item.name}",
        "where": "all",
        "board": BOARD,
        "size": _convert_quantity(Quantity(size, shape.unit)),
        "parameters": {name: _convert_quantity(quantity) for name, quantity in quantities.items()},
    }


def _convert_quantity(quantity: Quantity) -> dict[str, Any]:
    value = list(quantity.value) if isinstance(quantity.value, tuple) else quantity.value
    return {"value": value, "unit": quantity.unit}


def _compute_separate_noncentralities(session: Session, sizer: Sizer) -> list[float | None]:
    """Return the non-centrality of each effect after projecting out the other effects."""
    items = session.items
    if len(items) < 2:
        return [
            None if item.visibility is None else item.visibility.noncentrality for item in items
        ]
    return sizer.compute_separate_noncentralities(
        [
            None if item.name in (*COUNTED, *IN_VARIANCE) or item.size is None else item.request
            for item in items
        ]
    )
