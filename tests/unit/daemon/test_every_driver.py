"""What every driver of a pan-tilt unit must do, with its emulated unit.

The drivers are those of the package and of the pages that show how to write one. With the name of
a driver in $GYRORIG_DRIVER, only this driver is tested.
"""

import json
import os
import random
import re
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import pytest

from gyrorig_daemon.cli import run as gyrorigd
from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import PTU_PORT, PtuPort, parse_rig
from gyrorig_daemon.doctor.finding import Level
from gyrorig_daemon.doctor.port_session import open_for_check
from gyrorig_daemon.doctor.unit_check import check_unit
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.pty_server import PtyServer, raw_now_ns
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.links.ports.port_hub import Chunk
from gyrorig_daemon.links.ports.port_kinds import PortSettings
from gyrorig_daemon.links.ports.supervised_port import SupervisedPort
from gyrorig_daemon.links.pump import StopFlag
from gyrorig_daemon.motion import (
    AxisTarget,
    Exchange,
    Executor,
    Homing,
    PhaseSink,
    PositionPoller,
    Unit,
    driver_names,
    open_unit,
    plan_program,
)
from gyrorig_daemon.session.connected_rig import Rig
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_daemon.session.record_modes import make_port_settings
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.motion_orders import OrderKind
from gyrorig_protocol.program import PtuSettings, parse_program
from gyrorig_protocol.ptu import Axis

ROOT = Path(__file__).resolve().parents[3]
PAGES = ("add-a-unit.md", "add-a-unit-with-frames.md")
FILE = re.compile(r"<!-- test: save (gyrorig_extensions/\S+) -->\n```\w+\n(.*?)```", re.DOTALL)
NAMED = os.environ.get("GYRORIG_DRIVER")
DRIVERS = [NAMED] if NAMED else [*driver_names(), "turntable", "frame_head"]
ORIGIN_NS = 5_000_000_000
SETTINGS = PtuSettings(acceleration_deg_s2=50.0)
SPEED_DEG_S = 20.0
LONG_MOVES = {Axis.PAN: (40.0, SPEED_DEG_S), Axis.TILT: (25.0, 5.0)}  # deg and deg/s
STOPS_WITHIN_S = 1.5  # from 20 deg/s at 50 deg/s^2: 0.4 s and the time of the exchanges


@pytest.fixture(scope="module", autouse=True)
def _drivers_of_the_pages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Put the examples of the pages on the path of Python."""
    folder = tmp_path_factory.mktemp("drivers")
    for page in PAGES:
        text = (ROOT / "docs/how-to" / page).read_text(encoding="utf-8")
        for name, module in FILE.findall(text):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(module, encoding="utf-8")
    sys.path.append(str(folder))
    yield
    sys.path.remove(str(folder))


def rig_text(driver: str, port: str = "emulated") -> str:
    return (
        f"rig: test\nptu: {{port: {port}, driver: {driver}, baud: 115200}}\n"
        "boards: [{id: B-1, port: emulated, baud: 460800}]\n"
        "emulator: {command_time_ms: 5.0}\n"
    )


class Bench:
    """An emulated unit behind its driver, in virtual time."""

    def __init__(self, driver: str, other: str | None = None) -> None:
        """Play the unit of `driver`, or of the driver `other`."""
        played = parse_rig(rig_text(other or driver), "rig.yaml")
        settings = emulated_rig_settings(played, 3)
        self.emulated = EmulatedRig(settings, ORIGIN_NS)
        self.hub = VirtualHub(self.emulated)
        capture = CaptureClock(1_790_000_000_000_000_000, ORIGIN_NS)
        config = parse_rig(rig_text(driver), "rig.yaml")
        self.rig = Rig(self.hub, config, capture, stop=StopFlag(), seed=1)
        self.limits = config.ptu.limits
        self.driver, self.pump = self.rig.driver, self.rig.pump
        self.exchanges: list[Exchange] = []
        self.rig.listener = self

    def handle_exchange(self, exchange: Exchange) -> None:
        self.exchanges.append(exchange)

    def handle_sample(self, *_: object) -> None: ...

    def handle_ping(self, *_: object) -> None: ...

    def note(self, *_: object) -> None: ...

    fault = note

    def open(self, settings: PtuSettings = SETTINGS) -> Unit:
        self.driver.identify()
        return open_unit(self.driver, settings, Homing.IF_NEEDED)

    def move(self, unit: Unit, angles_deg: dict[Axis, float]) -> None:
        """Move to angles and wait until the unit is there."""
        poller = PositionPoller(unit, None, lambda _: None)
        words = ", ".join(f"{axis.label}_deg: {angle}" for axis, angle in angles_deg.items())
        step = f"name: p\nsteps:\n  - move: {{{words}, speed_deg_s: {SPEED_DEG_S}}}\n"
        start = poller.read_positions()
        steps = plan_program(parse_program(step, "p.yaml"), unit.facts, self.limits, start)
        Executor(self.pump, unit, poller, PhaseSink(lambda *_: None, lambda *_: None)).run(
            steps, lambda _: None
        )

    def start(self, unit: Unit, sign: int = 1) -> None:
        """Start a move of all axes and return while they turn."""
        targets = []
        for axis in self.driver.axes:
            facts, (angle_deg, speed_deg_s) = unit.facts.axis(axis), LONG_MOVES[axis]
            target, speed = facts.to_steps(sign * angle_deg), facts.to_speed(speed_deg_s)
            targets.append(AxisTarget(axis, target, speed))
        self.driver.start_move(targets)
        self.wait(0.5)
        for axis in self.driver.axes:
            assert self.axis_turns(axis), f"the unit acknowledges a move of {axis.label} only"

    def wait(self, seconds: float) -> None:
        self.pump.run_until(self.hub.now_ns() + round(seconds * 1e9))

    def axis_turns(self, axis: Axis) -> bool:
        stage, now_s = self.emulated.stage, (self.hub.now_ns() - ORIGIN_NS) * 1e-9
        return (stage.pan if axis is Axis.PAN else stage.tilt).is_moving(now_s)

    def turns(self) -> bool:
        return self.axis_turns(Axis.PAN) or self.axis_turns(Axis.TILT)

    def angle_deg(self, axis: Axis) -> float:
        """Return where the axis of the emulated rig is, by its own count."""
        stage = self.emulated.stage
        played = stage.pan if axis is Axis.PAN else stage.tilt
        now_s = (self.hub.now_ns() - ORIGIN_NS) * 1e-9
        return played.count(now_s) * played.truth.resolution_arcsec / 3600.0


@pytest.fixture(params=DRIVERS)
def driver(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def bench(driver: str) -> Bench:
    return Bench(driver)


def test_the_facts_are_plausible(bench: Bench) -> None:
    unit = bench.open()
    assert unit.facts.driver == bench.driver.name
    assert unit.facts.axes == tuple(bench.driver.axes)
    for axis in bench.driver.axes:
        facts = unit.facts.axis(axis)
        assert facts.min_steps < 0 < facts.max_steps
        assert 0 < facts.resolution_arcsec < 1000.0
        assert 0 <= facts.lower_speed < facts.upper_speed
        assert facts.acceleration == pytest.approx(50.0 * abs(facts.steps_per_deg), rel=0.01)
    assert not bench.turns()


def test_a_move_reaches_its_angle(bench: Bench) -> None:
    """A wrong unit or a wrong axis of a command or a position shows here."""
    unit = bench.open()
    angles_deg = {Axis.PAN: 25.0, Axis.TILT: -13.0}
    targets = {axis: angles_deg[axis] for axis in bench.driver.axes}
    bench.move(unit, targets)
    for axis, angle_deg in targets.items():
        step_deg = unit.facts.axis(axis).resolution_arcsec / 3600.0
        assert bench.angle_deg(axis) == pytest.approx(angle_deg, abs=step_deg)


def test_the_orders_say_what_the_unit_does(bench: Bench) -> None:
    unit = bench.open()
    first = len(bench.exchanges)
    bench.move(unit, {Axis.PAN: 25.0})
    facts = unit.facts.pan
    orders = {
        order.kind: order.value
        for exchange in bench.exchanges[first:]
        for order in exchange.orders
        if exchange.accepted
    }
    assert orders[OrderKind.TARGET] == facts.to_steps(25.0)
    assert orders[OrderKind.SPEED] == facts.to_speed(SPEED_DEG_S)
    kind, time_s, _, law = bench.emulated.stage.pan.commands[-1]
    (order_exchange,) = (
        exchange
        for exchange in bench.exchanges[first:]
        if any(order.kind is OrderKind.TARGET for order in exchange.orders)
    )
    assert kind == "move"
    played_step_deg = bench.emulated.stage.pan.truth.resolution_arcsec / 3600.0
    assert law.speed_steps_s * played_step_deg == pytest.approx(SPEED_DEG_S, rel=0.01)
    sent_s, replied_s = (
        (time_ns - ORIGIN_NS) * 1e-9
        for time_ns in (order_exchange.request_ns, order_exchange.reply_ns)
    )
    assert sent_s <= time_s <= replied_s


def test_polls_give_the_position_at_their_time(bench: Bench) -> None:
    unit = bench.open()
    bench.start(unit)
    facts, played = unit.facts.pan, bench.emulated.stage.pan
    seen = 0
    while bench.axis_turns(Axis.PAN):
        poll = bench.driver.poll()
        if Axis.PAN not in poll.steps:
            continue
        seen += 1
        counts = [
            played.count((time_ns - ORIGIN_NS) * 1e-9) * played.truth.resolution_arcsec
            for time_ns in (poll.earliest_ns, poll.latest_ns)
        ]
        step_arcsec = facts.resolution_arcsec
        arcsec = poll.steps[Axis.PAN] * step_arcsec
        assert counts[0] - step_arcsec <= arcsec <= counts[1] + step_arcsec
    assert seen > 5


def test_halt_stops_the_unit(bench: Bench) -> None:
    unit = bench.open()
    bench.start(unit)
    bench.driver.halt()
    bench.wait(STOPS_WITHIN_S)
    assert not bench.turns()
    assert abs(bench.angle_deg(Axis.PAN)) < 35.0


def test_the_halt_bytes_stop_the_unit_after_any_part_of_a_command(bench: Bench) -> None:
    unit = bench.open()
    first = len(bench.exchanges)
    bench.start(unit)
    commands = [exchange.command.encode() for exchange in bench.exchanges[first:]]
    parts = {command[:size] for command in commands for size in range(len(command))}
    for part in sorted(parts):
        if part:
            bench.driver.halt()
            bench.start(unit, 1 if bench.angle_deg(Axis.PAN) < 0.0 else -1)
        bench.hub.write("ptu", part)
        bench.hub.write("ptu", bench.driver.halt_bytes)
        bench.wait(STOPS_WITHIN_S)
        assert not bench.turns(), f"the unit turns after {part!r} and the halt bytes"


def test_the_acquisition_process_halts_the_unit_in_its_language(bench: Bench) -> None:
    bench.start(bench.open())
    settings = make_port_settings(bench.rig.config, {PTU_PORT: "/dev/none"})[PTU_PORT]
    sent = SupervisedPort(0, PortSettings(**json.loads(json.dumps(asdict(settings)))))
    bench.hub.write(PTU_PORT, sent.final_command)
    bench.wait(STOPS_WITHIN_S)
    assert not bench.turns()


def test_lost_commands_and_replies_move_nothing_wrongly(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    unit = bench.open()
    write, dice = bench.hub.write, random.Random(5)

    def lossy(port: str, data: bytes) -> object:
        is_lost = port == "ptu" and dice.random() < 0.05
        return write(port, b"" if is_lost else data)

    monkeypatch.setattr(bench.hub, "write", lossy)
    for angle_deg in (10.0, -10.0, 5.0):
        bench.move(unit, {Axis.PAN: angle_deg})
        step_deg = unit.facts.pan.resolution_arcsec / 3600.0
        assert bench.angle_deg(Axis.PAN) == pytest.approx(angle_deg, abs=step_deg)


def test_damaged_replies_raise_nothing_but_device_errors(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    unit = bench.open()
    read, dice = bench.hub.read, random.Random(7)

    def noisy(deadline_ns: int) -> Chunk | None:
        chunk = read(deadline_ns)
        if chunk is None or chunk.port != "ptu" or not chunk.data or dice.random() > 0.2:
            return chunk
        data = bytearray(chunk.data)
        data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
        data += dice.randbytes(dice.randrange(4))
        return chunk._replace(data=bytes(data))

    monkeypatch.setattr(bench.hub, "read", noisy)
    for angle_deg in (10.0, -10.0):
        with suppress(DeviceError):
            bench.move(unit, {Axis.PAN: angle_deg})
    monkeypatch.undo()
    bench.driver.halt()
    bench.wait(STOPS_WITHIN_S)
    assert not bench.turns()


def test_a_refusal_is_not_an_acknowledgement(bench: Bench) -> None:
    unit = bench.open()
    facts = unit.facts.pan
    beyond = AxisTarget(Axis.PAN, facts.max_steps + facts.to_speed(5.0), facts.to_speed(5.0))
    with pytest.raises(DeviceError):
        bench.driver.start_move([beyond])
    bench.wait(0.2)
    assert not bench.turns()


def test_a_silent_line_is_reported(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    write = bench.hub.write
    monkeypatch.setattr(bench.hub, "write", lambda port, _: write(port, b""))
    with pytest.raises(DeviceError):
        bench.driver.identify()


def test_the_unit_of_another_driver_is_never_moved(driver: str) -> None:
    other = "scpi_table" if driver != "scpi_table" else "directed_perception"
    bench = Bench(driver, other)
    with pytest.raises(DeviceError):
        bench.driver.identify()
    assert not bench.turns()


def test_an_unplugged_unit_is_halted_when_it_returns(bench: Bench) -> None:
    unit = bench.open()
    bench.start(unit)
    now_ns = bench.hub.now_ns()
    bench.hub.unplug("ptu", now_ns + 10_000_000, now_ns + 200_000_000)
    bench.wait(0.2 + STOPS_WITHIN_S)
    assert not bench.turns()
    assert abs(bench.angle_deg(Axis.PAN)) < 35.0
    with pytest.raises(DeviceError):
        bench.start(unit)


def test_doctor_and_halt_work_without_the_daemon(bench: Bench, tmp_path: Path) -> None:
    unit = bench.open(PtuSettings())  # a unit can need seconds for a change of the acceleration
    bench.start(unit)
    commands = [exchange.command.encode() for exchange in bench.exchanges]
    config = parse_rig(rig_text(bench.driver.name), "rig.yaml")
    emulated = EmulatedRig(emulated_rig_settings(config, 3), raw_now_ns())
    server, ended = PtyServer(emulated), threading.Event()
    thread = threading.Thread(target=server.run, args=(ended.is_set,))
    thread.start()
    try:
        port = server.paths["ptu"]
        findings = check_unit(PtuPort(port=port, driver=bench.driver.name, baud=115200))
        assert findings
        assert all(finding.level < Level.FAULT for finding in findings), findings
        assert not emulated.stage.pan.commands, "the doctor has moved the unit"
        with open_for_check(port, 115200) as fd:
            for command in commands:
                os.write(fd, command)
                time.sleep(0.03)
                os.read(fd, 4096)
        assert emulated.stage.pan.is_moving(since_origin_s(emulated))
        rig = tmp_path / "rig.yaml"
        rig.write_text(rig_text(bench.driver.name, port), encoding="utf-8")
        assert gyrorigd(["halt", "--config", str(rig)]) == 0
        assert not emulated.stage.pan.is_moving(since_origin_s(emulated))
    finally:
        ended.set()
        thread.join()
        server.close()


def since_origin_s(rig: EmulatedRig) -> float:
    return (raw_now_ns() - rig.origin_ns) * 1e-9
