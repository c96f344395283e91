"""A multicast group in place of a CAN bus, in the format of python-can's udp_multicast.

What to use when: without CAN hardware, for tests, the emulated rig, and programs that use
python-can.
"""

import socket
import struct

import msgspec

from gyrorig_daemon.links.can.can_socket import CanSocketLine
from gyrorig_protocol.can.can_frame import RECORD, FrameFlag

# Combining enum flags takes 1 us each.
_EXTENDED, _REMOTE, _ERROR = int(FrameFlag.EXTENDED), int(FrameFlag.REMOTE), int(FrameFlag.ERROR)
_FOREIGN = int(FrameFlag.FOREIGN)


class PythonCanMessage(msgspec.Struct):
    """Message as python-can's udp_multicast interface packs it (can 4.6.1, `pack_message`)."""

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


_DECODE = msgspec.msgpack.Decoder(PythonCanMessage).decode
_ENCODE = msgspec.msgpack.Encoder().encode


def multicast_record(data: bytes, stamp_ns: int) -> bytes:
    """Return the record of one datagram; a FOREIGN record if it is not a classical CAN frame."""
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
        pass  # anybody can send to the group
    return RECORD.pack(0, _FOREIGN, 0, b"", stamp_ns)


def multicast_datagram(identifier: int, flags: int, data: bytes) -> bytes:
    """Return a frame as python-can packs it for its udp_multicast interface."""
    return _ENCODE(
        PythonCanMessage(
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


class MulticastLine(CanSocketLine):
    """A multicast group in place of a bus; every member receives every frame."""

    def __init__(self, group: str, port: int, interface: str = "") -> None:
        self._destination = (group, port)
        bus = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            super().__init__(bus)
            for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT):
                bus.setsockopt(socket.SOL_SOCKET, option, 1)
            bus.bind((group, port))  # to the group address, so that nothing else is received
            interface_address = socket.inet_aton(interface or "0.0.0.0")  # noqa: S104 - the system's choice
            bus.setsockopt(
                socket.IPPROTO_IP,
                socket.IP_ADD_MEMBERSHIP,
                socket.inet_aton(group) + interface_address,
            )
            if interface:
                bus.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface_address)
            bus.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
        except OSError:
            bus.close()
            raise

    def to_record(self, data: bytes, stamp_ns: int) -> bytes:
        """See `CanSocketLine.to_record`."""
        return multicast_record(data, stamp_ns)

    def send(self, identifier: int, flags: int, data: bytes) -> None:
        """See `CanSocketLine.send`."""
        self._receiver.sendto(multicast_datagram(identifier, flags, data), self._destination)
