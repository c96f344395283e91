"""What is predicted against what `solve` says of itself on recordings of the emulated rig."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.quick_cases import quick_cases

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram, parse_program
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.cli import run
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.estimate.gyro_fit import NoiseLevels
from gyrorig_solver.pipeline import solve_recordings
from gyrorig_solver.plan import RigModel, load_rig, predict_program
from gyrorig_solver.plan.program_timeline import simulate_program
from gyrorig_solver.plan.sensor_model import SensorModel

PROGRAMS = Path(__file__).parents[3] / "config" / "programs"
Record = Callable[[Path, int], tuple[Path, dict[str, Any]]]


def with_noise(sensor: SensorModel, noise: NoiseLevels) -> SensorModel:
    """Return a sensor with a board's own noise: parts differ by 25 % from their sheet."""
    levels = [noise.angle_random_walk, noise.bias_instability, noise.rate_random_walk, np.zeros(3)]
    return replace(sensor, levels=np.column_stack(levels) ** 2)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "seed"),
    quick_cases([("quick", 1), ("full", 2), ("paper", 3)], [("quick", 1), ("paper", 3)]),
)
def test_as_solve_says_of_itself(
    name: str,
    seed: int,
    record: Record,
    rig: RigModel,
    sensor: SensorModel,
    shipped: Callable[[str], MotionProgram],
) -> None:
    path, _ = record(PROGRAMS / f"{name}.yaml", seed)
    recording = read_recording(path)
    board = recording.board_ids[0]
    fit = solve_recordings([recording], board)
    assert fit.noise is not None
    prediction = predict_program(shipped(name), rig.unit, with_noise(sensor, fit.noise))
    assert prediction.observability.unobservable == fit.observability.unobservable
    assert prediction.observability.rank == fit.observability.rank
    for parameter, std in fit.std.items():
        assert prediction.std[parameter] == pytest.approx(std, rel=0.2, nan_ok=True), parameter
    assert prediction.gain_std == pytest.approx(fit.gain_std, rel=0.2, nan_ok=True)
    samples = load_samples(recording, board)
    assert prediction.duration_s == pytest.approx(np.ptp(samples.time_s), abs=0.4)


def test_paper_program_cannot_show_the_roll_column(
    rig: RigModel, sensor: SensorModel, shipped: Callable[[str], MotionProgram]
) -> None:
    prediction = predict_program(shipped("paper"), rig.unit, sensor)
    assert prediction.observability.rank == 9
    assert np.isnan(prediction.gain_std[:, 1]).all()
    assert "sweep pan at a positive and at a negative tilt" in prediction.observability.reasons[0]


def program(text: str) -> MotionProgram:
    return parse_program(f"{{schema: gyrorig/program/1, name: t, steps: [{text}]}}", "t")


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ("{move: {pan_deg: 170.0}}", "step 1 of t turns pan to 170 deg"),
        ("{move: {tilt_deg: -50.0}}", "step 1 of t turns tilt to -50 deg"),
        ("{rest: {seconds: 1.0}}, {move: {pan_deg: 9.0, speed_deg_s: 160.0}}", "at 160 deg/s"),
        ("{move: {pan_deg: 9.0, speed_deg_s: 1.0}}", "pan at 1 deg/s"),
        ("{rest: {seconds: 0.1}}", r"lasts 0.\d s, but a calibration needs at least \d"),
        ("{repeat: {times: 9999, steps: [{rest: {seconds: 80000.0}}]}}", "lasts longer than"),
    ],
)
def test_programs_that_cannot_be(
    rig: RigModel, sensor: SensorModel, steps: str, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        predict_program(program(steps), rig.unit, sensor)


def test_axes_that_start_together_move_together(rig: RigModel) -> None:
    timeline = simulate_program(program("{move: {pan_deg: 90.0, tilt_deg: 20.0}}"), rig.unit)
    pan, tilt = (courses[0] for courses in timeline.profiles)
    assert pan.start_s[0] == tilt.start_s[0]
    assert [(o.order.kind.name, o.order.axis.name, o.order.value) for o in timeline.orders] == [
        ("SPEED", "PAN", 583.0),
        ("SPEED", "TILT", 583.0),
        ("COLLECT", "BOTH", 0.0),
        ("TARGET", "PAN", 1750.0),
        ("TARGET", "TILT", 389.0),
        ("IMMEDIATE", "BOTH", 0.0),
    ]
    assert timeline.position_steps(np.array([timeline.duration_s])).tolist() == [[1750.0, 389.0]]
    assert pan.end_s < timeline.program_s < pan.end_s + 0.1


def test_rigs_limits_bind(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(
        "{schema: gyrorig/rig/1, rig: r, boards: [{id: b, port: /dev/b}], ptu: {port: /dev/p, "
        "dialect: d46, limits: {pan_max_deg: 50.0, speed_deg_s: 40.0}}}",
        encoding="utf-8",
    )
    unit = load_rig(path).unit
    assert unit.pan.high_deg == 50.0
    assert unit.pan.low_deg < -158.0
    assert unit.tilt.fastest_deg_s == 40.0
    assert not unit.both_at_once
    assert unit.poll_interval_s >= 0.1


@pytest.mark.parametrize(
    ("unit", "is_known"),
    [
        ("{port: emulated}, emulator: {dialect: d48e}", False),
        ("{port: emulated}", True),
        ("{port: /dev/p, dialect: e46}", True),
        ("{port: /dev/p, driver: scpi_table}", False),
    ],
)
def test_a_prediction_states_that_it_assumes_another_unit(
    tmp_path: Path, unit: str, is_known: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rig.yaml"
    boards = "boards: [{id: b, port: emulated}]"
    path.write_text(f"{{schema: gyrorig/rig/1, rig: r, {boards}, ptu: {unit}}}", encoding="utf-8")
    program = PROGRAMS / "quick.yaml"
    command = ["plan", "--rig", str(path), "--program", str(program), "--no-causes"]
    assert run(command) == 0
    assert ("rig file has another unit" in capsys.readouterr().out) is not is_known


def test_a_rig_whose_boards_a_person_turns_has_no_unit_to_plan_for() -> None:
    with pytest.raises(UsageError, match=r"a person turns the boards \(`driver: manual`\)"):
        load_rig(PROGRAMS.parent / "manual" / "rig.yaml")
