"""CAN buses for the acquisition process: frames as packed records, with the kernel's stamps.

    socketcan:can0                      a CAN interface of this machine
    udp_multicast:239.74.163.2:43113    python-can's interface of that name, where there is no CAN
    udp_multicast:239.74.163.2:43113@127.0.0.1    the same on one interface only
    python-can:slcan:/dev/ttyACM0       whatever else python-can knows, see `can_library`

Our own reader, not python-can's: that sets no receive buffer and reads no drop counter,
so that a daemon that pauses for 0.2 s loses frames unseen (measured; reference: boards.md
section 3). Here the buffer is as large as the system allows, the kernel's count of dropped
frames becomes a record of its own, and every frame is stamped by the kernel: what delays
this process does not delay the stamps. Kernel stamps are of the wall clock; each read call
pairs it with the raw monotonic clock. Where a stamp cannot be so, the moment of reading stands in;
stamps never go back.
"""

import errno
import os
import socket
import struct
import time
from abc import ABC, abstractmethod

import msgspec

from gyrorig_daemon.links.port_kinds import Line, PortSettings
from gyrorig_daemon.links.serial_port import RefusedError
from gyrorig_protocol.can.frame import RECORD, FrameFlag

BUFFER_BYTES = 4 << 20  # 0.5 s of a stalled reader, measured
FRAMES_PER_READ = 512
NEWEST_NS = 2_000_000  # a stamp cannot be from the future, but both clocks are read in turn
OLDEST_NS = 10_000_000_000
CLOCK_PAIRS = 3
TIGHT_NS = 3_000

_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35  # <asm-generic/socket.h>
_SO_RXQ_OVFL = 40
_CAN_RAW_ERR_FILTER = 2  # <linux/can/raw.h>
_CAN_RAW_LOOPBACK = 3
_CAN_RAW_RECV_OWN_MSGS = 4
_SOL_CAN_RAW = 101
_CAN_ERR_MASK = 0x1FFF_FFFF
# Flags of an enum cost a microsecond each.
_EXTENDED, _REMOTE, _ERROR = int(FrameFlag.EXTENDED), int(FrameFlag.REMOTE), int(FrameFlag.ERROR)
_FOREIGN = int(FrameFlag.FOREIGN)
_TIMESPEC = struct.Struct("=qq")
_COUNT = struct.Struct("=I")
_CAN_FRAME = struct.Struct("=IB3x8s")  # struct can_frame
_EFF_FLAG, _RTR_FLAG, _ERR_FLAG = 1 << 31, 1 << 30, 1 << 29
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_COUNT.size)


def open_line(settings: PortSettings) -> Line:
    """Open the bus that a port's path names.

    Raises:
        RefusedError: there is no such interface, it is not permitted, or the path names none.
    """
    kind, _, rest = settings.path.partition(":")
    try:
        if kind == "socketcan":
            return SocketCanLine(rest)
        group, _, port_and_interface = rest.rpartition(":")
        port, _, interface = port_and_interface.partition("@")
        if kind == "udp_multicast" and port.isdecimal() and 0 < int(port) < 1 << 16:
            return MulticastLine(group, int(port), interface)
        if kind == "python-can" and ":" in rest:
            # Imported only where it is wanted: it takes 0.2 s and a few MB.
            from gyrorig_daemon.links.can_library import LibraryLine  # noqa: PLC0415

            adapter, _, channel = rest.partition(":")
            return LibraryLine(adapter, channel, settings.baud)
    except OSError as fault:
        raise RefusedError(_reason(fault), os.strerror(fault.errno or 0)) from fault
    raise RefusedError("foreign", "it is no CAN bus")


def _reason(fault: OSError) -> str:
    if fault.errno in (errno.ENODEV, errno.ENETDOWN, errno.ENXIO):
        return "missing"
    if fault.errno in (errno.EPERM, errno.EACCES):
        return "denied"
    return "foreign"


def _read_clocks() -> tuple[int, int]:
    """Return the raw clock, and what to add to the wall clock to have it.

    The tightest of a few pairs: an interruption between two readings would make every stamp
    of a read call early by as much, and no arrival can be early.
    """
    best: tuple[int, int, int] | None = None
    for _ in range(CLOCK_PAIRS):
        before_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        wall_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        after_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        width_ns = after_ns - before_ns
        if best is None or width_ns < best[0]:
            best = width_ns, after_ns, before_ns + width_ns // 2 - wall_ns
        if width_ns < TIGHT_NS:
            break
    if best is None:  # CLOCK_PAIRS is not zero
        raise AssertionError
    return best[1], best[2]


class CanLine(ABC):
    """What both kinds share: stamps, drops, records."""

    def __init__(self, receiver: socket.socket) -> None:
        self._receiver = receiver
        self._dropped = 0  # the kernel's count when it was last seen
        self._last_ns = 0
        self.deaf_to: tuple[str, int] | None = None  # a sender whose frames are passed over
        receiver.setblocking(False)
        try:
            receiver.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, BUFFER_BYTES)
        except OSError:  # only root may have more than net.core.rmem_max
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        receiver.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        receiver.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)

    @property
    def fd(self) -> int:
        """What to poll."""
        return self._receiver.fileno()

    def read(self) -> bytes:
        """Return what has come as records; see `Line.read`."""
        records: list[bytes] = []
        raw_ns, wall_to_raw_ns = _read_clocks()
        while len(records) < FRAMES_PER_READ:
            try:
                data, ancillary, _, sender = self._receiver.recvmsg(4096, _ANCILLARY_BYTES)
            except BlockingIOError:
                if not records:
                    raise
                break
            except OSError:
                if not records:
                    raise
                break  # the next read says it again
            if self.deaf_to is not None and sender == self.deaf_to:
                continue
            stamp_ns = 0
            for _, kind, value in ancillary:
                if kind == _SO_TIMESTAMPNS:
                    seconds, nanoseconds = _TIMESPEC.unpack(value)
                    stamp_ns = seconds * 1_000_000_000 + nanoseconds + wall_to_raw_ns
                elif kind == _SO_RXQ_OVFL:
                    self._count_drops(_COUNT.unpack(value)[0], records)
            if stamp_ns > raw_ns:
                raw_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
            if not raw_ns - OLDEST_NS < stamp_ns < raw_ns + NEWEST_NS:
                stamp_ns = raw_ns  # the wall clock was set meanwhile
            # Frames come in order; the pairs of clocks scatter.
            self._last_ns = stamp_ns = max(stamp_ns, self._last_ns)
            records.append(self.to_record(data, stamp_ns))
        return b"".join(records)

    def write(self, data: bytes) -> int:
        """Send the first of the packed records; see `Line.write`."""
        if len(data) < RECORD.size:
            return len(data)
        identifier, flags, length, content, _ = RECORD.unpack_from(data)
        self.send(identifier, flags, content[:length])
        return RECORD.size

    @abstractmethod
    def to_record(self, data: bytes, stamp_ns: int) -> bytes:
        """Return the record of what one receive call returned."""

    @abstractmethod
    def send(self, identifier: int, flags: int, data: bytes) -> None:
        """Send one frame.

        Raises:
            OSError: the bus, or its queue, does not take it.
        """

    def close(self) -> None:
        """Let go of the bus."""
        self._receiver.close()

    def _count_drops(self, count: int, records: list[bytes]) -> None:
        before, self._dropped = self._dropped, count
        lost = (count - before) & 0xFFFF_FFFF
        if lost:
            records.append(RECORD.pack(lost, int(FrameFlag.LOST), 0, b"", 0))


class SocketCanLine(CanLine):
    """An interface of the kernel. Error frames are asked for, and our own frames' echo."""

    def __init__(self, interface: str) -> None:
        bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            super().__init__(bus)
            bus.setsockopt(_SOL_CAN_RAW, _CAN_RAW_LOOPBACK, 1)
            bus.setsockopt(_SOL_CAN_RAW, _CAN_RAW_RECV_OWN_MSGS, 1)
            bus.setsockopt(_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _CAN_ERR_MASK)
            bus.bind((interface,))
        except OSError:
            bus.close()
            raise

    def to_record(self, data: bytes, stamp_ns: int) -> bytes:
        """See `CanLine.to_record`."""
        return socketcan_record(data, stamp_ns)

    def send(self, identifier: int, flags: int, data: bytes) -> None:
        """See `CanLine.send`."""
        word = identifier | (_EFF_FLAG if flags & FrameFlag.EXTENDED else 0)
        self._receiver.send(_CAN_FRAME.pack(word, len(data), data))


def socketcan_record(data: bytes, stamp_ns: int) -> bytes:
    """Return the record of a `struct can_frame` as the kernel gave it."""
    if len(data) != _CAN_FRAME.size:
        return RECORD.pack(0, _FOREIGN, 0, b"", stamp_ns)
    word, length, content = _CAN_FRAME.unpack(data)
    if word & _ERR_FLAG:
        return RECORD.pack(word & _CAN_ERR_MASK, _ERROR, 8, content, stamp_ns)
    flags = 0
    if word & _EFF_FLAG:
        flags, identifier = _EXTENDED, word & 0x1FFF_FFFF
    else:
        identifier = word & 0x7FF
    if word & _RTR_FLAG:
        flags |= _REMOTE
    return RECORD.pack(identifier, flags, min(length, 8), content, stamp_ns)


class WireMessage(msgspec.Struct):
    """python-can's message as its udp_multicast interface packs it (can 4.6.1, `pack_message`)."""

    timestamp: float
    arbitration_id: int
    is_extended_id: bool
    is_remote_frame: bool
    is_error_frame: bool
    channel: str | int | None
    dlc: int
    data: bytes
    is_fd: bool
    bitrate_switch: bool
    error_state_indicator: bool


_DECODE = msgspec.msgpack.Decoder(WireMessage).decode
_ENCODE = msgspec.msgpack.Encoder().encode


def multicast_record(data: bytes, stamp_ns: int) -> bytes:
    """Return the record of one datagram; what is no classical frame is a FOREIGN one."""
    try:
        message = _DECODE(data)
        flags = (
            message.is_extended_id * _EXTENDED
            | message.is_remote_frame * _REMOTE
            | message.is_error_frame * _ERROR
        )
        if len(message.data) <= 8 and not message.is_fd:
            return RECORD.pack(
                message.arbitration_id, flags, len(message.data), message.data, stamp_ns
            )
    except (msgspec.MsgspecError, ValueError, struct.error):
        pass  # anybody may send there
    return RECORD.pack(0, _FOREIGN, 0, b"", stamp_ns)


def multicast_datagram(identifier: int, flags: int, data: bytes) -> bytes:
    """Return a frame as python-can packs it for its udp_multicast interface."""
    return _ENCODE(
        WireMessage(
            timestamp=0.0,
            arbitration_id=identifier,
            is_extended_id=bool(flags & FrameFlag.EXTENDED),
            is_remote_frame=bool(flags & FrameFlag.REMOTE),
            is_error_frame=bool(flags & FrameFlag.ERROR),
            channel=None,
            dlc=len(data),
            data=data,
            is_fd=False,
            bitrate_switch=False,
            error_state_indicator=False,
        )
    )


class MulticastLine(CanLine):
    """A multicast group that stands for a bus; whoever joins it hears every frame."""

    def __init__(self, group: str, port: int, interface: str = "") -> None:
        self._destination = (group, port)
        bus = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            super().__init__(bus)
            for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT):
                bus.setsockopt(socket.SOL_SOCKET, option, 1)
            bus.bind((group, port))  # to the group itself: nothing else comes then
            through = socket.inet_aton(interface or "0.0.0.0")  # noqa: S104 - the system's choice
            bus.setsockopt(
                socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + through
            )
            if interface:
                bus.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, through)
            bus.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
        except OSError:
            bus.close()
            raise

    def to_record(self, data: bytes, stamp_ns: int) -> bytes:
        """See `CanLine.to_record`."""
        return multicast_record(data, stamp_ns)

    def send(self, identifier: int, flags: int, data: bytes) -> None:
        """See `CanLine.send`."""
        self._receiver.sendto(multicast_datagram(identifier, flags, data), self._destination)
