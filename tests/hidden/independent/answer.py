"""The answer to a session: the hidden effects and the true calibration. The maker seals it.

The schema is that of `tests.hidden.truth.answer`. The section `unmodelled` is new: it states the
difference between the rig and the assumptions of the solver if nothing is hidden.
"""

import math
from typing import Any

import numpy as np
from tests.bench.rigs.recording_file import BOARD
from tests.hidden.independent.draws import (
    HiddenCause,
    HiddenEffect,
    Session,
    compute_low_pass_noncentrality,
    find_statistic,
)
from tests.hidden.independent.low_passes import ASSUMED
from tests.hidden.independent.sizing import compute_separate_noncentralities
from tests.hidden.independent.stream import SimulatedRecording
from tests.hidden.truth.detectable import compute_detectable, count_sizes

from gyrorig_daemon.emulator.injection import CAUSES

SCHEMA = "gyrorig/hidden-answer/2"
ORDINARY_FLICKER = math.sqrt(math.pi * 0.01)  # relative to the white noise, as the solver assumes


def make_answer(session: Session, recording: SimulatedRecording) -> dict[str, Any]:
    """Return the whole truth about a session as plain values."""
    parts = session.scene.parts
    effect = session.effect
    separate: list[float | None] = [cause.sized.noncentrality for cause in session.causes]
    if len(session.causes) > 1:
        separate = compute_separate_noncentralities(session.visibility, session.items)
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
            *(
                _describe_cause(c, separate_noncentrality)
                for c, separate_noncentrality in zip(session.causes, separate, strict=True)
            ),
            *(() if effect is None else (_describe_effect(effect),)),
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
        "unmodelled": _describe_unmodelled(session),
        "truth": {"boards": {BOARD: _describe_board(session, recording)}},
    }


def _describe_cause(cause: HiddenCause, separate_noncentrality: float | None) -> dict[str, Any]:
    name, size = cause.hiding.cause, cause.hiding.sign * cause.sized.size
    is_counted = find_statistic(name) == "count"
    return {
        "cause": name,
        "place": cause.hiding.place,
        "board": BOARD,
        "sign": -1 if size < 0.0 else 1,
        "size": {"value": size, "unit": CAUSES[name].unit},
        "parameters": cause.hiding.describe_parameters(cause.sized.size),
        "statistic": find_statistic(name),
        **_describe_visibility(
            name, None if is_counted else cause.sized.noncentrality, cause.times
        ),
        "beside_others": None if is_counted else separate_noncentrality,
    }


def _describe_effect(effect: HiddenEffect) -> dict[str, Any]:
    entry, size = effect.entry, effect.sized.size
    return {
        "cause": f"outside:{entry.name}",
        "place": "all",
        "board": BOARD,
        "sign": 1,
        "size": {"value": size, "unit": entry.unit},
        "parameters": {"size": {"value": size, "unit": entry.unit}},
        "statistic": "variance" if entry.in_variance else "mean",
        **_describe_visibility(entry.name, effect.sized.noncentrality, effect.times),
        "beside_others": effect.sized.noncentrality,
    }


def _describe_visibility(
    name: str, noncentrality: float | None, wanted_times: float
) -> dict[str, Any]:
    detectable = compute_detectable(name)
    times = None if noncentrality is None else math.sqrt(max(noncentrality, 0.0) / detectable)
    return {
        "noncentrality": noncentrality,
        "absorbed": None,
        "sizes": count_sizes(name),
        "detectable": detectable,
        "times_detectable": times,
        "wanted_times": wanted_times,
    }


def _describe_board(session: Session, recording: SimulatedRecording) -> dict[str, Any]:
    """Return the true board. The scorer adds the Butterworth delay of a changed cut-off."""
    parts, causes = session.scene.parts, session.hidden_causes
    gyroscope = parts.gyroscope
    cutoff_hz = gyroscope.bandwidth_hz
    added_s = ASSUMED.compute_delay_s(gyroscope.cutoff_hz(causes)) - ASSUMED.compute_delay_s(
        cutoff_hz
    )
    return {
        "STM": np.asarray(gyroscope.gain).tolist(),
        "bias_rad_s": gyroscope.bias_rad_s.tolist(),
        "mean_bias_rad_s": recording.mean_bias_rad_s.tolist(),
        "time_offset_s": recording.rig.stream_truth.delay_s - added_s,
        "odr_hz": gyroscope.odr_hz,
        "gyro_scale_rad_s": gyroscope.quantum_rad_s,
        "low_pass": {"kind": parts.low_pass.kind, "cutoff_hz": cutoff_hz},
        "noise_density_rad_s_rthz": [level.white for level in gyroscope.levels],
        "bias_instability_rad_s": [level.flicker for level in gyroscope.levels],
        "rate_random_walk_rad_s_rts": [level.walk for level in gyroscope.levels],
        "floor_rad_s_rthz": parts.floor_rad_s_rthz,
    }


def _describe_unmodelled(session: Session) -> dict[str, Any]:
    """Return the visibility of the filter's order, and the ratios of the noise levels."""
    visibility, parts = session.visibility, session.scene.parts
    noncentrality = compute_low_pass_noncentrality(visibility)
    levels = parts.gyroscope.levels
    ratios = [level.flicker / level.white / ORDINARY_FLICKER for level in levels]
    return {
        "low_pass": parts.low_pass.kind,
        "low_pass_noncentrality": noncentrality,
        "low_pass_times": math.sqrt(noncentrality / compute_detectable("low_pass_lag")),
        "flicker_ratio": max(ratios),
        "floor_share": parts.floor_rad_s_rthz / max(level.white for level in levels),
        "link": parts.link.kind,
    }
