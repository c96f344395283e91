"""What causes that cut rates off hide tells nothing of what made it."""

from dataclasses import replace
from typing import Any

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import FittedTerm, total_effect
from gyrorig_solver.estimate.cascade import TermCascade, fitted_derivatives, pass_through_of
from gyrorig_solver.model import find_term


def _dead(threshold: list[float]) -> FittedTerm:
    return FittedTerm(find_term("dead_zone"), np.array(threshold), np.arange(3))


def _cause(name: str, values: list[float]) -> FittedTerm:
    return FittedTerm(find_term(name), np.array(values), np.arange(len(values)))


def _limited(scene: Any, share: float) -> tuple[FittedTerm, Any]:
    """Return a limit at a share of the largest rate, and the scene with a range of it."""
    largest = float(np.abs(scene.sensor_rate_rad_s).max())
    setting = replace(scene.context, full_scale_rad_s=2.0 * largest)
    return _cause("saturation", [1.0 - share / 2.0]), replace(scene, context=setting)


def _by_difference(extensions: list[FittedTerm], k: int, step: float, scene: Any) -> FloatArray:
    """Return what all causes together change by the third value of one, (blocks, 3)."""
    sides = []
    for sign in (1.0, -1.0):
        values = extensions[k].values.copy()
        values[2] += sign * step
        moved = [*extensions]
        moved[k] = replace(extensions[k], values=values)
        sides.append(total_effect(moved, scene))
    return np.asarray((sides[0] - sides[1]) / (2.0 * step), np.float64)


def test_axis_below_its_threshold_has_no_gain_derivative(rig: Any) -> None:
    largest = float(np.abs(rig.scene.sensor_rate_rad_s[:, 1]).max())
    pass_through = pass_through_of([_dead([0.0, 2.0 * largest, 0.0])], rig.scene)
    assert pass_through is not None
    rate = rig.scene.measure_sensor_rate(rig.scene.rate_rad_s)
    assert np.allclose(pass_through.gain_derivative[1], -rate.T, atol=1e-9)
    assert not pass_through.gain_derivative[0].any()


def test_axis_mostly_above_its_threshold_keeps_its_derivative(rig: Any) -> None:
    pass_through = pass_through_of([_dead([0.0, 0.0, 1e-3])], rig.scene)
    assert pass_through is not None
    rate = rig.scene.measure_sensor_rate(rig.scene.rate_rad_s)
    assert np.linalg.norm(pass_through.gain_derivative[2]) < 0.05 * np.linalg.norm(rate)


def test_causes_without_clipping_have_no_pass_through(rig: Any) -> None:
    assert pass_through_of([_cause("bias_ramp", [1e-5] * 3)], rig.scene) is None


def test_derivatives_vanish_beyond_the_limit(rig: Any) -> None:
    limit, scene = _limited(rig.scene, 0.5)
    causes = [limit, _cause("vibration_rectification", [1e-3, 2e-3, 1e-3])]
    derivative = fitted_derivatives(causes, scene)[3]
    true = _by_difference(causes, 1, 1e-6, scene)
    alone = fitted_derivatives(causes[1:], scene)[2]
    assert np.linalg.norm(true) < 0.5 * np.linalg.norm(alone)  # a fast move is cut off
    assert np.linalg.norm(derivative - true) < 0.05 * np.linalg.norm(true)


def test_some_scanned_limits_are_just_below_each_peak(rig: Any) -> None:
    """The clipped part of a peak is as deep as the noise, not an eighth of the peak."""
    limit, scene = _limited(rig.scene, 0.5)
    limits = 1.0 - limit.term.template_bank(scene)[:, 0]
    peaks = np.abs(scene.filtered_rad_s + scene.bias_rad_s).max(axis=0)
    for peak in peaks / scene.context.full_scale_rad_s:
        below = 1.0 - limits[limits <= peak] / peak
        assert below.min() < 1e-3
        assert np.count_nonzero(below < 0.1) >= 10


def test_scale_is_unobservable_below_the_threshold(rig: Any) -> None:
    largest = np.abs(rig.scene.sensor_rate_rad_s).max(axis=0)
    causes = [_dead((2.0 * largest).tolist()), _cause("scale_cubic", [1e-3] * 3)]
    alone = fitted_derivatives(causes[1:], rig.scene)[0]
    assert np.linalg.norm(fitted_derivatives(causes, rig.scene)[3]) < 1e-6 * np.linalg.norm(alone)


def test_low_pass_error_with_saturation(rig: Any) -> None:
    limit, scene = _limited(rig.scene, 0.5)
    slower = _cause("low_pass_lag", [-0.4])
    both = total_effect([limit, slower], scene) - total_effect([limit], scene)
    effect = TermCascade([limit], scene).joint_effect(slower.term, slower.values)
    assert np.linalg.norm(effect - both) < 1e-3 * np.linalg.norm(both)


def test_plateau_near_the_threshold_has_no_derivative(rig: Any) -> None:
    rate = np.abs(rig.scene.sensor_rate_rad_s[:, 2])
    # In the middle of the longest plateau's rate, and a hair above: a step of it crosses that.
    values, counts = np.unique(np.round(rate[rate > 1e-2], 9), return_counts=True)
    threshold = float(values[np.argmax(counts)]) + 1e-6
    dead = _dead([0.0, 0.0, threshold])
    slope = dead.term.local_jacobian(rig.scene, dead.values)[2]
    wide = dead.term.jacobian(rig.scene, dead.values)[2]
    sides = [dead.term.effect(rig.scene, np.array([0.0, 0.0, threshold + by]))
             for by in (1e-9, -1e-9)]  # fmt: skip
    true = (sides[0] - sides[1]) / 2e-9
    assert np.linalg.norm(wide) > 5.0 * np.linalg.norm(true)
    assert np.linalg.norm(slope - true) < 0.05 * np.linalg.norm(true)
