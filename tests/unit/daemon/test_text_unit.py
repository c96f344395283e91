"""Units of text lines: a rate table under a simulated clock, and what its line can do wrong."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.links.ports.port_hub import Chunk, WriteTimes
from gyrorig_daemon.links.pump import StopFlag, StopRequestedError
from gyrorig_daemon.motion import (
    AxisTarget,
    Exchange,
    Executor,
    Homing,
    PhaseSink,
    Position,
    PositionPoller,
    Unit,
    driver_names,
    find_driver,
    halt_and_confirm,
    open_unit,
    plan_program,
)
from gyrorig_daemon.motion.drivers.scpi_table import LANGUAGE
from gyrorig_daemon.motion.text_language import read_number
from gyrorig_daemon.session.connected_rig import Rig
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_protocol.errors import DeviceError, UsageError
from gyrorig_protocol.motion_orders import OrderKind
from gyrorig_protocol.program import PtuSettings, parse_program
from gyrorig_protocol.ptu import Axis

ORIGIN_NS = 5_000_000_000
RIG = """
rig: test
ptu: {port: emulated, driver: scpi_table, baud: 115200}
boards: [{id: B-1, port: emulated, baud: 460800}]
emulator: {command_time_ms: 5.0}
"""
FAR = "name: far\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 10.0}\n"  # 15 s


class Bench:
    """An emulated rate table behind its driver."""

    def __init__(self, text: str = RIG) -> None:
        self.config = parse_rig(text, "rig.yaml")
        self.emulated = EmulatedRig(emulated_rig_settings(self.config, 3), ORIGIN_NS)
        self.hub = VirtualHub(self.emulated)
        capture = CaptureClock(1_790_000_000_000_000_000, ORIGIN_NS)
        self.stop = StopFlag()
        self.rig = Rig(self.hub, self.config, capture, stop=self.stop, seed=1)
        self.driver, self.pump = self.rig.driver, self.rig.pump

    def open(self) -> Unit:
        self.driver.identify()
        return open_unit(self.driver, PtuSettings(acceleration_deg_s2=50.0), Homing.NEVER)

    def moving(self, unit: Unit, program: str = FAR) -> Callable[[], None]:
        """Return what carries out a program."""
        positions: list[Position] = []
        poller = PositionPoller(unit, None, positions.append)
        start = poller.read_positions()
        limits = self.config.ptu.limits
        steps = plan_program(parse_program(program, "far.yaml"), unit.facts, limits, start)
        phases = PhaseSink(lambda *_: None, lambda *_: None)
        executor = Executor(self.pump, unit, poller, phases)
        return lambda: executor.run(steps, lambda _: None)

    def turns(self) -> bool:
        """Ask the truth: the stage turns in the next tenth of a second."""
        now_s = (self.hub.now_ns() - ORIGIN_NS) * 1e-9
        return bool(np.any(self.emulated.stage.body_rates_rad_s(now_s, 0.01, 10)))

    def pan_deg(self) -> float:
        now_s = (self.hub.now_ns() - ORIGIN_NS) * 1e-9
        return self.emulated.stage.pan.count(now_s) * 1e-4


def at_ns(seconds: float) -> int:
    return ORIGIN_NS + round(seconds * 1e9)


def test_the_drivers_are_found_by_listing_their_folder() -> None:
    assert {"directed_perception", "scpi_table"} <= set(driver_names())
    for name in driver_names():
        assert find_driver(name).title


def test_the_table_is_read_and_moves() -> None:
    bench = Bench()
    unit = bench.open()
    facts = unit.facts
    assert (facts.model, facts.serial, facts.driver) == ("RATE TABLE", "RT-0001", "scpi_table")
    assert (facts.pan.min_steps, facts.pan.max_steps) == (-3_600_000, 3_600_000)
    assert (facts.pan.base_speed, facts.pan.acceleration) == (0, 500_000)
    assert facts.axes == (Axis.PAN,)
    bench.moving(unit)()
    assert bench.pan_deg() == 150.0
    halt_and_confirm(bench.pump, unit, PositionPoller(unit, None, lambda _: None))
    assert not bench.turns()


def test_orders_are_neutral_and_text_is_verbatim() -> None:
    bench = Bench()
    seen: list[Exchange] = []
    bench.driver._line._on_exchange = seen.append  # type: ignore[attr-defined]
    unit = bench.open()
    bench.moving(unit)()
    ordered = [
        (exchange.command.text, order.kind, order.value)
        for exchange in seen
        for order in exchange.orders
        if exchange.accepted
    ]
    assert ordered[-2:] == [
        ("VEL 10;:SYST:ERR?", OrderKind.SPEED, 100_000.0),
        ("POS 150;:SYST:ERR?", OrderKind.TARGET, 1_500_000.0),
    ]
    assert ordered[0] == ("ABOR;:SYST:ERR?", OrderKind.HALT, 0.0)


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ("{pan_deg: 400.0}", "turns the pan axis to 400 deg, but its limits"),
        ("{pan_deg: 40.0, speed_deg_s: 500.0}", "turns the pan axis at 500 deg/s"),
        ("{tilt_deg: 5.0}", "the unit has no tilt axis"),
    ],
)
def test_what_the_table_cannot_do_is_refused_before_it_moves(step: str, message: str) -> None:
    bench = Bench()
    unit = bench.open()
    with pytest.raises(UsageError, match=message):
        bench.moving(unit, f"name: p\nsteps:\n  - move: {step}\n")
    assert not bench.turns()


def test_a_home_step_moves_the_axes_that_exist() -> None:
    bench = Bench()
    unit = bench.open()
    bench.moving(unit, "name: p\nsteps:\n  - move: {pan_deg: 9.0}\n  - home: {}\n")()
    assert bench.pan_deg() == 0.0


def test_a_unit_unplugged_in_motion_is_halted_on_return() -> None:
    bench = Bench()
    unit = bench.open()
    run = bench.moving(unit)
    gone_s = (bench.hub.now_ns() - ORIGIN_NS) * 1e-9 + 2.0
    bench.hub.unplug("ptu", at_ns(gone_s), at_ns(gone_s + 3.0))
    with pytest.raises(DeviceError, match="unplugged"):
        run()
    assert bench.turns()
    bench.pump.run_until(at_ns(gone_s + 3.6))
    assert (bench.driver.is_port_gone, bench.turns()) == (False, False)
    with pytest.raises(DeviceError, match="position is not known"):
        bench.driver.start_move([AxisTarget(Axis.PAN, 0, 1000)])
    bench.open()
    assert bench.driver.counts.hung_up == 1


def test_a_stop_in_the_middle_of_an_exchange_halts_at_once() -> None:
    bench = Bench()
    unit = bench.open()
    run = bench.moving(unit)
    fires_ns = bench.hub.now_ns() + 3_000_000_000

    class StopTimer:
        due_ns = fires_ns

        def fire(self, now_ns: int) -> None:
            self.due_ns = now_ns + 10**15
            bench.stop.request("stop")

    bench.pump.add_timer(StopTimer())
    with pytest.raises(StopRequestedError):
        run()
    assert bench.turns()
    bench.pump.ignore_stop()
    before_ns = bench.hub.now_ns()
    bench.driver.halt()
    halts = [order[1] for order in bench.emulated.stage.pan.commands if order[0] == "halt"]
    assert halts[-1] <= (before_ns - ORIGIN_NS) * 1e-9 + 0.5
    bench.pump.run_until(bench.hub.now_ns() + 500_000_000)
    assert not bench.turns()


def test_a_lost_reply_is_not_taken_for_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    unit = bench.open()
    run = bench.moving(unit)
    write, begun_ns = bench.hub.write, bench.hub.now_ns()
    lost: list[bytes] = []

    def drop(port: str, data: bytes) -> object:
        if port == "ptu" and b"POS?" in data and bench.hub.now_ns() > begun_ns + 10**9 and not lost:
            lost.append(data)
            return write(port, b" ")
        return write(port, data)

    monkeypatch.setattr(bench.hub, "write", drop)
    run()
    assert lost
    assert bench.driver.counts.timeouts == 1
    assert bench.pan_deg() == 150.0


def test_a_superfluous_line_does_not_shift_the_positions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before, the reply to each poll was taken for that to the next one."""
    bench = Bench(RIG.replace("command_time_ms: 5.0", "command_time_ms: 40.0"))
    bench.open()
    bench.driver.set_poll_rate(100.0)
    bench.driver.start_move([AxisTarget(Axis.PAN, 1_500_000, 100_000)])
    write, pushed_ns = bench.hub.write, bench.hub.now_ns() + 10**9

    def add_line(port: str, data: bytes) -> object:
        nonlocal pushed_ns
        times = write(port, data)
        if b"POS?" in data and 0 < pushed_ns < bench.hub.now_ns():
            bench.hub._push(bench.hub.now_ns() + 2_000_000, "ptu", b'-350,"Queue overflow"\n')
            pushed_ns = 0
        return times

    monkeypatch.setattr(bench.hub, "write", add_line)
    polls = [bench.driver.poll() for _ in range(60)]
    assert pushed_ns == 0
    assert sum(not poll.steps for poll in polls) == 1
    assert bench.driver.counts.stale == 1  # the reply to the poll that got the line
    for poll in polls:
        earliest, latest = (
            bench.emulated.stage.pan.count((ns - ORIGIN_NS) * 1e-9)
            for ns in (poll.earliest_ns, poll.latest_ns)
        )
        assert all(earliest <= steps <= latest for steps in poll.steps.values())


def test_a_reply_from_before_the_query_is_discarded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The event loop reads it after it has written the query, whose reply it could be."""
    bench = Bench()
    bench.open()
    write, read = bench.hub.write, bench.hub.read
    unread: list[Chunk] = []

    def write_late(port: str, data: bytes) -> WriteTimes:
        times = write(port, data)
        unread.append(Chunk("ptu", times.before_ns - 1, b"99.0\n"))
        return times

    monkeypatch.setattr(bench.hub, "write", write_late)
    monkeypatch.setattr(bench.hub, "read", lambda end: unread.pop() if unread else read(end))
    assert bench.driver.poll().steps == {Axis.PAN: 0}
    assert bench.driver.counts.stale == 1


def test_another_device_on_the_port_is_never_moved() -> None:
    other = RIG.replace("driver: scpi_table, ", "")
    bench = Bench(other)
    assert bench.emulated.ptu is not None
    table = parse_rig(RIG, "rig.yaml")
    rig = Rig(bench.hub, table, bench.rig.capture, stop=StopFlag(), seed=1)
    with pytest.raises(DeviceError, match="is not a unit of the driver scpi_table"):
        rig.driver.identify()
    with pytest.raises(DeviceError, match="position is not known"):
        rig.driver.start_move([AxisTarget(Axis.PAN, 100, 100)])
    assert not bench.turns()


def test_a_silent_table_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    write = bench.hub.write
    monkeypatch.setattr(bench.hub, "write", lambda port, data: write(port, b" "))
    with pytest.raises(DeviceError, match="no pan-tilt unit answers"):
        bench.driver.identify()


def test_words_of_the_rig_file_replace_those_of_the_driver() -> None:
    commands = {"target": "GOTO {value}", "positions": "P(?P<pan>.*)"}
    language = LANGUAGE.with_commands(commands)
    assert language.format(language.target, Axis.PAN, -1.25) == "GOTO -1.25"
    assert language.read_positions("P1.5", Axis.PAN) == ({Axis.PAN: 15000}, None)
    assert language.read_positions("1.5", Axis.PAN) == ({}, None)
    with pytest.raises(UsageError, match="Did you mean target"):
        LANGUAGE.with_commands({"targt": "x"})
    with pytest.raises(UsageError, match="not a regular expression"):
        LANGUAGE.with_commands({"accepted": "("})


@pytest.mark.parametrize(("text", "number"), [("-1.5e1 deg", -15.0), ("+.5", 0.5), ("x", None)])
def test_numbers_in_replies(text: str, number: float | None) -> None:
    assert read_number(text) == number


def test_a_reply_that_repeats_the_axis_needs_the_pattern_of_its_number() -> None:
    words = {"positions": "[12]=(?P<value>[-+]?[0-9]+)", "position": "{axis} POS?"}
    first = replace(LANGUAGE, unit_deg=0.001, resolution_deg=0.001).with_commands(words)
    assert first.read_value_deg("2=-60000") == 0.002
    language = first.with_commands({"number": "=(?P<value>[-+]?[0-9]+)"})
    assert language.read_value_deg("2=-60000") == -60.0
    assert language.read_value_deg("2") is None
    assert language.read_positions("2=+12345", Axis.TILT) == ({Axis.TILT: 12345}, None)
