"""CAN interfaces without a kernel driver, through python-can.

    python-can:slcan:/dev/ttyACM0    python-can:gs_usb:0    python-can:virtual:bench

What to use when: only if `socketcan_line` cannot be used. The library has no drop counter and
no timestamps on a host clock. Frames are timestamped when the library returns them, and losses
show only in the boards' sequence numbers. A thread waits in the library, because not every
interface can be polled, and writes records to a pipe.
"""

import contextlib
import errno
import os
import threading

import can

from gyrorig_daemon.links.ports.port_kinds import READ_BYTES
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.links.ports.serial_port import PortRefusedError
from gyrorig_protocol.can.can_frame import RECORD, FrameFlag

RECEIVE_TIMEOUT_S = 0.5  # how long closing may wait for the thread
_EXTENDED, _REMOTE, _ERROR = int(FrameFlag.EXTENDED), int(FrameFlag.REMOTE), int(FrameFlag.ERROR)
_FOREIGN = RECORD.pack(0, int(FrameFlag.FOREIGN), 0, b"", 0)


class PythonCanLine:
    """A bus of python-can. See `port_kinds.Line`."""

    def __init__(self, interface: str, channel: str, bitrate: int) -> None:
        """Open the bus and start to read.

        Raises:
            PortRefusedError: python-can does not have the interface, or cannot open it.
        """
        self._bus = _open_bus(interface, channel, bitrate)
        self._reader, self._writer = os.pipe2(os.O_CLOEXEC)
        os.set_blocking(self._reader, False)
        self._stop_requested = threading.Event()
        self._thread = threading.Thread(target=self._forward_frames, daemon=True)
        self._thread.start()

    @property
    def fd(self) -> int:
        """File descriptor to poll."""
        return self._reader

    def read(self) -> bytes:
        """Return received frames as records; none if the library has stopped."""
        return os.read(self._reader, READ_BYTES - READ_BYTES % RECORD.size)

    def write(self, data: bytes) -> int:
        """Send the first of the packed records. See `Line.write`."""
        if len(data) < RECORD.size:
            return len(data)
        identifier, flags, length, content, _ = RECORD.unpack_from(data)
        message = can.Message(
            arbitration_id=identifier,
            is_extended_id=bool(flags & _EXTENDED),
            is_remote_frame=bool(flags & _REMOTE),
            data=content[:length],
        )
        try:
            self._bus.send(message, timeout=0.0)
        except can.CanError as fault:
            raise OSError(errno.ENOBUFS, str(fault)) from fault
        return RECORD.size

    def close(self) -> None:
        """Release the bus."""
        self._stop_requested.set()
        os.close(self._reader)
        self._thread.join(2.0 * RECEIVE_TIMEOUT_S)
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()

    def _forward_frames(self) -> None:
        """Forward frames until the line is closed or the library stops."""
        try:
            while not self._stop_requested.is_set():
                message = self._bus.recv(RECEIVE_TIMEOUT_S)
                if message is not None:
                    os.write(self._writer, _record(message, raw_ns()))
        except (can.CanError, OSError):
            pass  # the closed pipe reports it
        finally:
            os.close(self._writer)


def _open_bus(interface: str, channel: str, bitrate: int) -> can.BusABC:
    """Open a bus, with the echo of own frames if the interface has it.

    Raises:
        PortRefusedError: it cannot be opened.
    """
    reason = ""
    for receive_own in (True, False):
        try:
            return can.ThreadSafeBus(
                channel=channel,
                interface=interface,
                bitrate=bitrate,
                receive_own_messages=receive_own,
            )
        except can.CanInterfaceNotImplementedError as fault:
            reason = str(fault)
        except (can.CanError, OSError, ValueError, TypeError) as fault:
            raise PortRefusedError("missing", _one_line(fault)) from fault
    raise PortRefusedError("foreign", _one_line(reason))


def _one_line(fault: object) -> str:
    return " ".join(str(fault).split())[:200] or "python-can cannot open it"


def _record(message: can.Message, stamp_ns: int) -> bytes:
    if message.is_fd or len(message.data) > 8:
        return _FOREIGN
    flags = (
        message.is_extended_id * _EXTENDED
        | message.is_remote_frame * _REMOTE
        | message.is_error_frame * _ERROR
    )
    data = bytes(message.data)
    return RECORD.pack(message.arbitration_id, flags, len(data), data, stamp_ns)
