"""Adapters through python-can: its virtual interface on the other side."""

import select
import time
from collections.abc import Iterator

import can
import pytest

from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.links.can.python_can_line import PythonCanLine
from gyrorig_daemon.links.can.socketcan_line import open_line
from gyrorig_daemon.links.ports.port_kinds import Line, PortSettings
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.links.ports.serial_port import PortRefusedError
from gyrorig_protocol.can import CanFrame, pack_frames, unpack_frames

PATIENCE_S = 60.0


@pytest.fixture
def line() -> Iterator[Line]:
    opened = open_line(PortSettings("python-can:virtual:bench", 1_000_000, kind="can"))
    assert isinstance(opened, PythonCanLine)
    yield opened
    opened.close()


@pytest.fixture
def other() -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel="bench") as bus:
        yield bus


def read_frames(line: Line, count: int) -> list[CanFrame]:
    frames: list[CanFrame] = []
    poll = select.poll()
    poll.register(line.fd, select.POLLIN)
    end_s = time.monotonic() + PATIENCE_S
    while len(frames) < count and time.monotonic() < end_s:
        if poll.poll(100):
            frames += unpack_frames(line.read(), 0)
    return frames


def test_frames_are_sent_and_received_with_our_echo(line: Line, other: can.BusABC) -> None:
    before_ns = raw_ns()
    other.send(can.Message(arbitration_id=0x291, data=b"abc", is_extended_id=False))
    other.send(can.Message(arbitration_id=0x1ABCDEF, is_extended_id=True))
    other.send(can.Message(arbitration_id=7, data=bytes(12), is_fd=True, is_extended_id=False))
    received = read_frames(line, 3)
    assert [(f.identifier, f.data, f.flags) for f in received] == [
        (0x291, b"abc", 0),
        (0x1ABCDEF, b"", 1),
        (0, b"", 16),
    ]
    assert before_ns <= received[0].timestamp_ns <= raw_ns()
    line.write(pack_frames([CanFrame(0x80, b"\5")]))
    message = other.recv(PATIENCE_S)
    assert message is not None
    assert (message.arbitration_id, bytes(message.data)) == (0x80, b"\5")
    (echo,) = read_frames(line, 1)
    assert (echo.identifier, echo.data) == (0x80, b"\5")


def test_a_missing_bus_blocks_nothing(line: Line) -> None:
    with pytest.raises(BlockingIOError):
        line.read()


@pytest.mark.parametrize("path", ["python-can:nothere:0", "python-can:slcan:/dev/nothere"])
def test_a_bus_that_cannot_be_opened_is_rejected(path: str) -> None:
    with pytest.raises(PortRefusedError) as caught:
        open_line(PortSettings(path, 1_000_000, kind="can"))
    assert "\n" not in str(caught.value)


def test_an_error_of_the_library_is_a_lost_port(
    line: PythonCanLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(timeout: float | None = None) -> can.Message | None:
        raise can.CanOperationError("the adapter is gone")

    monkeypatch.setattr(line._bus, "recv", fail)
    poll = select.poll()
    poll.register(line.fd, select.POLLIN)
    assert poll.poll(PATIENCE_S * 1000)
    assert line.read() == b""


def test_such_a_bus_in_a_rig() -> None:
    rig = parse_rig(
        "rig: a\nptu: {port: /dev/ptu}\n"
        "buses: [{id: can0, port: 'python-can:slcan:/dev/ttyACM0'}]\n"
        "boards: [{id: A, bus: can0, node: 1}]",
        "rig.yaml",
    )
    assert rig.ports()["bus:can0"] == "python-can:slcan:/dev/ttyACM0"
