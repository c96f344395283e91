"""Samples taken at other times than stamped, and a link that mixes axes up."""

from typing import Any

import numpy as np
import pytest

from gyrorig_solver.model import find_term


def close(ours: np.ndarray, theirs: np.ndarray, share: float) -> None:
    assert np.linalg.norm(theirs) > 0.0
    assert np.linalg.norm(ours - theirs) < share * np.linalg.norm(theirs)


def moved(rig: Any, taken_s: Any) -> np.ndarray:
    return np.asarray(rig.measured(rig.base(), taken_s=taken_s) - rig.measured_base)


@pytest.mark.parametrize("rate", [1e-4, -5e-3])
def test_clock_drift_delays_samples(rig: Any, rate: float) -> None:
    """A fast clock has a label before its time: the label's rate is an earlier one."""
    ours = find_term("clock_skew").effect(rig.scene, np.array([rate]))
    close(ours, moved(rig, lambda t: t - rate * (t - 15.0)), 0.01)


@pytest.mark.parametrize("step_s", [1e-3, -0.04])
def test_clock_step_delays_later_samples(rig: Any, step_s: float) -> None:
    ours = find_term("clock_step").effect(rig.scene, np.array([step_s, 12.001]))
    close(ours, moved(rig, lambda t: t - step_s * (t > 12.001)), 0.01)


def test_lost_samples_are_a_clock_step_of_whole_periods(rig: Any) -> None:
    ours = find_term("lost_samples").effect(rig.scene, np.array([4.0, 12.001]))
    close(ours, moved(rig, lambda t: t + 0.02 * (t > 12.001)), 0.01)


def test_offset_to_first_order(rig: Any) -> None:
    ours = find_term("clock_offset").effect(rig.scene, np.array([1e-4]))
    close(ours, moved(rig, lambda t: t - 1e-4), 0.02)


def test_swapped_and_reversed_axes(rig: Any) -> None:
    bias = rig.scene.bias_rad_s
    whole = rig.scene.measure_stage_rate(rig.scene.rate_rad_s) + bias
    swapped = find_term("axis_swap").effect(rig.scene, np.array([0.0, 1.0, 0.0])) + whole
    assert np.allclose(swapped, whole[:, [0, 2, 1]], atol=1e-12)
    flipped = find_term("sign_flip").effect(rig.scene, np.array([1.0, 0.0, 1.0])) + whole
    assert np.allclose(flipped, whole * [-1.0, 1.0, -1.0], atol=1e-12)
    doubled = find_term("wrong_full_scale").effect(rig.scene, np.array([-1.0])) + whole
    assert np.allclose(doubled, whole / 2.0, atol=1e-12)
