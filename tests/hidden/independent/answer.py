"""The answer to a session: what is hidden, and the true calibration, sealed.

The schema is that of `tests.hidden.truth.answer`. The section `unmodelled` is new: it states how
much the rig differs from what the solver assumes although nothing is hidden.
"""

import math
from typing import Any

import numpy as np
from tests.bench.rigs.recording_file import BOARD
from tests.hidden.independent.draws import (
    HiddenCause,
    HiddenEffect,
    Session,
    low_pass_noncentrality,
    statistic_of,
)
from tests.hidden.independent.low_passes import ASSUMED
from tests.hidden.independent.sizing import beside_others
from tests.hidden.independent.stream import Recorded
from tests.hidden.truth.detectable import detectable_of, sizes_of

from gyrorig_daemon.emulator.injection import CAUSES

SCHEMA = "gyrorig/hidden-answer/2"
ORDINARY_FLICKER = math.sqrt(math.pi * 0.01)  # over the white noise, where the solver has it


def answer_of(session: Session, recorded: Recorded) -> dict[str, Any]:
    """Return the whole truth about a session as plain values."""
    parts = session.scene.parts
    effect = session.effect
    others: list[float | None] = [cause.sized.noncentrality for cause in session.causes]
    if len(session.causes) > 1:
        others = beside_others(session.visibility, session.items)
    return {
        "schema": SCHEMA,
        "simulator": "tests/hidden/independent",
        "seed": session.seed,
        "tier": session.tier,
        "kind": session.kind,
        "program": session.program.name,
        "soak_k": parts.gyroscope.warming.soak_k,
        "rig": {"ptu_baud": parts.baud, "link": parts.link.kind},
        "decoy": None,
        "causes": [
            *(_cause(c, alone) for c, alone in zip(session.causes, others, strict=True)),
            *(() if effect is None else (_effect(effect),)),
        ],
        "expected_groups": [] if effect is None else list(effect.entry.groups),
        "near": None if effect is None else effect.entry.near,
        "expected_set": [],
        "unobservable": [],
        "ladder": None
        if session.rung is None
        else {"times": session.rung, "soak": parts.gyroscope.warming.soak_k != 0.0},
        "held": None,
        "span_s": list(session.scene.span_s),
        "unmodelled": _unmodelled(session),
        "truth": {"boards": {BOARD: _board(session, recorded)}},
    }


def _cause(cause: HiddenCause, alone: float | None) -> dict[str, Any]:
    name, size = cause.hiding.cause, cause.hiding.sign * cause.sized.size
    is_counted = statistic_of(name) == "count"
    return {
        "cause": name,
        "place": cause.hiding.place,
        "board": BOARD,
        "sign": -1 if size < 0.0 else 1,
        "size": {"value": size, "unit": CAUSES[name].unit},
        "parameters": cause.hiding.stated(cause.sized.size),
        "statistic": statistic_of(name),
        **_seen(name, None if is_counted else cause.sized.noncentrality, cause.times),
        "beside_others": None if is_counted else alone,
    }


def _effect(effect: HiddenEffect) -> dict[str, Any]:
    entry, size = effect.entry, effect.sized.size
    return {
        "cause": f"outside:{entry.name}",
        "place": "all",
        "board": BOARD,
        "sign": 1,
        "size": {"value": size, "unit": entry.unit},
        "parameters": {"size": {"value": size, "unit": entry.unit}},
        "statistic": "variance" if entry.in_variance else "mean",
        **_seen(entry.name, effect.sized.noncentrality, effect.times),
        "beside_others": effect.sized.noncentrality,
    }


def _seen(name: str, noncentrality: float | None, wanted_times: float) -> dict[str, Any]:
    least = detectable_of(name)
    times = None if noncentrality is None else math.sqrt(max(noncentrality, 0.0) / least)
    return {
        "noncentrality": noncentrality,
        "absorbed": None,
        "sizes": sizes_of(name),
        "detectable": least,
        "times_detectable": times,
        "wanted_times": wanted_times,
    }


def _board(session: Session, recorded: Recorded) -> dict[str, Any]:
    """Return the true board; the scorer adds a changed cut-off's delay as a Butterworth's."""
    parts, causes = session.scene.parts, session.hidden_causes
    gyroscope = parts.gyroscope
    cutoff_hz = gyroscope.bandwidth_hz
    added_s = ASSUMED.delay_s(gyroscope.cutoff_hz(causes)) - ASSUMED.delay_s(cutoff_hz)
    return {
        "STM": np.asarray(gyroscope.gain).tolist(),
        "bias_rad_s": gyroscope.bias_rad_s.tolist(),
        "mean_bias_rad_s": recorded.mean_bias_rad_s.tolist(),
        "time_offset_s": recorded.rig.stream_truth.delay_s - added_s,
        "odr_hz": gyroscope.odr_hz,
        "gyro_scale_rad_s": gyroscope.quantum_rad_s,
        "low_pass": {"kind": parts.low_pass.kind, "cutoff_hz": cutoff_hz},
        "noise_density_rad_s_rthz": [level.white for level in gyroscope.levels],
        "bias_instability_rad_s": [level.flicker for level in gyroscope.levels],
        "rate_random_walk_rad_s_rts": [level.walk for level in gyroscope.levels],
        "floor_rad_s_rthz": parts.floor_rad_s_rthz,
    }


def _unmodelled(session: Session) -> dict[str, Any]:
    """Return how visible the filter's order is, and how unusual the noise is."""
    visibility, parts = session.visibility, session.scene.parts
    noncentrality = low_pass_noncentrality(visibility)
    levels = parts.gyroscope.levels
    ratios = [level.flicker / level.white / ORDINARY_FLICKER for level in levels]
    return {
        "low_pass": parts.low_pass.kind,
        "low_pass_noncentrality": noncentrality,
        "low_pass_times": math.sqrt(noncentrality / detectable_of("low_pass_lag")),
        "flicker_ratio": max(ratios),
        "floor_share": parts.floor_rad_s_rthz / max(level.white for level in levels),
        "link": parts.link.kind,
    }
