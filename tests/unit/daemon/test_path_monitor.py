"""Positions that no command explains, and the confirmed halt, on units that answer one axis."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from gyrorig_daemon.cli import run
from gyrorig_daemon.motion.executor import PathMonitor, halt_and_confirm
from gyrorig_daemon.motion.ptu_exchange import Exchange, Position, PtuLineCounts
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import Axis

STOP_S = 1.0  # the pan axis moves so long after the halt


def position(
    pan: int, tilt: int, axes: tuple[Axis, ...], request_ns: int = 0, reply_ns: int = 0
) -> Position:
    exchange = cast(Exchange, SimpleNamespace(request_ns=request_ns, reply_ns=reply_ns))
    has_pan, has_tilt = Axis.PAN in axes, Axis.TILT in axes
    return Position(exchange, pan, tilt, has_pan, has_tilt, None, None, 0, 0, False)


@pytest.mark.parametrize("in_turn", [False, True])
def test_positions_that_no_command_explains_end_the_session(in_turn: bool) -> None:
    """On a D46 each reply has one axis; plausible replies of tilt do not excuse those of pan."""
    counts = PtuLineCounts()
    monitor = PathMonitor(cast(Any, SimpleNamespace(counts=counts)))
    monitor.expect({Axis.PAN: 0, Axis.TILT: 0}, {})
    both = (Axis.PAN, Axis.TILT)
    replies = [position(5000, 0, (both[number % 2],) if in_turn else both) for number in range(20)]
    with pytest.raises(DeviceError, match="reports the pan position 5000 steps"):
        list(map(monitor.check, replies))
    assert counts.implausible == 3


def test_single_implausible_replies_are_only_counted() -> None:
    counts = PtuLineCounts()
    monitor = PathMonitor(cast(Any, SimpleNamespace(counts=counts)))
    monitor.expect({Axis.PAN: 0, Axis.TILT: 0}, {})
    for number in range(30):
        monitor.check(position(5000 if number % 3 == 0 else 0, 0, (Axis.PAN,)))
    assert counts.implausible == 10


@pytest.mark.parametrize("in_turn", [False, True])
@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 20.0])
def test_a_halt_is_confirmed_after_each_axis_has_stopped(in_turn: bool, rate_hz: float) -> None:
    class Clock:
        ns = 0

        def now_ns(self) -> int:
            return self.ns

    clock = Clock()
    numbers = iter(range(1000))
    pan: list[int] = []  # an axis that was not polled keeps its last position

    def poll(checked: bool) -> Position:
        assert not checked
        request_ns = clock.ns
        clock.ns += round(1e9 / rate_hz)
        both = (Axis.PAN, Axis.TILT)
        axes = (both[next(numbers) % 2],) if in_turn else both
        if Axis.PAN in axes:
            pan.append(int(1000.0 * min(request_ns * 1e-9, STOP_S)))
        return position(pan[-1], 0, axes, request_ns, request_ns + 20_000_000)

    driver = SimpleNamespace(halt=lambda: None)
    halt_and_confirm(
        cast(Any, clock),
        cast(Any, SimpleNamespace(driver=driver)),
        cast(Any, SimpleNamespace(poll=poll)),
    )
    assert clock.ns >= (STOP_S + 0.3) * 1e9


def test_a_move_of_the_missing_axis_to_zero_is_no_move(tmp_path: Path) -> None:
    """A table with one axis accepts tilt 0, because programs for two axes contain it."""
    rig, program = tmp_path / "rig.yaml", tmp_path / "program.yaml"
    rig.write_text(
        "rig: r\nptu: {port: emulated, driver: scpi_table}\nboards: [{id: B-1, port: emulated}]\n"
    )
    program.write_text("name: one\nsteps:\n  - move: {tilt_deg: 0.0}\n  - rest: {seconds: 1.0}\n")
    words = ["record", "--config", str(rig), "--program", str(program), "--simulated-time"]
    assert run([*words, "--out", str(tmp_path)]) == 0
    assert len(list(tmp_path.glob("*.mcap"))) == 1
