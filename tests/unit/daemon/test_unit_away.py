"""The unit is unplugged in motion and comes back: halted first, identified, and then moved."""

import re
from collections.abc import Callable

import numpy as np
import pytest

from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import RigConfig, parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.links.ports.port_hub import Chunk
from gyrorig_daemon.links.pump import StopFlag
from gyrorig_daemon.motion import (
    Executor,
    Homing,
    PhaseSink,
    Position,
    PositionPoller,
    Unit,
    halt_and_confirm,
    open_unit,
    plan_program,
)
from gyrorig_daemon.motion.directed_perception.unit_setup import identify_unit
from gyrorig_daemon.motion.drivers.directed_perception import DirectedPerceptionUnit
from gyrorig_daemon.session.connected_rig import Rig
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_protocol.errors import DeviceError, UsageError
from gyrorig_protocol.program import PtuSettings, parse_program
from gyrorig_protocol.ptu import Axis, Quantity, assign_quantity

ORIGIN_NS = 5_000_000_000
RIG = """
rig: test
ptu: {port: emulated, baud: 115200}
boards: [{id: B-1, port: emulated, baud: 460800}]
emulator: {command_time_ms: 5.0}
"""
FAR = "name: far\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 10.0}\n"  # 15 s
MOVE = assign_quantity(Axis.PAN, Quantity.POSITION, 0)


def at_ns(seconds: float) -> int:
    return ORIGIN_NS + round(seconds * 1e9)


class Bench:
    """An emulated rig that is known and about to move."""

    def __init__(self, text: str = RIG) -> None:
        self.config: RigConfig = parse_rig(text, "rig.yaml")
        self.emulated = EmulatedRig(emulated_rig_settings(self.config, 3), ORIGIN_NS)
        self.hub = VirtualHub(self.emulated)
        capture = CaptureClock(1_790_000_000_000_000_000, ORIGIN_NS)
        self.rig = Rig(self.hub, self.config, capture, stop=StopFlag(), seed=1)
        driver = self.rig.driver
        assert isinstance(driver, DirectedPerceptionUnit)
        self.driver, self.client, self.pump = driver, driver.client, self.rig.pump
        self.positions: list[Position] = []

    def open(self) -> Unit:
        self.driver.identify()
        for board in self.rig.boards:
            board.identify()
        return open_unit(self.driver, PtuSettings(), Homing.NEVER)

    def moving(self, unit: Unit) -> Callable[[], None]:
        """Return what carries out a long move."""
        poller = PositionPoller(unit, None, self.positions.append)
        start = poller.read_positions()
        steps = plan_program(
            parse_program(FAR, "far.yaml"), unit.facts, self.config.ptu.limits, start
        )
        phases = PhaseSink(lambda *_: None, lambda *_: None)
        executor = Executor(self.pump, unit, poller, phases)
        return lambda: executor.run(steps, lambda _: None)

    def turns(self) -> bool:
        """Ask the truth: the stage turns in the next tenth of a second."""
        now_s = (self.hub.now_ns() - ORIGIN_NS) * 1e-9
        return bool(np.any(self.emulated.stage.body_rates_rad_s(now_s, 0.01, 10)))

    def now_s(self) -> float:
        return (self.hub.now_ns() - ORIGIN_NS) * 1e-9


def test_a_unit_unplugged_in_motion_is_halted_on_return() -> None:
    bench = Bench()
    unit = bench.open()
    gone_s = bench.now_s() + 2.0
    bench.hub.unplug("ptu", at_ns(gone_s), at_ns(gone_s + 3.0))
    with pytest.raises(DeviceError, match="unplugged"):
        bench.moving(unit)()
    assert bench.turns()  # it goes on with its last order, and nobody can say anything
    with pytest.raises(DeviceError, match="unplugged"):
        bench.client.halt()
    bench.pump.run_until(at_ns(gone_s + 2.9))
    assert (bench.client.is_port_gone, bench.turns()) == (True, True)
    bench.pump.run_until(at_ns(gone_s + 3.6))
    assert (bench.client.is_port_gone, bench.turns()) == (False, False)
    assert not bench.client.is_identified
    with pytest.raises(DeviceError, match="position is not known"):
        bench.client.send_command(MOVE)
    assert not bench.turns()
    assert identify_unit(bench.client).controller
    again = bench.open()
    assert again.facts == unit.facts
    assert PositionPoller(again, None, bench.positions.append).read_positions()[Axis.PAN] > 300
    bench.client.send_command(MOVE)
    bench.pump.run_until(bench.pump.now_ns() + 500_000_000)
    assert bench.turns()
    assert bench.client.counts.hung_up == 1
    (board,) = bench.rig.boards
    assert (board.counts.missing, board.counts.hung_up) == (0, 0)


@pytest.mark.parametrize("away_s", [0.001, 0.02, 0.3])
def test_a_short_interruption_ends_the_motion_too(away_s: float) -> None:
    bench = Bench()
    unit = bench.open()
    gone_s = bench.now_s() + 2.0
    bench.hub.unplug("ptu", at_ns(gone_s), at_ns(gone_s + away_s))
    with pytest.raises(DeviceError, match=r"unplugged|position is not known"):
        bench.moving(unit)()
    bench.pump.run_until(at_ns(gone_s + away_s + 0.5))
    assert not bench.turns()
    known = len(bench.positions)
    halt_and_confirm(bench.pump, unit, PositionPoller(unit, None, bench.positions.append))
    assert all(position.synchrony_lost for position in bench.positions[known:])


def test_another_device_on_the_units_port_is_never_moved() -> None:
    bench = Bench()
    unit = bench.open()
    gone_s = bench.now_s() + 2.0
    for port in ("ptu", "board:B-1"):
        bench.hub.unplug(port, at_ns(gone_s), at_ns(gone_s + 1.0))
    with pytest.raises(DeviceError, match="unplugged"):
        bench.moving(unit)()
    bench.pump.run_until(at_ns(gone_s + 0.5))
    bench.hub.swap("ptu", "board:B-1")
    bench.pump.run_until(at_ns(gone_s + 1.5))
    with pytest.raises(DeviceError, match="is not a pan-tilt unit"):
        identify_unit(bench.client)
    with pytest.raises(DeviceError, match="position is not known"):
        bench.client.send_command(MOVE)


def test_a_unit_that_is_connected_late_is_not_identified_yet() -> None:
    bench = Bench()
    bench.hub.unplug("ptu", ORIGIN_NS, at_ns(3.0))
    bench.pump.run_until(at_ns(1.0))
    assert bench.client.is_port_gone
    with pytest.raises(DeviceError, match="unplugged"):
        identify_unit(bench.client)
    bench.pump.run_until(at_ns(3.5))
    assert bench.open().facts.serial == "E46-0001"


def named(serial: str, dialect: str = "e46") -> str:
    text = RIG.replace("baud: 115200}", f"baud: 115200, serial: {serial}}}", 1)
    return text.replace("emulator: {", f"emulator: {{dialect: {dialect}, ")


def test_the_configured_serial_number_is_accepted() -> None:
    assert Bench(named("E46-0001")).open().facts.serial == "E46-0001"


def test_a_unit_with_another_serial_number_is_not_moved() -> None:
    with pytest.raises(DeviceError, match=r"number 'E46-0001' instead of 'E46-0002'.*did not move"):
        Bench(named("E46-0002")).open()


def test_a_serial_number_needs_a_dialect_that_reports_it() -> None:
    with pytest.raises(UsageError, match=r"Remove ptu\.serial"):
        Bench(named("x", "d46")).open()


TWO = """
name: two
steps:
  - move: {pan_deg: 10.0, tilt_deg: 5.0, speed_deg_s: 40.0}
  - rest: {seconds: 1.0}
  - move: {pan_deg: 20.0, speed_deg_s: 40.0}
  - rest: {seconds: 1.0}
"""


def run_two(bench: Bench, answer: Callable[[Chunk, int], Chunk]) -> None:
    """Carry the program out while each of the unit's answers goes through `answer`."""
    unit = bench.open()
    read, count = bench.hub.read, 0

    def changed(deadline_ns: int) -> Chunk | None:
        nonlocal count
        chunk = read(deadline_ns)
        if chunk is None or chunk.port != "ptu":
            return chunk
        count += 1
        return answer(chunk, count)

    poller = PositionPoller(unit, None, bench.positions.append)
    steps = plan_program(
        parse_program(TWO, "two.yaml"), unit.facts, bench.config.ptu.limits, poller.read_positions()
    )
    bench.hub.read = changed  # type: ignore[method-assign]
    phases = PhaseSink(lambda *_: None, lambda *_: None)
    Executor(bench.pump, unit, poller, phases).run(steps, lambda _: None)


def shifted(chunk: Chunk) -> Chunk:
    """Return an answer to BT in which pan is 1000 steps elsewhere."""
    data = re.sub(rb"P\((-?\d+),", lambda m: b"P(%d," % (int(m[1]) + 1000), chunk.data)
    return chunk._replace(data=data)


def test_one_implausible_position_is_tolerated() -> None:
    bench = Bench()
    run_two(bench, lambda chunk, count: shifted(chunk) if count % 40 == 0 else chunk)
    assert bench.client.counts.implausible > 2


@pytest.mark.parametrize("from_count", [90, 130])
def test_implausible_positions_end_the_program(from_count: int) -> None:
    bench = Bench()
    with pytest.raises(
        DeviceError, match=r"reports the pan position \d+ steps, but its commands allow"
    ):
        run_two(bench, lambda chunk, count: shifted(chunk) if count > from_count else chunk)
    assert bench.client.counts.implausible == 3
