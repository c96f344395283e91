"""A board's clock that is off: the host's is the truth, and the calibration says so."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.unit.solver.made import reference_of, samples_of

from gyrorig_solver.data.clocks import map_clock
from gyrorig_solver.estimate import UNIT_REMEDIES, fit_motion


def _solved(rig: Any, skew: float) -> Any:
    n = rig.time_s.size
    ticks = np.rint(rig.time_s * (1.0 + skew) * 1e6).astype(np.int64)
    arrived = rig.time_s + 0.0005 + np.random.default_rng(1).exponential(0.0004, n)
    clock = map_clock(ticks, arrived, 1e6, 64)
    return fit_motion(samples_of(arrived, rig.rate_rad_s, clock), reference_of(rig), UNIT_REMEDIES)


def test_clock_drift_changes_no_scale_and_is_reported(simulate: Callable[..., Any]) -> None:
    rig = simulate(11)
    right, fast = _solved(rig, 0.0), _solved(rig, 3e-3)
    for name in ("scale.x", "scale.y", "scale.z"):
        assert abs(fast.value(name) - right.value(name)) < 0.05 * right.std[name]
    assert not any("clock differs" in text for text in right.warnings)
    (warning,) = [text for text in fast.warnings if "clock differs" in text]
    assert "The solver uses the host's clock" in warning
    assert "every scale factor would be 0.30 % larger" in warning
    assert fast.clock.skew_ppm == pytest.approx(3000.0, abs=20.0)
    assert fast.clock.truth == "the host's capture clock"
