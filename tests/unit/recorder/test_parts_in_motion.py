"""A part that starts in the middle of a move contains the whole move for the solver."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.recorder import Recorder, RecorderSettings
from gyrorig_daemon.recorder.ram_buffer import Record
from gyrorig_daemon.recorder.state_replay import MAX_COMMANDS, PendingCommands
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_daemon.session.session import record_session
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import SessionEnvironment
from gyrorig_protocol.motion_orders import OrderAxis, OrderKind
from gyrorig_protocol.program import parse_program
from gyrorig_protocol.ptu import MotionTranslator
from gyrorig_protocol.recording.messages import PtuCommandRecord, PtuPosition
from gyrorig_protocol.recording.motion_messages import MotionOrder
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.reference import PanTiltReference, read_pan_tilt_reference
from gyrorig_solver.reference.unit.recorded_orders import read_orders

ORIGIN_NS = 5_000_000_000
UTC_NS = 1_790_000_000_000_000_000
SECOND = 1_000_000_000
STEP_DEG = 0.0514  # of an E46
RIG = """
rig: test
ptu: {port: emulated, baud: 115200}
boards: [{id: B-1, port: emulated, baud: 460800}]
emulator: {command_time_ms: 5.0}
"""
PROGRAM = b"""
name: sweeps
steps:
  - move: {pan_deg: 60.0, tilt_deg: 20.0, speed_deg_s: 12.0}
  - move: {pan_deg: -60.0, tilt_deg: -30.0, speed_deg_s: 15.0}
  - rest: {seconds: 2.0}
  - move: {pan_deg: 30.0, speed_deg_s: 20.0}
  - home: {}
  - rest: {seconds: 1.0}
"""


def recorded(
    folder: Path, part_s: float, program: bytes = PROGRAM
) -> tuple[EmulatedRig, list[Recording]]:
    config = parse_rig(RIG, "rig.yaml")
    rig = EmulatedRig(emulated_rig_settings(config, 3), ORIGIN_NS)
    hub, capture = VirtualHub(rig), CaptureClock(UTC_NS, ORIGIN_NS)
    order = SessionRequest(
        config=config,
        config_text=RIG.encode(),
        program=parse_program(program, "program.yaml"),
        program_text=program,
        out_dir=folder,
        session="t",
        home=False,
    )
    around = SessionEnvironment(
        capture,
        lambda: HostClocks(hub.now_ns(), hub.now_ns(), capture.utc_ns(hub.now_ns()), 0.0, 0.0, 0),
        False,
        "host",
        new_recorder=lambda: Recorder(False, RecorderSettings(part_s=part_s)),
    )
    record_session(hub, order, around)
    return rig, [read_recording(path) for path in sorted(folder.glob("*.mcap"))]


def test_every_part_contains_its_motion(tmp_path: Path) -> None:
    rig, parts = recorded(tmp_path, 2.5)
    assert len(parts) > 8
    in_motion = 0
    for part in parts[1:-1]:
        samples = part.array("/board/B-1/imu_raw")
        begin_ns, end_ns = times_ns(samples["host_time"][[0, -1]])
        reference = read_pan_tilt_reference(part, UTC_NS)
        at_s = np.arange((begin_ns - UTC_NS) * 1e-9 + 0.1, (end_ns - UTC_NS) * 1e-9 - 0.1, 0.1)
        stage = (rig.stage.pan, rig.stage.tilt)
        truth = np.degrees([[float(axis.angles_rad(t, 0.1, 1)[0]) for t in at_s] for axis in stage])
        turns = np.ptp(truth, axis=1).max() > 1.0
        in_motion += turns
        if turns:
            assert isinstance(reference, PanTiltReference)
            reported_deg = np.degrees(reference.angles_rad(at_s))
            off = np.abs(reported_deg - truth)
            assert off.max() < 2.0 * STEP_DEG, part.path.name
            assert not reference.motion.unknown_spans, part.path.name
        for topic in ("/unit/motion", "/ptu/position"):  # the daemon's own numbers: no gap
            if topic in part.topics:
                numbers = part.array(topic)["message_sequence"]
                assert (np.diff(numbers) == 1).all()
    assert in_motion >= 6


def position(k: int, pan: int, at_ns: int) -> Record:
    message = PtuPosition(at_ns, at_ns, at_ns, pan, 0, 0.0, 0.0, 0, k, 3)
    return Record("/ptu/position", message.TYPE, message.encode(), at_ns, at_ns, k)


class Unit:
    """Sends commands to the state, each with the orders in it, as the recorder writes them."""

    def __init__(self, state: PendingCommands) -> None:
        self.state, self.translator = state, MotionTranslator()
        self.orders = 0

    def command(self, k: int, text: str, at_ns: int, code: int = 0) -> None:
        message = PtuCommandRecord(at_ns, at_ns, at_ns, k, code, text, "*")
        record = Record("/ptu/command", message.TYPE, message.encode(), at_ns, at_ns, k)
        self.state.observe(record)
        for order in self.translator.translate(text, code == 0):
            n, size, ok = self.orders, len(text) + 1, int(code == 0)
            made = MotionOrder(
                at_ns, at_ns, at_ns, math.nan, order.value, order.speed_steps_s, n, size,
                order.axis, order.kind, ok,
            )  # fmt: skip
            self.state.observe(
                Record("/unit/motion", made.TYPE, made.encode(), at_ns, at_ns, self.orders)
            )
            self.orders += 1


def commands_of(state: PendingCommands) -> list[tuple[str, int]]:
    return [(record.topic, record.sequence) for record in state.replay_records()]


def test_which_commands_are_repeated(tmp_path: Path) -> None:
    state = PendingCommands()
    unit = Unit(state)
    for k in range(3):
        state.observe(position(k, 0, k * 10_000_000))
    unit.command(0, "V", 25_000_000)
    assert commands_of(state) == []  # nothing was ordered
    unit.command(1, "PS500", 31_000_000)
    unit.command(2, "TS9", 31_000_000, code=1)  # refused
    unit.command(3, "PP900", 32_000_000)
    for k in range(3, 20):
        state.observe(position(k, 50 * k, k * 10_000_000))
    again = state.replay_records()
    assert [record.log_ns for record in again] == [
        20_000_000, *(2 * [31_000_000, 32_000_000])
    ]  # fmt: skip
    assert commands_of(state) == [
        ("/ptu/position", 19),
        ("/ptu/command", 2),
        ("/ptu/command", 3),
        ("/unit/motion", 1),
        ("/unit/motion", 2),
    ]
    state.observe(position(20, 900, 200_000_000))
    state.observe(position(21, 900, 210_000_000))
    assert commands_of(state) == []  # it has arrived


def test_standstill_after_a_halt_takes_a_second(tmp_path: Path) -> None:
    state = PendingCommands()
    unit = Unit(state)
    state.observe(position(0, 0, 0))
    unit.command(0, "PP900", 1)
    state.observe(position(1, 90, 10))
    unit.command(1, "H", 20)
    state.observe(position(2, 99, 30))
    state.observe(position(3, 99, 30 + SECOND // 2))
    assert len(commands_of(state)) == 5  # a position, two commands, their orders
    state.observe(position(4, 99, 30 + SECOND))
    assert commands_of(state) == []


def test_uncertain_commands_are_not_repeated(tmp_path: Path) -> None:
    state = PendingCommands()
    unit = Unit(state)
    unit.command(0, "PP900", 1)
    assert commands_of(state) == []  # where it came from was never asked
    state = PendingCommands()
    unit = Unit(state)
    state.observe(position(0, 0, 0))
    for k in range(MAX_COMMANDS + 1):
        unit.command(k, f"PP{k}", k + 1)
    assert commands_of(state) == []
    state.invalidate()
    state.observe(position(1, 7, SECOND))
    state.observe(position(2, 7, 3 * SECOND))
    unit.command(MAX_COMMANDS + 1, "PP8", 4 * SECOND)
    assert len(commands_of(state)) == 3


def test_neutral_orders_give_the_motion_of_the_commands(tmp_path: Path) -> None:
    _, (recording,) = recorded(tmp_path, 1e6)
    assert recording.metadata["gyrorig.ptu"]["baud"] == "115200"
    byte_s = 10.0 / 115200.0
    neutral = read_orders(recording, byte_s, UTC_NS)
    raw = recording.motion_orders()
    targets = raw[raw["kind"] == OrderKind.TARGET]
    assert list(targets["axis"][:3]) == [OrderAxis.PAN, OrderAxis.TILT, OrderAxis.PAN]
    assert np.degrees(targets["value"][:3]) == pytest.approx([60.0, 20.0, -60.0], abs=STEP_DEG)
    topics = dict(recording.topics)
    del topics["/unit/motion"]  # as a recording was before there were neutral orders
    old = replace(recording, topics=topics)
    assert old.motion_orders().size == 0
    in_text = read_orders(old, byte_s, UTC_NS)
    assert len(neutral) == len(in_text) > 12
    for order, expected in zip(neutral, in_text, strict=True):
        assert (order.request_s, order.reply_s, order.accepted) == (
            expected.request_s, expected.reply_s, expected.accepted,
        )  # fmt: skip
        assert (order.order.kind, order.order.axis, order.order.value) == (
            expected.order.kind, expected.order.axis, expected.order.value,
        )  # fmt: skip
