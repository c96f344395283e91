"""What a dead zone hides of a rate tells nothing of the gain that made it."""

from typing import Any

import numpy as np

from gyrorig_solver.estimate.chain import gain_columns_of
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.model.terms.catalogue import term


def _dead(threshold: list[float]) -> Extension:
    return Extension(term("dead_zone"), np.array(threshold), np.arange(3))


def test_an_axis_below_its_threshold_shows_nothing_of_its_row(rig: Any) -> None:
    largest = float(np.abs(rig.scene.sensor_rate_rad_s[:, 1]).max())
    found = gain_columns_of([_dead([0.0, 2.0 * largest, 0.0])], rig.scene)
    assert found is not None
    rate = rig.scene.seen(rig.scene.rate_rad_s)
    assert np.allclose(found[1], -rate.T, atol=1e-9)
    assert not found[0].any()


def test_an_axis_above_it_most_of_the_time_shows_nearly_all(rig: Any) -> None:
    found = gain_columns_of([_dead([0.0, 0.0, 1e-3])], rig.scene)
    assert found is not None
    rate = rig.scene.seen(rig.scene.rate_rad_s)
    assert np.linalg.norm(found[2]) < 0.05 * np.linalg.norm(rate)


def test_what_cuts_nothing_off_has_no_such_columns(rig: Any) -> None:
    ramp = Extension(term("bias_ramp"), np.full(3, 1e-5), np.arange(3))
    assert gain_columns_of([ramp], rig.scene) is None
