"""Planned programs within limits, speeds and signs of a rig, checked by the daemon's planner."""

from pathlib import Path

import numpy as np
import pytest

from gyrorig_daemon.config import CommandLimits
from gyrorig_daemon.motion.motion_plan import plan_program
from gyrorig_daemon.motion.unit_facts import AxisFacts, UnitFacts
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram, parse_program
from gyrorig_protocol.ptu import Axis, Dialect
from gyrorig_solver.plan import apply_limits, load_rig
from gyrorig_solver.plan.program_family import (
    MotionSpace,
    _round_steps,
    _stay_steps,
    draw_design,
)
from gyrorig_solver.plan.program_timeline import simulate_program
from gyrorig_solver.plan.rig_model import RigLimits
from gyrorig_solver.plan.sensor_model import SensorModel
from gyrorig_solver.plan.separation.motion_blocks import motion_blocks, program_of_blocks
from gyrorig_solver.plan.separation.simulated_recording import recorded_unit
from gyrorig_solver.plan.unit_model import ARCSEC_PER_DEG, UnitModel
from gyrorig_solver.plan.white_noise_screen import WhiteNoiseScreen

CONFIG = Path(__file__).parents[3] / "config"
RESOLUTION_ARCSEC = 185.142857
START = {Axis.PAN: 0, Axis.TILT: 0}
FASTEST_DEG_S = 187.5
TWO_SIGNS = [(1, 1), (-1, 1), (1, -1), (-1, -1)]
PAN_ONLY = b"schema: gyrorig/program/1\nname: p\nsteps:\n  - move: {pan_deg: 10}\n"


def unit_facts(pan_sign: int = 1, tilt_sign: int = 1, upper_speed: int = 2902) -> UnitFacts:
    """Return what a PTU-E46 reports of itself."""
    pan, tilt = (
        AxisFacts(RESOLUTION_ARCSEC, low, high, 31, upper_speed, 1000, 2000, sign)
        for low, high, sign in ((-3090, 3090, pan_sign), (-907, 604, tilt_sign))
    )
    return UnitFacts("PTU-E46-17.5", "v2", "s", Dialect.E46, None, pan, tilt, 9600)


def unit_of(facts: UnitFacts) -> UnitModel:
    """Return the planner's model of the unit of a recording."""
    unit = recorded_unit(facts.metadata())
    assert unit is not None
    return UnitModel(
        unit.pan.with_sign(facts.pan.sign),
        unit.tilt.with_sign(facts.tilt.sign),
        unit.command_interval_s,
        unit.poll_interval_s,
        unit.window_s,
        unit.both_at_once,
    )


def programs_of_blocks(unit: UnitModel) -> list[MotionProgram]:
    """Return one program of each block of motion."""
    space = MotionSpace.of(unit, FASTEST_DEG_S)
    design = draw_design(np.random.default_rng(1), once=True)
    return [
        program_of_blocks((block,), space, design.settings(space), block.name)
        for block in motion_blocks(space)
    ]


def planned_programs(unit: UnitModel) -> list[MotionProgram]:
    """Return programs of one cycle of random designs of both families."""
    space, rng = MotionSpace.of(unit, FASTEST_DEG_S), np.random.default_rng(3)
    programs = []
    for k in range(8):
        design = draw_design(rng, once=bool(k % 2))
        lead, back = design.lead_steps(space)
        build = _stay_steps if design.once else _round_steps
        steps = (*lead, *build(design, space, 1, 0), *back)
        programs.append(MotionProgram(f"design {k}", steps, settings=design.settings(space)))
    return programs


@pytest.mark.parametrize(("pan_sign", "tilt_sign"), TWO_SIGNS)
def test_every_block_is_within_the_limits_for_each_sign(pan_sign: int, tilt_sign: int) -> None:
    facts = unit_facts(pan_sign, tilt_sign)
    for program in programs_of_blocks(unit_of(facts)):
        assert plan_program(program, facts, CommandLimits(), START)


def test_the_limits_of_a_rig_are_added_to_those_of_the_unit() -> None:
    facts = unit_facts(upper_speed=1500)
    unit = apply_limits(unit_of(facts), RigLimits(pan_max_deg=90.0, tilt_min_deg=-20.0), "rig")
    assert unit.pan.fastest_deg_s == pytest.approx(1500 * RESOLUTION_ARCSEC / ARCSEC_PER_DEG)
    limits = CommandLimits(pan_max_deg=90.0, tilt_min_deg=-20.0)
    for program in programs_of_blocks(unit):
        assert plan_program(program, facts, limits, START)


@pytest.mark.parametrize("limits", [(5.0, 25.0), (-40.0, -10.0)])
def test_pan_moves_only_within_the_limits_of_tilt(limits: tuple[float, float]) -> None:
    facts = unit_facts()
    rig = RigLimits(tilt_min_deg=limits[0], tilt_max_deg=limits[1])
    unit = apply_limits(unit_of(facts), rig, "rig")
    daemon = CommandLimits(tilt_min_deg=limits[0], tilt_max_deg=limits[1])
    for program in programs_of_blocks(unit) + planned_programs(unit):
        assert plan_program(program, facts, daemon, START)
        timeline = simulate_program(program, unit)
        time_s = np.arange(0.0, timeline.duration_s, 0.02)
        pan, tilt = (timeline.position_steps(time_s) * RESOLUTION_ARCSEC / ARCSEC_PER_DEG).T
        inside = (tilt > limits[0] - 0.1) & (tilt < limits[1] + 0.1)
        assert inside[np.abs(pan) > 1.0].all(), program.name


def test_the_daemon_refuses_a_move_while_the_other_axis_is_outside_its_limits() -> None:
    limits = CommandLimits(tilt_min_deg=5.0, tilt_max_deg=25.0)
    program = parse_program(PAN_ONLY, "p.yaml")
    with pytest.raises(UsageError, match=r"the tilt axis stays at 0\.00 deg, but the limits"):
        plan_program(program, unit_facts(), limits, START)
    inside = {Axis.PAN: 0, Axis.TILT: 200}
    assert plan_program(program, unit_facts(), limits, inside)


@pytest.mark.parametrize("fastest_deg_s", [1.9, 2.0, 2.5, 3.0])
def test_slow_rigs_have_programs_that_are_fast_enough_for_the_unit(
    sensor: SensorModel, fastest_deg_s: float
) -> None:
    facts = unit_facts()
    unit = apply_limits(unit_of(facts), RigLimits(speed_deg_s=fastest_deg_s), "rig")
    limits = CommandLimits(speed_deg_s=fastest_deg_s)
    for program in programs_of_blocks(unit) + planned_programs(unit):
        assert plan_program(program, facts, limits, START)
    space, rng = MotionSpace.of(unit, FASTEST_DEG_S), np.random.default_rng(3)
    screen = WhiteNoiseScreen(unit, sensor, space, 900.0, "worst")
    costs = [screen.cost(draw_design(rng, once=bool(k % 2))) for k in range(12)]
    assert np.isfinite(costs).any()


def test_a_planned_motion_has_the_sense_of_the_rig() -> None:
    facts = unit_facts(-1, -1)
    unit = unit_of(facts)
    program = parse_program(
        b"schema: gyrorig/program/1\nname: p\nsteps:\n  - move: {pan_deg: 30, tilt_deg: -20}\n",
        "p.yaml",
    )
    steps = simulate_program(program, unit).position_steps(np.array([1e3]))[0]
    angles = np.degrees(steps * np.array([unit.pan.step_rad, unit.tilt.step_rad]))
    np.testing.assert_allclose(angles, [30.0, -20.0], atol=0.03)
    (planned,) = plan_program(program, facts, CommandLimits(), START)
    assert [part.target_steps for part in planned.axes] == steps.tolist()  # type: ignore[union-attr]


@pytest.mark.parametrize("name", sorted(path.name for path in CONFIG.glob("rig*.yaml")))
def test_every_shipped_rig_file_can_be_planned(name: str) -> None:
    assert load_rig(CONFIG / name).unit.pan.fastest_deg_s > 0.0
