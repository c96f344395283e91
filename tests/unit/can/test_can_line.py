"""CAN readers of the acquisition: exchange with python-can, timestamps and drops of the kernel."""

import select
import socket
import struct
import time

import can
import msgpack  # type: ignore[import-untyped]
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrorig_daemon.links.can import can_socket
from gyrorig_daemon.links.can.multicast_line import (
    MulticastLine,
    multicast_datagram,
    multicast_record,
)
from gyrorig_daemon.links.can.socketcan_line import SocketCanLine, open_line, socketcan_record
from gyrorig_daemon.links.ports.port_kinds import Line, PortSettings
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.links.ports.serial_port import PortRefusedError
from gyrorig_protocol.can import CanFrame, FrameFlag, pack_frames, unpack_frames

GROUP, LOOPBACK = "239.74.163.7", "127.0.0.1"
PATIENCE_S = 60.0


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((GROUP, 0))
        return int(probe.getsockname()[1])


def read_frames(line: Line, count: int) -> list[CanFrame]:
    frames: list[CanFrame] = []
    poll = select.poll()
    poll.register(line.fd, select.POLLIN)
    end_s = time.monotonic() + PATIENCE_S
    while len(frames) < count and time.monotonic() < end_s:
        if poll.poll(100):
            frames += unpack_frames(line.read(), 0)
    return frames


def test_the_echo_has_the_timestamp_of_the_kernel() -> None:
    line = MulticastLine(GROUP, free_port(), LOOPBACK)
    try:
        before_ns = raw_ns()
        frames = [CanFrame(0x80, b"\7"), CanFrame(0x1ABCDEF, b"", 1)]
        data = pack_frames(frames)
        assert line.write(data) == 24
        assert line.write(data[24:]) == 24
        received = read_frames(line, 2)
        after_ns = raw_ns()
    finally:
        line.close()
    assert [(f.identifier, f.data, f.flags) for f in received] == [
        (f.identifier, f.data, f.flags) for f in frames
    ]
    for frame in received:
        # both clocks are read in turn: a stall between the two readings shifts the timestamp
        assert before_ns - 50_000_000 < frame.timestamp_ns < after_ns + 50_000_000


def test_frames_are_exchanged_with_python_can() -> None:
    port = free_port()
    try:
        line = MulticastLine(GROUP, port)
    except OSError as fault:
        pytest.skip(f"python-can needs a network interface with multicast: {fault}")
    bus = can.Bus(interface="udp_multicast", channel=GROUP, port=port)
    try:
        bus.send(can.Message(arbitration_id=0x291, data=b"abc", is_extended_id=False))
        bus.send(can.Message(arbitration_id=0x1F0F0F0F, data=bytes(8), is_extended_id=True))
        bus.send(can.Message(arbitration_id=5, is_remote_frame=True, is_extended_id=False))
        bus.send(can.Message(arbitration_id=6, data=bytes(64), is_fd=True, is_extended_id=False))
        received = [(f.identifier, f.data, f.flags) for f in read_frames(line, 4)]
        assert received == [
            (0x291, b"abc", 0),
            (0x1F0F0F0F, bytes(8), 1),
            (5, b"", 2),
            (0, b"", 16),  # a CAN FD frame is none of ours
        ]
        line.write(pack_frames([CanFrame(0x123, b"xyz")]))
        end_s = time.monotonic() + PATIENCE_S
        message = bus.recv(PATIENCE_S)
        while message is not None and message.arbitration_id != 0x123:
            assert time.monotonic() < end_s
            message = bus.recv(PATIENCE_S)
        assert message is not None
        assert (bytes(message.data), message.is_extended_id) == (b"xyz", False)
    finally:
        line.close()
        bus.shutdown()


def test_frames_dropped_by_the_kernel_are_counted_on_the_socket() -> None:
    line = MulticastLine(GROUP, free_port(), LOOPBACK)
    try:
        line._receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sent = 400
        for number in range(sent):
            line.write(pack_frames([CanFrame(1, struct.pack("<H", number))]))
        received = read_frames(line, 1)
        # The count comes with the next frame that found room; others may still be on their way.
        while not any(f.flags == 0 and f.identifier == 2 for f in received):
            line.write(pack_frames([CanFrame(2, b"")]))
            sent += 1
            received += read_frames(line, 1)
    finally:
        line.close()
    lost = sum(f.identifier for f in received if f.flags == FrameFlag.LOST)
    came = sum(f.flags == 0 for f in received)
    assert lost > 0
    assert lost + came == sent


@settings(deadline=None)
@given(data=st.binary(max_size=64))
def test_any_datagram_is_a_record(data: bytes) -> None:
    (frame,) = unpack_frames(multicast_record(data, 5), 0)
    assert frame.flags == FrameFlag.FOREIGN


@settings(deadline=None)
@given(
    fields=st.fixed_dictionaries(
        {
            "timestamp": st.floats(allow_nan=False),
            "arbitration_id": st.integers(-(2**40), 2**40),
            "is_extended_id": st.booleans(),
            "is_remote_frame": st.booleans(),
            "is_error_frame": st.booleans(),
            "channel": st.none() | st.text(max_size=5),
            "dlc": st.integers(0, 64),
            "data": st.binary(max_size=64),
            "is_fd": st.booleans(),
            "bitrate_switch": st.booleans(),
            "error_state_indicator": st.booleans(),
        }
    )
)
def test_any_message_of_python_can_is_a_record(fields: dict[str, object]) -> None:
    (frame,) = unpack_frames(multicast_record(msgpack.packb(fields), 5), 0)
    identifier, data = fields["arbitration_id"], fields["data"]
    assert isinstance(identifier, int)
    assert isinstance(data, bytes)
    if 0 <= identifier < 2**32 and len(data) <= 8 and not fields["is_fd"]:
        assert (frame.identifier, frame.data) == (identifier, data)
    else:
        assert frame.flags == FrameFlag.FOREIGN


def test_our_datagram_is_python_cans_own() -> None:
    fields = msgpack.unpackb(multicast_datagram(0x123, 1, b"ab"))
    fields["data"] = bytearray(fields["data"])
    message = can.Message(check=True, **fields)
    assert (message.arbitration_id, message.is_extended_id, message.dlc) == (0x123, True, 2)


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        (0x123, (0x123, 0)),
        (0x8000_0000 | 0x1ABCDEF, (0x1ABCDEF, 1)),
        (0x4000_0000 | 0x7FF, (0x7FF, 2)),
        (0x2000_0000 | 0x40, (0x40, 4)),  # an error frame: bus-off
    ],
)
def test_a_kernels_frame_is_read_as_linux_writes_it(word: int, expected: tuple[int, int]) -> None:
    # <linux/can.h> struct can_frame: u32 id and flags, u8 length, 3 bytes, 8 data
    data = struct.pack("=IB3x8s", word, 3, b"abcdefgh")
    (frame,) = unpack_frames(socketcan_record(data, 9), 0)
    assert (frame.identifier, frame.flags) == expected
    assert frame.timestamp_ns == 9
    assert frame.data == (b"abcdefgh" if frame.flags == 4 else b"abc")
    (foreign,) = unpack_frames(socketcan_record(data + bytes(56), 9), 0)  # struct canfd_frame
    assert foreign.flags == FrameFlag.FOREIGN


@pytest.mark.parametrize(
    "path", ["/dev/ttyUSB0", "socketcan:nothere0", "udp_multicast:1.2.3.4:99999", "udp_multicast:x"]
)
def test_an_invalid_bus_is_rejected_with_a_reason(path: str) -> None:
    with pytest.raises(PortRefusedError) as caught:
        open_line(PortSettings(path, 1_000_000, kind="can"))
    assert caught.value.reason in ("missing", "denied", "foreign")


def test_an_interface_of_the_kernel() -> None:
    try:
        line = SocketCanLine("vcan0")
    except OSError as fault:
        pytest.skip(f"no vcan0 here: {fault}")
    try:
        line.write(pack_frames([CanFrame(0x123, b"ab")]))
        (frame,) = read_frames(line, 1)
    finally:
        line.close()
    assert (frame.identifier, frame.data) == (0x123, b"ab")


def test_timestamps_never_decrease_when_clocks_scatter(monkeypatch: pytest.MonkeyPatch) -> None:
    line = MulticastLine(GROUP, free_port(), LOOPBACK)
    exact = can_socket._read_clocks
    count = 0

    def scattered() -> tuple[int, int]:
        nonlocal count
        count += 1
        raw, offset = exact()
        # among them a wall clock that was set by an hour, both ways
        return raw, offset + (-400_000, 300_000, 3_600_000_000_000, 0, -3_600_000_000_000)[
            count % 5
        ]

    monkeypatch.setattr(can_socket, "_read_clocks", scattered)
    try:
        stamps = []
        for _ in range(50):
            line.write(pack_frames([CanFrame(1, b"")]))
            (frame,) = read_frames(line, 1)
            stamps.append(frame.timestamp_ns)
            assert 0 < frame.timestamp_ns < raw_ns() + 2_000_000
    finally:
        line.close()
    assert stamps == sorted(stamps)
