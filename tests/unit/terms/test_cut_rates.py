"""What causes that cut rates off hide tells nothing of what made it."""

from dataclasses import replace
from typing import Any

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.chain import Chain, columns_of, effect_of, shown_of
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.model.terms.catalogue import term


def _dead(threshold: list[float]) -> Extension:
    return Extension(term("dead_zone"), np.array(threshold), np.arange(3))


def _cause(name: str, values: list[float]) -> Extension:
    return Extension(term(name), np.array(values), np.arange(len(values)))


def _limited(scene: Any, share: float) -> tuple[Extension, Any]:
    """Return a limit at a share of the largest rate, and the scene with a range of it."""
    largest = float(np.abs(scene.sensor_rate_rad_s).max())
    setting = replace(scene.setting, full_scale_rad_s=2.0 * largest)
    return _cause("saturation", [1.0 - share / 2.0]), replace(scene, setting=setting)


def _by_difference(extensions: list[Extension], k: int, step: float, scene: Any) -> FloatArray:
    """Return what all causes together change by the third value of one, (blocks, 3)."""
    sides = []
    for sign in (1.0, -1.0):
        values = extensions[k].values.copy()
        values[2] += sign * step
        moved = [*extensions]
        moved[k] = replace(extensions[k], values=values)
        sides.append(effect_of(moved, scene))
    return np.asarray((sides[0] - sides[1]) / (2.0 * step), np.float64)


def test_an_axis_below_its_threshold_shows_nothing_of_its_row(rig: Any) -> None:
    largest = float(np.abs(rig.scene.sensor_rate_rad_s[:, 1]).max())
    found = shown_of([_dead([0.0, 2.0 * largest, 0.0])], rig.scene)
    assert found is not None
    rate = rig.scene.seen(rig.scene.rate_rad_s)
    assert np.allclose(found.gain[1], -rate.T, atol=1e-9)
    assert not found.gain[0].any()


def test_an_axis_above_it_most_of_the_time_shows_nearly_all(rig: Any) -> None:
    found = shown_of([_dead([0.0, 0.0, 1e-3])], rig.scene)
    assert found is not None
    rate = rig.scene.seen(rig.scene.rate_rad_s)
    assert np.linalg.norm(found.gain[2]) < 0.05 * np.linalg.norm(rate)


def test_what_cuts_nothing_off_has_no_such_columns(rig: Any) -> None:
    assert shown_of([_cause("bias_ramp", [1e-5] * 3)], rig.scene) is None


def test_behind_a_limit_a_cause_shows_as_far_as_it_is_not_reached(rig: Any) -> None:
    limit, scene = _limited(rig.scene, 0.5)
    causes = [limit, _cause("vibration_rectification", [1e-3, 2e-3, 1e-3])]
    found = columns_of(causes, scene)[3]
    true = _by_difference(causes, 1, 1e-6, scene)
    alone = columns_of(causes[1:], scene)[2]
    assert np.linalg.norm(true) < 0.5 * np.linalg.norm(alone)  # a fast move is cut off
    assert np.linalg.norm(found - true) < 0.05 * np.linalg.norm(true)


def test_below_a_threshold_the_scale_does_not_show(rig: Any) -> None:
    largest = np.abs(rig.scene.sensor_rate_rad_s).max(axis=0)
    causes = [_dead((2.0 * largest).tolist()), _cause("scale_cubic", [1e-3] * 3)]
    alone = columns_of(causes[1:], rig.scene)[0]
    assert np.linalg.norm(columns_of(causes, rig.scene)[3]) < 1e-6 * np.linalg.norm(alone)


def test_another_low_pass_beside_a_limit_shows_what_both_do(rig: Any) -> None:
    limit, scene = _limited(rig.scene, 0.5)
    slower = _cause("low_pass_lag", [-0.4])
    both = effect_of([limit, slower], scene) - effect_of([limit], scene)
    found = Chain([limit], scene).effect(slower.term, slower.values)
    assert np.linalg.norm(found - both) < 1e-3 * np.linalg.norm(both)


def test_a_plateau_near_the_threshold_is_no_derivative(rig: Any) -> None:
    rate = np.abs(rig.scene.sensor_rate_rad_s[:, 2])
    # In the middle of the longest plateau's rate, and a hair above: a step of it crosses that.
    values, counts = np.unique(np.round(rate[rate > 1e-2], 9), return_counts=True)
    threshold = float(values[np.argmax(counts)]) + 1e-6
    dead = _dead([0.0, 0.0, threshold])
    slope = dead.term.slopes(rig.scene, dead.values)[2]
    wide = dead.term.columns(rig.scene, dead.values)[2]
    sides = [dead.term.effect(rig.scene, np.array([0.0, 0.0, threshold + by]))
             for by in (1e-9, -1e-9)]  # fmt: skip
    true = (sides[0] - sides[1]) / 2e-9
    assert np.linalg.norm(wide) > 5.0 * np.linalg.norm(true)
    assert np.linalg.norm(slope - true) < 0.05 * np.linalg.norm(true)
