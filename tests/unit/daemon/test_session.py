"""Whole sessions in simulated time: what is recorded, and every way to fail."""

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.config import RigConfig, parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import (
    BoardFaults,
    BoardSettings,
    PtuFaults,
    RigSettings,
)
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange
from gyrorig_daemon.links.pump import StopFlag, StopRequestedError
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_daemon.session.session import record_session
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import SessionEnvironment
from gyrorig_protocol.errors import DeviceError, GyrorigError, MachineError, UsageError
from gyrorig_protocol.program import parse_program
from gyrorig_protocol.recording.messages import PtuCommandRecord, SessionEvent
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording

ORIGIN_NS = 5_000_000_000
UTC_NS = 1_790_000_000_000_000_000

RIG = """
rig: test
ptu: {port: emulated, baud: 115200}
boards: [{id: B-1, port: emulated, baud: 460800}]
emulator: {command_time_ms: 5.0}
"""

PROGRAM = """
name: short
steps:
  - rest: {seconds: 1.0, phase: static}
  - move: {pan_deg: 20.0, speed_deg_s: 40.0}
  - rest: {seconds: 0.5}
  - move: {pan_deg: -20.0, tilt_deg: 10.0, speed_deg_s: 40.0}
  - home: {}
"""

HOLD = "  - rest: {seconds: 3.0}\n"

Change = Callable[[RigSettings], RigSettings]
IMU, POSITION = "/board/B-1/imu_raw", "/ptu/position"


class Bench:
    """One emulated rig and a folder for its recording."""

    def __init__(self, folder: Path, rig_text: str = RIG, change: Change | None = None) -> None:
        self.config: RigConfig = parse_rig(rig_text, "rig.yaml")
        settings = emulated_rig_settings(self.config, 3)
        self.rig = EmulatedRig(change(settings) if change else settings, ORIGIN_NS)
        self.hub = VirtualHub(self.rig)
        self.folder = folder
        self.stop = StopFlag()
        self.stop_at_s: float | None = None

    def record(self, program: str = PROGRAM, home: bool = False) -> Path:
        order = SessionRequest(
            config=self.config,
            config_text=RIG.encode(),
            program=parse_program(program, "program.yaml"),
            program_text=program.encode(),
            out_dir=self.folder,
            session="t",
            home=home,
        )
        capture = CaptureClock(UTC_NS, ORIGIN_NS)

        def read_host() -> HostClocks:
            now_ns = self.hub.now_ns()
            if self.stop_at_s is not None and now_ns > ORIGIN_NS + self.stop_at_s * 1e9:
                self.stop.request("SIGTERM")
            return HostClocks(now_ns, now_ns, capture.utc_ns(now_ns), 0.0, 0.0, 0)

        around = SessionEnvironment(capture, read_host, False, "host", stop=self.stop)
        return record_session(self.hub, order, around)

    def only_file(self) -> Path:
        (path,) = self.folder.iterdir()
        return path

    def is_still(self) -> bool:
        """Ask the truth, not the count: the stage does not turn in the next second."""
        now_s = (self.hub.now_ns() - ORIGIN_NS) * 1e-9
        rates = self.rig.stage.body_rates_rad_s(now_s, 0.01, 100)
        return not np.any(rates)


def commands(recording: Recording) -> list[PtuCommandRecord]:
    return [m for m in recording.messages("/ptu/command") if isinstance(m, PtuCommandRecord)]


def events(recording: Recording) -> list[SessionEvent]:
    return [m for m in recording.messages("/session/event") if isinstance(m, SessionEvent)]


def test_a_recording_keeps_the_contract(tmp_path: Path, contract_judge: Path) -> None:
    bench = Bench(tmp_path)
    path = bench.record()
    judged = subprocess.run(
        [sys.executable, contract_judge, path], capture_output=True, text=True, check=False
    )
    assert judged.returncode == 0, judged.stdout
    assert bench.is_still()


def test_what_is_in_a_recording(tmp_path: Path) -> None:
    recording = read_recording(Bench(tmp_path).record())
    assert recording.is_complete
    assert {a.name for a in recording.attachments} >= {
        "rig.yaml",
        "program.yaml",
        "hello.B-1.0.json",
    }
    assert recording.metadata["gyrorig.ptu"]["dialect"] == "e46"
    assert recording.metadata["gyrorig.board.B-1"]["sensor"] == "L3G4200D"
    sent = [c.command for c in commands(recording)]
    assert sent[:2] == ["V", "H"]
    assert sent[-1] == "H"
    assert "PP389" in sent
    assert {c.code for c in commands(recording)} == {0}
    phases = Counter((e.kind, e.phase) for e in events(recording))
    assert phases == {
        (kind, phase): count
        for kind in (0, 1)
        for phase, count in (("program", 1), ("static", 1), ("sweep", 2), ("dwell", 1), ("home", 1))
    }
    sequence = recording.array(IMU)["sequence"].astype(np.int64)
    assert np.all(np.diff(sequence) % 65536 == 1)  # nothing lost
    positions = recording.array(POSITION)
    assert positions["pan_steps"].max() == 389
    assert np.all(positions["status"] == 3)
    assert np.all(positions["publish_time"] < positions["log_time"])


@pytest.mark.parametrize("dialect", ["d46", "e46"])
@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (1, -1)])
def test_signs_and_dialects(tmp_path: Path, dialect: str, signs: tuple[int, int]) -> None:
    text = RIG.replace(
        "baud: 115200}", f"baud: 9600, pan_sign: {signs[0]}, tilt_sign: {signs[1]}}}"
    )
    bench = Bench(tmp_path, text.replace("emulator: {", f"emulator: {{dialect: {dialect}, "))
    program = "name: one\nsteps:\n  - move: {pan_deg: 20.0, tilt_deg: 10.0}\n"
    recording = read_recording(bench.record(program))
    last = recording.array(POSITION)[-1]
    assert np.degrees([last["pan"], last["tilt"]]) == pytest.approx([20.0, 10.0], abs=0.05)
    assert (last["pan_steps"], last["tilt_steps"]) == (signs[0] * 389, signs[1] * 194)
    # the stage itself, behind the count, stands where the recording says
    now_s = (bench.hub.now_ns() - ORIGIN_NS) * 1e-9
    true = [
        axis.angles_rad(now_s, 0.1, 1)[0] for axis in (bench.rig.stage.pan, bench.rig.stage.tilt)
    ]
    assert np.degrees(true) == pytest.approx([20.0, 10.0], abs=0.1)


def test_the_same_seed_gives_the_same_samples(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in "ab"]
    first, second = (read_recording(Bench(folder).record()) for folder in folders)
    for topic in (IMU, POSITION, "/board/B-1/clock"):
        assert np.array_equal(first.array(topic), second.array(topic))


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ("move: {pan_deg: 160.0}", "pan axis to 160 deg"),
        ("move: {tilt_deg: -50.0}", "tilt axis to -50 deg"),
        ("move: {pan_deg: 10.0, speed_deg_s: 200.0}", "200 deg/s"),
        ("move: {pan_deg: 10.0, speed_deg_s: 0.1}", "0.1 deg/s"),
        ("repeat: {times: 3, steps: [{move: {tilt_deg: 40.0}}]}", "step 2"),
    ],
)
def test_a_program_outside_the_limits_never_moves(tmp_path: Path, step: str, words: str) -> None:
    bench = Bench(tmp_path)
    with pytest.raises(UsageError, match=words):
        bench.record(f"name: far\nsteps:\n  - move: {{pan_deg: 5.0}}\n  - {step}\n")
    assert list(tmp_path.iterdir()) == []
    assert bench.is_still()
    now_s = (bench.hub.now_ns() - ORIGIN_NS) * 1e-9
    assert bench.rig.stage.pan.angles_rad(now_s, 0.1, 1)[0] == 0.0


def test_the_limits_of_the_rig_apply(tmp_path: Path) -> None:
    text = RIG.replace("baud: 115200}", "baud: 115200, limits: {pan_max_deg: 15.0}}")
    with pytest.raises(UsageError, match=r"limits are -158\.91 and 15\.00 deg"):
        Bench(tmp_path, text).record()


def test_an_unhomed_unit_is_homed_with_consent_only(tmp_path: Path) -> None:
    text = RIG.replace("emulator: {", "emulator: {homed: false, ")
    with pytest.raises(UsageError, match="--home"):
        Bench(tmp_path / "without", text).record()
    recording = read_recording(Bench(tmp_path / "with", text).record(home=True))
    reset = next(c for c in commands(recording) if c.command == "R")
    assert "!T" in reset.reply
    assert recording.metadata["gyrorig.ptu"]["pan_max_steps"] == "3090"


def ptu_with(**faults: object) -> Change:
    def change(settings: RigSettings) -> RigSettings:
        if settings.ptu is None:
            raise AssertionError
        return replace(settings, ptu=replace(settings.ptu, faults=PtuFaults(**faults)))  # type: ignore[arg-type]

    return change


def board_with(**faults: object) -> Change:
    def change(settings: RigSettings) -> RigSettings:
        (board,) = settings.boards
        return replace(settings, boards=(replace(board, faults=BoardFaults(**faults)),))  # type: ignore[arg-type]

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (ptu_with(silent=True), "no pan-tilt unit answers"),
        (board_with(silent=True), "board B-1 on emulated is silent"),
        (board_with(garbage=True), "board B-1 on emulated sends no gcb1 samples"),
    ],
)
def test_silent_devices(tmp_path: Path, change: Change, words: str) -> None:
    with pytest.raises(DeviceError, match=words):
        Bench(tmp_path, change=change).record()
    assert list(tmp_path.iterdir()) == []


def test_a_bad_line_to_the_unit_is_tolerated(tmp_path: Path) -> None:
    change = ptu_with(lose_byte_every=37, garbage_every=101)
    recording = read_recording(Bench(tmp_path, change=change).record())
    assert recording.array(POSITION)[-1]["pan_steps"] == 0
    assert any(c.code == 2 for c in commands(recording))


def test_a_bad_line_to_a_board_is_tolerated(tmp_path: Path) -> None:
    change = board_with(
        drop_frame_every=50, duplicate_frame_every=70, flip_bit_every=90, garbage_every=110
    )
    recording = read_recording(Bench(tmp_path, change=change).record())
    assert len(recording.array(IMU)) > 400


def test_a_board_that_reboots_starts_a_new_clock(tmp_path: Path) -> None:
    recording = read_recording(Bench(tmp_path, change=board_with(reset_at_s=(3.0,))).record())
    assert any("restarted" in event.text for event in events(recording) if event.kind == 3)
    rows = recording.array(IMU)
    lag_s = (rows["log_time"].astype(np.int64) - rows["publish_time"].astype(np.int64)) * 1e-9
    assert lag_s.min() >= 0.0
    assert lag_s.max() < 0.5


TEXT_RIG = """
rig: test
ptu: {port: emulated, baud: 115200}
boards:
  - id: B-1
    port: /dev/text
    baud: 460800
    format: text
    columns: {time: 0, gyro: [1, 2, 3], accel: [4, 5, 6], temperature: 7}
    facts: {uid: by-hand, sensor: L3G4200D, gyro_scale_rad_s: 0.00015271631, counter_bits: 32}
"""


def test_a_board_that_prints_lines(tmp_path: Path) -> None:
    def change(settings: RigSettings) -> RigSettings:
        board = BoardSettings(name="B-1", format="text", baud=460800)
        return replace(settings, boards=(board,))

    recording = read_recording(Bench(tmp_path, TEXT_RIG, change).record())
    rows = recording.array(IMU)
    assert len(rows) > 300
    assert recording.metadata["gyrorig.board.B-1"]["tick_hz"] == "1000000.0"
    later = rows["log_time"].astype(np.int64) - rows["publish_time"].astype(np.int64)
    assert 0 < np.median(later) < 5_000_000


def test_a_board_that_sends_batches(tmp_path: Path) -> None:
    def change(settings: RigSettings) -> RigSettings:
        return replace(settings, boards=(replace(settings.boards[0], batch=8),))

    rows = read_recording(Bench(tmp_path, change=change).record()).array(IMU)
    derived = rows["status"] & 16 != 0
    assert derived.mean() == pytest.approx(7 / 8, abs=0.01)
    steps = np.diff(rows["publish_time"].astype(np.int64))[200:] * 1e-9
    # the true rate is up to 5 % off the nominal 100 Hz, and the derived stamps follow it
    assert steps.min() > 0.98 * np.median(steps)
    assert steps.max() < 1.02 * np.median(steps)


def test_a_silent_board_is_recorded_as_a_fault(tmp_path: Path) -> None:
    change = board_with(reset_at_s=(2.0,), reset_silence_s=3.0)
    recording = read_recording(Bench(tmp_path, change=change).record(PROGRAM + HOLD))
    faults = [event.text for event in events(recording) if event.kind == 3]
    assert any("no sample for 2 s" in text for text in faults)
    assert any("sends samples again" in event.text for event in events(recording))


def test_a_board_that_takes_no_requests_is_recorded(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    write = bench.hub.write

    def stuck(port: str, data: bytes) -> object:
        if port != "ptu" and bench.hub.now_ns() > ORIGIN_NS + 3_000_000_000:
            raise DeviceError("board:B-1 cannot be written: it does not take bytes")
        return write(port, data)

    bench.hub.write = stuck  # type: ignore[method-assign,assignment]
    recording = read_recording(bench.record())
    faults = [event.text for event in events(recording) if event.kind == 3]
    assert faults == [
        "board:B-1 cannot be written: it does not take bytes. No requests are sent for 60 s"
    ]
    last_ns = int(recording.array(POSITION)["log_time"][-1])
    assert last_ns - int(recording.array(IMU)["log_time"][-1]) < 200_000_000


class ScriptedHub(VirtualHub):
    """The emulated rig, with the unit's bytes replaced from a moment on."""

    def __init__(self, rig: EmulatedRig, at_s: float, data: bytes, port: str = "ptu") -> None:
        super().__init__(rig)
        self._at_ns = ORIGIN_NS + int(at_s * 1e9)
        self._data: bytes | None = data
        self._port = port

    def read(self, deadline_ns: int) -> Chunk | None:
        chunk = super().read(deadline_ns)
        if self._data is None or chunk is None or chunk.port != self._port:
            return chunk
        if chunk.received_ns <= self._at_ns:
            return chunk
        data, self._data = self._data, None
        if not data:
            return chunk._replace(data=b"", change=PortChange.GONE, text="it was unplugged")
        return chunk._replace(data=data + chunk.data)


def failing(tmp_path: Path, at_s: float, data: bytes, port: str = "ptu") -> tuple[Bench, str]:
    bench = Bench(tmp_path)
    bench.hub = ScriptedHub(bench.rig, at_s, data, port)
    with pytest.raises(DeviceError) as caught:
        bench.record()
    return bench, str(caught.value)


def test_a_limit_flag_in_motion_ends_it_halted(tmp_path: Path) -> None:
    bench, message = failing(tmp_path, 3.3, b"!P")
    assert "the pan-tilt unit no longer knows its position: its pan axis reached a limit" in message
    assert "unit is halted" in message
    assert str(bench.only_file()) in message
    assert bench.is_still()
    recording = read_recording(bench.only_file())
    assert recording.is_complete
    assert any("reached a limit" in event.text for event in events(recording))
    assert any(command.code == 3 for command in commands(recording))
    assert recording.array(POSITION)["status"][-1] == 7


def test_a_restart_of_the_unit_ends_the_program(tmp_path: Path) -> None:
    banner = b"\r\n### PAN-TILT CONTROLLER v2.12, FLIR, ALL RIGHTS RESERVED\r\n"
    bench, message = failing(tmp_path, 3.3, banner)
    assert "it has restarted" in message
    assert read_recording(bench.only_file()).is_complete


def test_an_unplugged_unit_leaves_a_readable_file(tmp_path: Path) -> None:
    bench, message = failing(tmp_path, 3.3, b"")
    assert "unplugged" in message
    assert "was not confirmed" in message
    assert read_recording(bench.only_file()).is_complete


def test_an_unplugged_board_does_not_end_the_program(tmp_path: Path) -> None:
    bench, message = failing(tmp_path, 3.3, b"", "board:B-1")
    assert "the connection to board B-1" in message
    recording = read_recording(bench.only_file())
    assert [e.phase for e in events(recording)][-1] == "program"


def test_a_stop_in_motion_halts_and_closes(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.stop_at_s = 2.6
    program = "name: far\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 20.0}\n"
    with pytest.raises(StopRequestedError, match="SIGTERM") as caught:
        bench.record(program)
    assert "unit is halted" in str(caught.value)
    assert bench.is_still()
    now_s = (bench.hub.now_ns() - ORIGIN_NS) * 1e-9
    angle_deg = np.degrees(bench.rig.stage.pan.angles_rad(now_s, 0.1, 1)[0])
    assert 5.0 < angle_deg < 140.0
    recording = read_recording(bench.only_file())
    assert recording.is_complete
    assert commands(recording)[-1].command == "H"


def test_a_stop_while_homing_waits_for_the_sweep_to_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, RIG.replace("emulator: {", "emulator: {homed: false, "))
    write = bench.hub.write

    def stop_then(port: str, data: bytes) -> object:
        if data == b"R ":
            bench.stop.request("SIGINT")
        return write(port, data)

    monkeypatch.setattr(bench.hub, "write", stop_then)
    with pytest.raises(StopRequestedError, match=r"SIGINT. The unit is halted"):
        bench.record(home=True)
    assert bench.is_still()
    assert list(tmp_path.iterdir()) == []


def test_an_obstacle_is_not_waited_for_forever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path)
    order = bench.hub.write

    def deaf(port: str, data: bytes) -> object:
        return order(port, b"PS500 " if data.startswith(b"PP3") else data)

    monkeypatch.setattr(bench.hub, "write", deaf)
    with pytest.raises(GyrorigError, match="instead of pan 389"):
        bench.record()
    assert bench.is_still()


def test_a_refused_move_ends_the_program_with_the_units_reply(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path)
    order = bench.hub.write

    def confuse(port: str, data: bytes) -> object:
        return order(port, b"PP9999 " if data.startswith(b"PP3") else data)

    monkeypatch.setattr(bench.hub, "write", confuse)
    with pytest.raises(DeviceError, match=r"refused the command 'PP389'.*Pan position is 3090"):
        bench.record()
    assert commands(read_recording(bench.only_file()))[-2].code == 1


def test_a_full_disk_keeps_what_was_written(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(RIG)
    (tmp_path / "program.yaml").write_text("name: rest\nsteps:\n  - rest: {seconds: 30.0}\n")
    limited = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000));"
        "from gyrorig_daemon.cli import main; main()"
    )
    arguments = ["record", "--config", "rig.yaml", "--program", "program.yaml", "--out", "out"]
    run = subprocess.run(
        [sys.executable, "-c", limited, *arguments, "--simulated-time"],
        cwd=tmp_path,
        env=os.environ,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 1
    assert run.stderr.startswith("gyrorigd: the recording out/")
    assert "cannot be written" in run.stderr
    assert run.stderr.count("\n") == 1
    assert "unit is halted" in run.stderr
    (part,) = (tmp_path / "out").iterdir()
    assert len(read_recording(part).array(IMU)) > 100


def test_a_folder_that_cannot_be_created(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    bench = Bench(tmp_path / "file" / "deeper")
    with pytest.raises(MachineError, match="file, because it is not a folder"):
        bench.record()
    assert bench.hub.now_ns() == ORIGIN_NS  # not even a question was asked


def test_a_folder_that_is_not_writable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: path != tmp_path)
    with pytest.raises(MachineError, match="is not writable"):
        Bench(tmp_path / "out" / "deeper").record()
    assert list(tmp_path.iterdir()) == []


def test_the_unit_is_halted_before_the_boards_are_waited_for(tmp_path: Path) -> None:
    bench = Bench(tmp_path, change=board_with(silent=True))
    write, heard = bench.hub.write, []

    def listen(port: str, data: bytes) -> object:
        heard.append((port, data))
        return write(port, data)

    bench.hub.write = listen  # type: ignore[method-assign,assignment]
    with pytest.raises(DeviceError, match="silent"):
        bench.record()
    ports = [port for port, _ in heard]
    assert ("ptu", b"H ") in heard[: ports.index("board:B-1")]


def test_a_unit_that_becomes_silent_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path)
    write, now_ns = bench.hub.write, bench.hub.now_ns

    def cut_off(port: str, data: bytes) -> object:
        late = port == "ptu" and now_ns() > ORIGIN_NS + 4_000_000_000
        return write(port, b" " if late else data)

    monkeypatch.setattr(bench.hub, "write", cut_off)
    with pytest.raises(DeviceError, match="does not answer the command 'BT'"):
        bench.record("name: far\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 10.0}\n")
