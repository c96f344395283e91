"""A person turns the boards: spoken lines, checks, repeats, and what the solver makes of it."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.config import load_rig, parse_rig
from gyrorig_daemon.emulator.emulated_person import read_axis
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import HandSettings, RigSettings
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.links.pump import StopFlag, StopRequestedError
from gyrorig_daemon.motion.manual_checks import RateWindow, check_rest, check_turn
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_daemon.session.manual_session import axis_name, record_by_hand
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import SessionEnvironment
from gyrorig_protocol.errors import DeviceError, UsageError
from gyrorig_protocol.program import Turn, parse_program
from gyrorig_protocol.recording.messages import EventKind, ImuRaw, ImuStatus, SessionEvent
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.standard_messages import Diagnostics
from gyrorig_solver.data import FloatArray
from gyrorig_solver.pipeline import solve_recordings

ROOT = Path(__file__).resolve().parents[3]
RIG = (ROOT / "config" / "manual" / "rig.yaml").read_text()
PROGRAM = """
name: short
steps:
- {rest: {seconds: 4.0, phase: static}}
- {turn: {axis: [0.0, 0.0, 1.0], angle_deg: 360.0, seconds: 8.0}}
- {rest: {seconds: 3.0, phase: static}}
- {turn: {axis: [0.0, 0.0, 1.0], angle_deg: -360.0, seconds: 8.0}}
- {rest: {seconds: 3.0, phase: static}}
"""
ORIGIN_NS, UTC_NS = 5_000_000_000, 1_800_000_000_000_000_000
SCALE = math.radians(8.75e-3)
TURN = Turn((0.0, 0.0, 1.0), 360.0)


class ManualBench:
    """One emulated person with one board, in simulated time."""

    def __init__(self, folder: Path, hand: HandSettings | None = None, rig: str = RIG) -> None:
        self.config = parse_rig(rig, "rig.yaml")
        settings: RigSettings = emulated_rig_settings(self.config, 3)
        if hand is not None:
            settings = replace(settings, hand=hand)
        self.rig = EmulatedRig(settings, ORIGIN_NS)
        self.hub, self.folder = VirtualHub(self.rig), folder
        self.lines: list[str] = []
        self.stop = StopFlag()
        self.stop_at: str | None = None

    def say(self, line: str) -> None:
        self.lines.append(line)
        if line == self.stop_at:
            self.stop.request("SIGTERM")

    def record(self, program: str = PROGRAM) -> Recording:
        capture = CaptureClock(UTC_NS, ORIGIN_NS)

        def read_host() -> HostClocks:
            now_ns = self.hub.now_ns()
            return HostClocks(now_ns, now_ns, capture.utc_ns(now_ns), 0.0, 0.0, 0)

        request = SessionRequest(
            config=self.config,
            config_text=RIG.encode(),
            program=parse_program(program, "program.yaml"),
            program_text=program.encode(),
            out_dir=self.folder,
            session="t",
        )
        environment = SessionEnvironment(
            capture, read_host, False, "host", stop=self.stop, say=self.say
        )
        return read_recording(record_by_hand(self.hub, request, environment))


def phases(recording: Recording) -> list[tuple[str, str]]:
    """Return name and text of the end of each phase, without that of the program."""
    events = [m for m in recording.messages("/session/event") if isinstance(m, SessionEvent)]
    ends = [e for e in events if e.kind == EventKind.PHASE_END]
    return [(e.phase, e.text) for e in ends if e.phase != "program"]


def test_a_session_is_spoken_recorded_and_solved(tmp_path: Path) -> None:
    bench = ManualBench(tmp_path)
    recording = bench.record()
    assert bench.lines == [
        "Keep the board still for 4 s.",
        "Place the board with its +z axis up.",
        "Turn the board by +360 deg about +z within 8 s.",
        *"321",
        "go",
        "Keep the board still for 3 s.",
        "Turn the board by -360 deg about +z within 8 s.",
        *"321",
        "go",
        "Keep the board still for 3 s.",
        "The program is finished.",
    ]
    assert phases(recording) == [("static", ""), ("turn", "")] * 2 + [("static", "")]
    assert recording.is_complete
    assert "gyrorig.ptu" not in recording.metadata
    fit = solve_recordings([recording], "GY80-1")
    error = fit.gain[:, 2] - bench.rig.truth.boards["GY80-1"].imu.gain[:, 2]
    assert np.all(np.abs(error) < 4.0 * fit.gain_std[:, 2])


def test_the_health_of_the_boards_is_recorded_each_second(tmp_path: Path) -> None:
    recording = ManualBench(tmp_path).record()
    messages = [m for m in recording.messages("/diagnostics") if isinstance(m, Diagnostics)]
    # Rests and turns of 26 s, and the time to place the board, to count down and to settle.
    assert 35 < len(messages) < 55
    steps_ns = np.diff([message.stamp_ns for message in messages])
    assert np.all(np.abs(steps_ns - 1e9) < 1e8)
    names = {status.name for message in messages for status in message.status}
    assert names == {"recorder", "board/GY80-1", "clock/GY80-1"}


def test_the_contract_judge_accepts_the_recording(tmp_path: Path, contract_judge: Path) -> None:
    path = ManualBench(tmp_path).record().path
    judged = subprocess.run(
        [sys.executable, contract_judge, path], capture_output=True, text=True, check=False
    )
    assert judged.returncode == 0, judged.stdout


@pytest.mark.parametrize(
    ("hand", "words"),
    [
        (HandSettings(short_turns=(1,)), "deg instead of +360 deg"),
        (HandSettings(wrong_axes=(1,)), "the axis was off by 8"),
        (HandSettings(early_turns=(1,)), "the board moved before the start signal"),
        (HandSettings(late_turns=(1,)), "the turn was not finished in time"),
        (HandSettings(moved_rests=(1,)), "the board moved (its rate changed by"),
    ],
)
def test_a_bad_step_is_repeated_and_ignored(tmp_path: Path, hand: HandSettings, words: str) -> None:
    bench = ManualBench(tmp_path, hand)
    recording = bench.record()
    bad = [line for line in bench.lines if line.startswith("Not good: ")]
    assert len(bad) == 1
    assert words in bad[0]
    assert bad[0].endswith(" Again.")
    ends = phases(recording)
    assert sum(text == "aborted" for _, text in ends) == 1
    assert [phase for phase, text in ends if not text] == ["static", "turn"] * 2 + ["static"]
    fit = solve_recordings([recording], "GY80-1")
    error = fit.gain[:, 2] - bench.rig.truth.boards["GY80-1"].imu.gain[:, 2]
    assert np.all(np.abs(error) < 4.0 * fit.gain_std[:, 2])


def test_a_step_that_stays_bad_ends_the_session(tmp_path: Path) -> None:
    bench = ManualBench(tmp_path, HandSettings(short_turns=tuple(range(1, 20))))
    with pytest.raises(DeviceError, match=r"step 2 .* not good in 5 attempts") as caught:
        bench.record()
    assert "recording up to this time" in caught.value.remedy
    (path,) = tmp_path.glob("*.mcap")
    assert read_recording(path).is_complete


def test_saturated_turns_are_not_accepted(tmp_path: Path) -> None:
    program = PROGRAM.replace("seconds: 8.0", "seconds: 2.0")
    bench = ManualBench(tmp_path)
    with pytest.raises(DeviceError, match="full scale"):
        bench.record(program)
    assert any("exceeded the range of the sensor" in line for line in bench.lines)


def test_a_stop_closes_the_recording(tmp_path: Path) -> None:
    bench = ManualBench(tmp_path)
    bench.stop_at = "go"
    with pytest.raises(StopRequestedError, match="stopped by SIGTERM"):
        bench.record()
    (path,) = tmp_path.glob("*.mcap")
    recording = read_recording(path)
    assert recording.is_complete
    assert phases(recording) == [("static", ""), ("turn", "aborted")]


def test_a_person_cannot_move_a_unit_and_a_unit_cannot_turn(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="which a person cannot do"):
        ManualBench(tmp_path).record("name: p\nsteps:\n- {move: {pan_deg: 10.0}}\n")
    with pytest.raises(UsageError, match="axis of length 1"):
        parse_program("name: p\nsteps:\n- {turn: {axis: [0, 0, 2], angle_deg: 90}}\n", "p")


def test_a_person_has_no_port() -> None:
    with pytest.raises(UsageError, match="a person has no port"):
        parse_rig(RIG.replace("manual, port: emulated", "manual, port: /dev/ttyUSB0"), "rig.yaml")
    real = parse_rig(RIG.replace("manual, port: emulated", "manual, port: terminal"), "rig.yaml")
    assert real.ports() == {"board:GY80-1": "emulated"}
    assert load_rig(ROOT / "config" / "manual" / "rig.yaml").ptu.is_person


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.6, 0.8, 0.0)])
def test_axes_are_spoken_and_understood(axis: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(read_axis(axis_name(axis)), axis)


def window_of(rate_rad_s: FloatArray, saturated: int = 0) -> RateWindow:
    """Return a window of 100 samples per second with these rates."""
    window = RateWindow(0, round(len(rate_rad_s) * 1e7))
    for row, rate in enumerate(rate_rad_s):
        x, y, z = (round(value / SCALE) for value in rate)
        status = int(ImuStatus.SATURATED) if row < saturated else 0
        window.add(ImuRaw(0, 0, row, status, 0, (x, y, z), (0, 0, 0)), round(row * 1e7))
    return window


def turning(angle_deg: float, seconds: float = 6.0) -> FloatArray:
    rate = np.zeros((round(100 * seconds), 3))
    x = (np.arange(400) + 0.5) / 400
    rate[100:500, 2] = math.radians(angle_deg) / 4.0 * (1.0 - np.cos(2.0 * np.pi * x))
    return rate


def test_a_turn_is_judged_without_its_bias() -> None:
    bias = np.array([0.1, -0.2, 0.05])
    assert check_turn(window_of(turning(360.0) + bias), SCALE, TURN, bias).reasons == ()
    assert check_turn(window_of(turning(330.0) + bias), SCALE, TURN, bias).reasons == ()
    (reason,) = check_turn(window_of(turning(-360.0)), SCALE, TURN, np.zeros(3)).reasons
    assert reason == "the board turned by -360 deg instead of +360 deg"
    (reason,) = check_turn(window_of(turning(360.0), saturated=3), SCALE, TURN, np.zeros(3)).reasons
    assert "in 3 samples" in reason
    (reason,) = check_turn(window_of(np.zeros((5, 3))), SCALE, TURN, np.zeros(3)).reasons
    assert "too few samples" in reason


def test_a_rest_may_have_noise_but_no_motion() -> None:
    noise = np.random.default_rng(1).normal(size=(500, 3)) * math.radians(0.3)
    assert check_rest(window_of(noise + 0.2), SCALE).reasons == ()
    moved = noise + np.linspace(0.0, math.radians(2.0), 500)[:, None]
    assert check_rest(window_of(moved), SCALE).reasons
