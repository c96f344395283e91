"""`record --replay` and `--session-seed`: the same motion again, and independent noise."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.bench.rigs.recording_file import write_recording
from tests.bench.rigs.rig import draw_rig

from gyrorig_daemon.cli import run
from gyrorig_daemon.session.recorded_motion import read_replay
from gyrorig_protocol.recording.messages import EventKind
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording, times_ns

ROOT = Path(__file__).resolve().parents[3]
RIG = ROOT / "config" / "rig.yaml"
# The time between the request of a position and its reply is a few ms.
ANSWER_TIME_S = 6e-3
PROGRAM = """
schema: gyrorig/program/1
name: there-and-back
settings: {base_speed_deg_s: 3.0, acceleration_deg_s2: 200.0}
steps:
  - {rest: {seconds: 2.0, phase: static}}
  - {move: {pan_deg: 60.0, tilt_deg: 20.0, speed_deg_s: 60.0}}
  - {rest: {seconds: 0.3}}
  - {move: {pan_deg: -60.0, speed_deg_s: 90.0}}
  - {move: {tilt_deg: -30.0, speed_deg_s: 25.0}}
  - {rest: {seconds: 1.0, phase: static}}
"""


@dataclass(frozen=True, eq=False)
class Motion:
    """Orders and positions of a recording, with times since the first move."""

    order_s: np.ndarray
    order_values: np.ndarray
    position_s: np.ndarray
    pan_rad: np.ndarray
    tilt_rad: np.ndarray
    phases: list[tuple[float, int, str]]

    @classmethod
    def of(cls, recording: Recording) -> "Motion":
        orders, positions = recording.motion_orders(), recording.ptu_positions()
        request_ns = times_ns(orders["request_time"])
        zero_ns = int(request_ns[orders["kind"] == 0][0])
        moving = request_ns >= zero_ns - 1_000_000_000
        return cls(
            (request_ns[moving] - zero_ns) * 1e-9,
            np.stack([orders[key][moving] for key in ("kind", "axis", "steps")]),
            (positions["publish_time"].astype(np.int64) - zero_ns) * 1e-9,
            positions["pan"],
            positions["tilt"],
            [
                ((event.host_time_ns - zero_ns) * 1e-9, event.kind, event.phase)
                for event in recording.events()
                if event.kind in (EventKind.PHASE_BEGIN, EventKind.PHASE_END)
            ],
        )


def record(folder: Path, *options: str, config: Path = RIG) -> Recording:
    """Record in simulated time."""
    folder.mkdir(parents=True, exist_ok=True)
    known = set(folder.glob("*.mcap"))
    words = ["record", "--config", str(config), "--out", str(folder), "--simulated-time"]
    assert run([*words, *options]) == 0
    (path,) = set(folder.glob("*.mcap")) - known
    return read_recording(path)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("recorded")
    program = folder / "program.yaml"
    program.write_text(PROGRAM)
    return record(folder, "--program", str(program), "--seed", "4", "--session-seed", "1")


def test_a_replay_is_as_long_as_its_recording(recorded: Recording, tmp_path: Path) -> None:
    """The same time before the first move and after the last one, within two samples."""
    again = record(tmp_path, "--replay", str(recorded.path), "--seed", "4", "--session-seed", "3")
    spans = []
    for recording in (recorded, again):
        sample_s = recording.imu_field(recording.board_ids[0], "host_time") * 1e-9
        orders = recording.motion_orders()
        first_move_s = times_ns(orders["request_time"])[orders["kind"] == 0][0] * 1e-9
        spans.append([first_move_s - sample_s[0], sample_s[-1] - first_move_s])
    assert spans[1] == pytest.approx(spans[0], abs=0.02)


def test_a_replay_gives_the_same_motion(recorded: Recording, tmp_path: Path) -> None:
    again = record(tmp_path, "--replay", str(recorded.path), "--seed", "4", "--session-seed", "2")
    first, second = Motion.of(recorded), Motion.of(again)
    assert np.array_equal(first.order_values, second.order_values)
    assert np.abs(first.order_s - second.order_s).max() < 1e-3
    grid_s = np.arange(-0.5, first.position_s[-1] - 0.2, 2e-3)
    for name in ("pan_rad", "tilt_rad"):
        first_angle, other_angle = (
            np.interp(grid_s, m.position_s, getattr(m, name)) for m in (first, second)
        )
        fastest = np.abs(np.gradient(first_angle, grid_s)).max()
        assert np.abs(first_angle - other_angle).max() < fastest * ANSWER_TIME_S
        assert np.ptp(first_angle) > 0.5
    assert [phase[1:] for phase in first.phases] == [phase[1:] for phase in second.phases]
    begins = [np.array([time_s for time_s, *_ in m.phases]) for m in (first, second)]
    assert np.abs(begins[0] - begins[1]).max() < 2e-3
    assert again.metadata["gyrorig.replay"]["sha256"] == recorded.sha256
    program = next(a for a in again.attachments if a.name == "program.yaml")
    assert program.data.decode() == PROGRAM


def test_a_replay_on_another_unit_turns_by_the_same_angles(
    recorded: Recording, tmp_path: Path
) -> None:
    rig = yaml.safe_load(RIG.read_text())
    rig["emulator"]["dialect"] = "d48e"  # other steps
    config = tmp_path / "rig.yaml"
    config.write_text(yaml.safe_dump(rig))
    again = record(tmp_path, "--replay", str(recorded.path), config=config)
    first, second = Motion.of(recorded), Motion.of(again)
    assert not np.array_equal(first.order_values[2], second.order_values[2])
    for name in ("pan_rad", "tilt_rad"):
        ends = [getattr(motion, name)[-1] for motion in (first, second)]
        assert abs(ends[0] - ends[1]) < 1e-3


def test_sessions_of_one_rig_have_independent_noise(recorded: Recording, tmp_path: Path) -> None:
    truths: list[dict[str, Any]] = []
    counts = []
    for session_seed in ("5", "6", "5"):
        truth = tmp_path / "truth.json"
        session = record(
            tmp_path / session_seed, "--replay", str(recorded.path), "--seed", "4",
            "--session-seed", session_seed, "--truth", str(truth),
        )  # fmt: skip
        document = json.loads(truth.read_text())
        for board in document["boards"].values():
            del board["mean_bias_rad_s"]  # of the session
        truths.append(document)
        counts.append(session.imu_field(session.board_ids[0], "gyro")[:150].astype(np.float64))
    assert truths[0] == truths[1] == truths[2]
    assert np.array_equal(counts[0], counts[2])  # the same session again
    noise = [part - part.mean(axis=0) for part in counts[:2]]
    correlation = (noise[0] * noise[1]).mean() / np.sqrt((noise[0] ** 2).mean() ** 2)
    assert abs(correlation) < 0.3
    assert noise[0].std() == pytest.approx(noise[1].std(), rel=0.2)


def test_several_sessions_have_consecutive_seeds(
    recorded: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["record", "--config", str(RIG), "--simulated-time", "--replay", str(recorded.path),
             "--seed", "4"]  # fmt: skip
    several = ["--sessions", "2", "--session-seed", "7", "--session", "s", "--json"]
    assert run([*words, *several, "--out", str(tmp_path / "several")]) == 0
    lines = capsys.readouterr().out.splitlines()
    paths = [Path(json.loads(line)["recording"]) for line in lines]
    assert [path.stem.rpartition("_")[2] for path in paths] == ["s-1", "s-2"]
    assert run([*words, "--session-seed", "8", "--out", str(tmp_path / "single")]) == 0
    single = Path(capsys.readouterr().out.strip())
    counts = [
        recording.imu_field(recording.board_ids[0], "gyro")
        for recording in map(read_recording, (*paths, single))
    ]
    assert np.array_equal(counts[1], counts[2])
    assert not np.array_equal(counts[0], counts[2])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "either a motion program or a recording"),
        (["--program", "p.yaml", "--replay", "r.mcap"], "either a motion program or a recording"),
        (["--program", "PROGRAM", "--draw", "1"], "needs a rig file with the section `twin`"),
        (["--replay", "none.mcap"], "none.mcap"),
        (["--program", "PROGRAM", "--sessions", "2", "--truth", "t"], "and no --truth"),
    ],
)
def test_options_that_do_not_fit_are_rejected(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["record", "--config", str(RIG), "--out", str(tmp_path), "--simulated-time"]
    program = ROOT / "config" / "programs" / "quick.yaml"
    options = [str(program) if word == "PROGRAM" else word for word in options]
    assert run([*words, *options]) in (2, 3)
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_several_sessions_have_a_file_of_rates_each(tmp_path: Path) -> None:
    """The second file is that of a single session with the same seed."""
    program = tmp_path / "rest.yaml"
    program.write_text("schema: gyrorig/program/1\nname: p\nsteps:\n  - rest: {seconds: 1.0}\n")
    words = ["record", "--config", str(RIG), "--out", str(tmp_path), "--simulated-time"]
    words += ["--program", str(program), "--rates"]
    assert run([*words, str(tmp_path / "r.npz"), "--session-seed", "7", "--sessions", "2"]) == 0
    assert run([*words, str(tmp_path / "single.npz"), "--session-seed", "8"]) == 0
    assert not (tmp_path / "r.npz").exists()
    assert (tmp_path / "r-1.npz").exists()
    with np.load(tmp_path / "r-2.npz") as second, np.load(tmp_path / "single.npz") as single:
        assert second.files == single.files
        assert all(np.array_equal(second[name], single[name]) for name in single.files)


def test_a_real_unit_replays_nothing(
    recorded: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = yaml.safe_load(RIG.read_text())
    rig["ptu"]["port"] = "/dev/ttyUSB0"
    config = tmp_path / "rig.yaml"
    config.write_text(yaml.safe_dump(rig))
    out = tmp_path / "out"
    words = ["record", "--config", str(config), "--out", str(out)]
    assert run([*words, "--replay", str(recorded.path)]) == 2
    assert "needs an emulated unit" in capsys.readouterr().err
    assert not out.exists()


def test_orders_outside_the_limits_are_rejected_before_a_move(
    recorded: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = yaml.safe_load(RIG.read_text())
    rig["ptu"]["limits"] = {"pan_min_deg": -50.0}
    config = tmp_path / "rig.yaml"
    config.write_text(yaml.safe_dump(rig))
    words = ["record", "--config", str(config), "--out", str(tmp_path / "out"), "--simulated-time"]
    assert run([*words, "--replay", str(recorded.path)]) == 2
    assert "turns the pan axis to -60" in capsys.readouterr().err
    rig["ptu"]["limits"] = {"speed_deg_s": 60.0}
    config.write_text(yaml.safe_dump(rig))
    assert run([*words, "--replay", str(recorded.path)]) == 2
    assert "turns the pan axis at 90" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*"))


def test_the_replay_of_a_recording_states_its_program(recorded: Recording) -> None:
    source = read_replay(recorded.path)
    assert source.program.settings.base_speed_deg_s == 3.0
    assert source.motion.settings == ()
    assert 0.0 <= source.motion.lead_ns < 2e9
    assert source.motion.exchanges[0].orders[0].value == pytest.approx(np.radians(60.0), rel=1e-2)


def test_a_recording_that_begins_with_settings_is_replayed_in_time(tmp_path: Path) -> None:
    """The simulator sets speed and acceleration within the program, before the first sample."""
    path = tmp_path / "rig.mcap"
    write_recording(draw_rig(3), path)
    measured, replay = read_recording(path), record(tmp_path / "out", "--replay", str(path))

    def move_times_s(recording: Recording) -> list[tuple[str, float]]:
        first_ns = int(recording.imu_field(recording.board_ids[0], "host_time")[0])
        return [
            (command.command, (command.request_time_ns - first_ns) * 1e-9)
            for command in recording.ptu_commands()
            if command.command[:2] in ("PP", "TP") and command.command[2:]
        ]

    expected, replayed = move_times_s(measured), move_times_s(replay)
    assert [text for text, _ in replayed] == [text for text, _ in expected]
    delays_s = [b - a for (_, a), (_, b) in zip(expected, replayed, strict=True)]
    assert len(delays_s) > 10
    assert np.abs(delays_s).max() < 0.015  # a sample period, and the rest of a poll
