"""CAN buses for the acquisition process: frames as packed records with kernel timestamps.

    socketcan:can0                      a CAN interface of this computer
    udp_multicast:239.74.163.2:43113    python-can's interface of that name, without hardware
    udp_multicast:239.74.163.2:43113@127.0.0.1    the same on one network interface only
    python-can:slcan:/dev/ttyACM0       any other interface of python-can, see `python_can_line`

This is an own reader, because python-can sets no receive buffer and reads no drop counter: with
it, a daemon that pauses for 0.2 s loses frames without notice (measured). `can_socket` reads.
"""

import errno
import os
import socket
import struct

from gyrorig_daemon.links.can.can_socket import CanSocketLine
from gyrorig_daemon.links.can.multicast_line import MulticastLine
from gyrorig_daemon.links.ports.port_kinds import Line, PortSettings
from gyrorig_daemon.links.ports.serial_port import PortRefusedError
from gyrorig_protocol.can.can_frame import EXTENDED_MASK, RECORD, STANDARD_MASK, FrameFlag

_CAN_RAW_ERR_FILTER = 2  # <linux/can/raw.h>
_CAN_RAW_LOOPBACK = 3
_CAN_RAW_RECV_OWN_MSGS = 4
_SOL_CAN_RAW = 101
_CAN_FRAME = struct.Struct("=IB3x8s")  # struct can_frame
_EFF_FLAG, _RTR_FLAG, _ERR_FLAG = 1 << 31, 1 << 30, 1 << 29
# Combining enum flags takes 1 us each.
_EXTENDED, _REMOTE, _ERROR = int(FrameFlag.EXTENDED), int(FrameFlag.REMOTE), int(FrameFlag.ERROR)
_FOREIGN = int(FrameFlag.FOREIGN)


def open_line(settings: PortSettings) -> Line:
    """Open the bus at the path of a port.

    Raises:
        PortRefusedError: there is no such interface, no permission, or the path is not valid.
    """
    kind, _, address = settings.path.partition(":")
    try:
        if kind == "socketcan":
            return SocketCanLine(address)
        group, _, port_and_interface = address.rpartition(":")
        port, _, interface = port_and_interface.partition("@")
        if kind == "udp_multicast" and port.isdecimal() and 0 < int(port) < 1 << 16:
            return MulticastLine(group, int(port), interface)
        if kind == "python-can" and ":" in address:
            # Imported only if needed: it takes 0.2 s and a few MB.
            from gyrorig_daemon.links.can.python_can_line import PythonCanLine  # noqa: PLC0415

            adapter, _, channel = address.partition(":")
            return PythonCanLine(adapter, channel, settings.baud)
    except OSError as fault:
        raise PortRefusedError(_reason(fault), os.strerror(fault.errno or 0)) from fault
    raise PortRefusedError("foreign", "it is not a CAN bus")


def _reason(fault: OSError) -> str:
    if fault.errno in (errno.ENODEV, errno.ENETDOWN, errno.ENXIO):
        return "missing"
    if fault.errno in (errno.EPERM, errno.EACCES):
        return "denied"
    return "foreign"


class SocketCanLine(CanSocketLine):
    """A CAN interface of the kernel, with error frames and the echo of own frames."""

    def __init__(self, interface: str) -> None:
        bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            super().__init__(bus)
            bus.setsockopt(_SOL_CAN_RAW, _CAN_RAW_LOOPBACK, 1)
            bus.setsockopt(_SOL_CAN_RAW, _CAN_RAW_RECV_OWN_MSGS, 1)
            bus.setsockopt(_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, EXTENDED_MASK)
            bus.bind((interface,))
        except OSError:
            bus.close()
            raise

    def to_record(self, data: bytes, stamp_ns: int) -> bytes:
        """See `CanSocketLine.to_record`."""
        return socketcan_record(data, stamp_ns)

    def send(self, identifier: int, flags: int, data: bytes) -> None:
        """See `CanSocketLine.send`."""
        word = identifier | (_EFF_FLAG if flags & FrameFlag.EXTENDED else 0)
        self._receiver.send(_CAN_FRAME.pack(word, len(data), data))


def socketcan_record(data: bytes, stamp_ns: int) -> bytes:
    """Return the record of a `struct can_frame` from the kernel."""
    if len(data) != _CAN_FRAME.size:
        return RECORD.pack(0, _FOREIGN, 0, b"", stamp_ns)
    word, length, content = _CAN_FRAME.unpack(data)
    if word & _ERR_FLAG:
        return RECORD.pack(word & EXTENDED_MASK, _ERROR, 8, content, stamp_ns)
    flags = 0
    if word & _EFF_FLAG:
        flags, identifier = _EXTENDED, word & EXTENDED_MASK
    else:
        identifier = word & STANDARD_MASK
    if word & _RTR_FLAG:
        flags |= _REMOTE
    return RECORD.pack(identifier, flags, min(length, 8), content, stamp_ns)
