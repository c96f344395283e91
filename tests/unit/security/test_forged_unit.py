"""What a unit claims of itself does not widen what the rig allows."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_daemon.config import CommandLimits
from gyrorig_daemon.motion.motion_plan import PlannedMove, plan_program
from gyrorig_daemon.motion.unit_facts import AxisFacts, UnitFacts
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram, parse_program
from gyrorig_protocol.ptu import Axis, Dialect

LIMITS = CommandLimits(
    pan_min_deg=-90.0, pan_max_deg=90.0, tilt_min_deg=-30.0, tilt_max_deg=20.0, speed_deg_s=60.0
)
STEPS = st.integers(-(2**31) + 1, 2**31 - 1)
SPEEDS = st.integers(0, 2**31 - 1)


def program(pan_deg: float, tilt_deg: float, speed_deg_s: float) -> MotionProgram:
    return parse_program(
        f"name: p\nsteps:\n  - move: {{pan_deg: {pan_deg!r}, tilt_deg: {tilt_deg!r}, "
        f"speed_deg_s: {speed_deg_s!r}}}\n",
        "p",
    )


@given(
    resolution_arcsec=st.floats(1.0, 3600.0),
    bounds=st.tuples(STEPS, STEPS),
    speeds=st.tuples(SPEEDS, SPEEDS, SPEEDS, SPEEDS),
    target=st.tuples(st.floats(-360.0, 360.0), st.floats(-360.0, 360.0), st.floats(0.1, 500.0)),
    sign=st.sampled_from([-1, 1]),
)
def test_no_claim_moves_it_beyond_the_rig_s_limits(
    resolution_arcsec: float,
    bounds: tuple[int, int],
    speeds: tuple[int, int, int, int],
    target: tuple[float, float, float],
    sign: int,
) -> None:
    lower, upper, base, acceleration = speeds
    axis = AxisFacts(
        resolution_arcsec, min(bounds), max(bounds), lower, upper, base, acceleration, sign
    )
    facts = UnitFacts("E46", "1", "s", Dialect.E46, None, axis, axis, 9600)
    try:
        planned = plan_program(program(*target), facts, LIMITS, {Axis.PAN: 0, Axis.TILT: 0})
    except UsageError:
        return
    for step in planned:
        assert isinstance(step, PlannedMove)
        for part in step.axes:
            angle_deg = part.target_steps / axis.steps_per_deg
            low, high = (-90.0, 90.0) if part.axis is Axis.PAN else (-30.0, 20.0)
            half_a_step_deg = 0.5 / abs(axis.steps_per_deg) + 1e-6
            assert low - half_a_step_deg <= angle_deg <= high + half_a_step_deg
            speed_deg_s = part.speed_steps_s / abs(axis.steps_per_deg)
            assert speed_deg_s <= 60.0 + half_a_step_deg


def test_limits_that_are_not_configured_are_the_unit_s_own() -> None:
    axis = AxisFacts(185.1428, -100, 100, 31, 2902, 1000, 2000, 1)
    facts = UnitFacts("E46", "1", "s", Dialect.E46, None, axis, axis, 9600)
    start = {Axis.PAN: 0, Axis.TILT: 0}
    with pytest.raises(UsageError, match="its limits are"):
        plan_program(program(20.0, 0.0, 10.0), facts, CommandLimits(), start)
