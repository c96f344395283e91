"""The planned program against the paper's, predicted and recorded; and the command."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrorig_protocol.program import MotionProgram, parse_program, unroll_steps
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver import cli
from gyrorig_solver.model import FACTOR_NAMES
from gyrorig_solver.pipeline import solve_recordings
from gyrorig_solver.plan import RigModel, find_program, predict_program
from gyrorig_solver.plan.criterion import bias_excess, cost
from gyrorig_solver.plan.program_family import MotionSpace, build_program, draw_design
from gyrorig_solver.plan.program_file import program_text
from gyrorig_solver.plan.program_timeline import simulate_program
from gyrorig_solver.plan.sensor_model import SensorModel

ROOT = Path(__file__).parents[3]
RIG = str(ROOT / "config" / "rig.yaml")
PAPER = str(ROOT / "config" / "programs" / "paper.yaml")
Captured = pytest.CaptureFixture[str]
Record = Callable[[Path, int], tuple[Path, dict[str, Any]]]


@pytest.fixture(scope="module")
def planned(
    rig: RigModel,
    sensor: SensorModel,
    shipped: Callable[[str], MotionProgram],
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """A program made by the command, no longer than the paper's."""
    paper = predict_program(shipped("paper"), rig.unit, sensor)
    out = tmp_path_factory.mktemp("planned") / "planned.yaml"
    seconds = f"{paper.duration_s + 0.02:.2f}"
    asked = ["--rig", RIG, "--seconds", seconds, "--out", str(out), "--no-causes", "--json"]
    assert cli.run(["plan", *asked]) == 0
    return out


@pytest.mark.long
def test_beats_the_paper_at_equal_duration(
    planned: Path, rig: RigModel, sensor: SensorModel, shipped: Callable[[str], MotionProgram]
) -> None:
    ours = predict_program(parse_program(planned.read_bytes(), "planned"), rig.unit, sensor)
    paper = predict_program(shipped("paper"), rig.unit, sensor)
    assert ours.duration_s <= paper.duration_s + 0.02
    assert (ours.observability.rank, paper.observability.rank) == (12, 9)
    assert not ours.observability.unobservable
    for name, std in paper.std.items():
        if np.isfinite(std) and not name.startswith("bias"):
            assert ours.std[name] < std, name
    # A bias cannot be known better than the noise over the same time at rest allows: N times
    # the root of 1/(2T), or so. The paper's program is there to 0.07 %, and ours has to be.
    assert bias_excess(ours.decision, ours.bias_floor_rad_s) < 0.001
    assert bias_excess(paper.decision, paper.bias_floor_rad_s) < 0.001
    visible = np.isfinite(paper.gain_std)
    assert visible.sum() == 6
    assert np.all(ours.gain_std[visible] < 0.5 * paper.gain_std[visible])
    assert ours.motion_offset_std_s < 0.5 * paper.motion_offset_std_s


@pytest.mark.long
def test_emulated_rig_confirms_it(
    planned: Path, record: Record, rig: RigModel, sensor: SensorModel
) -> None:
    path, truth = record(planned, 4)
    recording = read_recording(path)
    fit = solve_recordings([recording], recording.board_ids[0])
    assert fit.observability.rank == 12
    assert not fit.limited_reasons
    assert fit.noise is not None
    levels = [fit.noise.angle_random_walk, fit.noise.bias_instability, fit.noise.rate_random_walk]
    noisy = replace(sensor, levels=np.column_stack([*levels, np.zeros(3)]) ** 2)
    prediction = predict_program(parse_program(planned.read_bytes(), "planned"), rig.unit, noisy)
    for name, std in fit.std.items():
        assert prediction.std[name] == pytest.approx(std, rel=0.2), name
    off = fit.gain - np.array(truth["boards"]["GY80-1"]["STM"])
    assert np.abs(off / prediction.gain_std).max() < 4.0


@pytest.mark.long
def test_same_seed_same_program_and_criteria_differ(rig: RigModel, sensor: SensorModel) -> None:
    program = find_program(rig.unit, sensor, 35.0, "mean", seed=3)
    two = find_program(rig.unit, sensor, 35.0, "mean", seed=3)
    assert program.program == two.program
    assert program.prediction.duration_s <= 35.0
    assert program.cost == cost(program.total.decision, "mean")
    assert cost(program.prediction.decision, "mean") == program.prediction.gain_std.mean()
    assert program.cost > program.prediction.gain_std.mean()
    assert cost(program.prediction.decision, "worst") == program.prediction.gain_std.max()
    factors = [program.prediction.std[name] for name in FACTOR_NAMES]
    assert cost(program.prediction.decision, "mean-factor") == pytest.approx(np.mean(factors))


@pytest.mark.long
@pytest.mark.parametrize("once", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_every_design_stays_inside_and_in_time(seed: int, once: bool, rig: RigModel) -> None:
    rng = np.random.default_rng(seed)
    design = draw_design(rng, once)
    space = MotionSpace.of(rig.unit, 187.5)
    for places in (
        design.cycle_waypoints(space),
        design.cycle_waypoints(space, 2),
        *design.stay_waypoints(space),
    ):
        assert places[0][:2] == places[-1][:2]
    made = build_program(design, space, rig.unit, 900.0)
    timeline = simulate_program(made, rig.unit)  # raises where a limit is left
    assert 899.0 < timeline.duration_s <= 900.0
    assert timeline.position_steps(np.array([timeline.duration_s])).tolist() == [[0.0, 0.0]]
    assert parse_program(program_text(made), "made") == made
    assert sum(1 for _ in unroll_steps(made.steps, "made")) > 4


@pytest.mark.parametrize("once", [False, True])
def test_no_program_of_the_family_turns_in_the_mean(
    once: bool, rig: RigModel, sensor: SensorModel
) -> None:
    """What the mean rate is, the gain's uncertainty brings into the bias: it has to vanish."""
    space = MotionSpace.of(rig.unit, 187.5)
    for seed in range(4):
        made = build_program(draw_design(np.random.default_rng(seed), once), space, rig.unit, 400.0)
        timeline = simulate_program(made, rig.unit)
        edges_s = np.arange(0.0, timeline.duration_s, 1e-3)
        pan, tilt = np.radians(timeline.position_steps(edges_s) * 185.142857 / 3600.0).T
        middle = (tilt[1:] + tilt[:-1]) / 2.0
        area = np.diff(pan) @ np.column_stack([np.sin(middle), np.cos(middle)])
        # Of one sweep's angle, about 5 rad, nothing is left over but what polls shift.
        assert np.abs(area).max() < 0.01, seed


@pytest.mark.long
def test_command_predicts_and_says_what_is_hidden(capsys: Captured) -> None:
    assert cli.run(["plan", "--rig", RIG, "--program", PAPER, "--details"]) == 4
    output = capsys.readouterr().out
    assert "The program cannot detect axis_nonorthogonality at any possible size" in output
    assert "To detect this cause, record: pan sweeps at three or more tilts" in output
    assert "The calibration absorbs wrong_full_scale completely" in output
    assert "scale_asymmetry" in output.partition("cannot distinguish")[0]
    assert "9 of 12" in output
    assert "paper cannot determine scale, nonorthogonality, misalignment" in output
    assert "column y of the gain: " in output
    assert cli.run(["plan", "--rig", RIG, "--program", PAPER, "--json"]) == 4
    document = json.loads(capsys.readouterr().out)
    assert document["exit_code"] == 4
    assert document["given"]["observability"]["rank"] == 9
    assert document["given"]["std"]["scale.y"] is None
    assert document["planned"] is None
    causes = document["given"]["causes"]
    unseen = {f["cause"]: f for f in causes["foreseen"]}["axis_nonorthogonality"]
    assert not unseen["visible"]
    assert unseen["harm_sigma"] > 1.0
    assert all(pair["separated_by"] for pair in causes["confusable"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seconds", "1"], "the length must be from 5 to 900 s"),
        (["--seconds", "nan"], "the length must be from 5 to 900 s"),
        (["--seconds", "1e9"], "the length must be from 5 to 900 s"),
        (["--seconds", "8"], "too short to determine all parameters"),
        (["--seconds", "25", "--for", "causes"], "too short to separate causes. Give --seconds 39"),
        (["--out", "x.yaml", "--program", PAPER], "Give the length of the motion program"),
        (["--sensor", "../../etc"], "contains no profile of"),
        (
            ["--sensor", "missing.yaml"],
            "cannot be read (No such file or directory). Give a profile",
        ),
        (["--program", "missing.yaml"], "cannot be read (No such file or directory). Give a pro"),
        (["--criterion", "best"], "criterion"),
    ],
)
def test_wrong_usage_is_one_line(arguments: list[str], message: str, capsys: Captured) -> None:
    assert cli.run(["plan", "--rig", RIG, *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    "text",
    [
        "",
        "schema: gyrorig/rig/2\n",
        "{schema: gyrorig/rig/1, rig: r, ptu: {port: p}, boards: []}",
        "{schema: gyrorig/rig/1, rig: r, ptu: {port: p, baud: fast}, boards: [{id: b, port: q}]}",
        "{schema: gyrorig/rig/1, rig: r, ptu: {port: p, limits: {tilt_min_deg: 40.0}}, "
        "boards: [{id: b, port: q}]}",
        "a: &x [1]\nb: *x\n",
    ],
)
def test_bad_rigs_are_one_line(text: str, tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    assert cli.run(["plan", "--rig", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("gyrorig: ")
    assert error.count("\n") == 1


def test_a_place_that_cannot_be_written_is_refused_before_the_search(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gyrorig_solver.commands.plan_command.find_program", None)  # would raise
    out = tmp_path / "none" / "p.yaml"
    assert cli.run(["plan", "--rig", RIG, "--seconds", "35", "--output", str(out)]) == 2
    assert f"the folder {out.parent} does not exist. Create it" in capsys.readouterr().err


@pytest.mark.long
def test_never_overwrites(planned: Path, capsys: Captured) -> None:
    before = planned.read_bytes()
    assert cli.run(["plan", "--rig", RIG, "--seconds", "35", "--output", str(planned)]) == 2
    assert "exists" in capsys.readouterr().err
    assert planned.read_bytes() == before
    assert [p.name for p in planned.parent.iterdir()] == ["planned.yaml"]
