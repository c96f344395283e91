"""Any interface that python-can knows, for adapters without a kernel driver.

    python-can:slcan:/dev/ttyACM0    python-can:gs_usb:0    python-can:virtual:bench

What to use when: only where `can_line` cannot: the library gives no drop counter and no stamp on
a clock of the host's, so frames are stamped when it hands them over, and what it loses shows in
the boards' numbers alone. A thread waits in the library, because not every interface can be
polled, and hands records to a pipe.
"""

import contextlib
import errno
import os
import threading

import can

from gyrorig_daemon.links.port_kinds import READ_BYTES
from gyrorig_daemon.links.raw_clock import raw_ns
from gyrorig_daemon.links.serial_port import RefusedError
from gyrorig_protocol.can.frame import RECORD, FrameFlag

PATIENCE_S = 0.5  # how long an end of the line may wait for the thread
_EXTENDED, _REMOTE, _ERROR = int(FrameFlag.EXTENDED), int(FrameFlag.REMOTE), int(FrameFlag.ERROR)
_FOREIGN = RECORD.pack(0, int(FrameFlag.FOREIGN), 0, b"", 0)


class LibraryLine:
    """A bus behind python-can; see `port_kinds.Line`."""

    def __init__(self, interface: str, channel: str, bitrate: int) -> None:
        """Open the bus and begin to read.

        Raises:
            RefusedError: python-can does not know the interface, or cannot open it.
        """
        self._bus = _open_bus(interface, channel, bitrate)
        self._reader, self._writer = os.pipe2(os.O_CLOEXEC)
        os.set_blocking(self._reader, False)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._pass_on, daemon=True)
        self._thread.start()

    @property
    def fd(self) -> int:
        """What to poll."""
        return self._reader

    def read(self) -> bytes:
        """Return what has come as records; nothing where the library gave up."""
        return os.read(self._reader, READ_BYTES - READ_BYTES % RECORD.size)

    def write(self, data: bytes) -> int:
        """Send the first of the packed records; see `Line.write`."""
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
        """Let go of the bus."""
        self._over.set()
        os.close(self._reader)
        self._thread.join(2.0 * PATIENCE_S)
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()

    def _pass_on(self) -> None:
        """Hand over frames until it is over, or the library gives up."""
        try:
            while not self._over.is_set():
                message = self._bus.recv(PATIENCE_S)
                if message is not None:
                    os.write(self._writer, _record(message, raw_ns()))
        except (can.CanError, OSError):
            pass  # the closed pipe says it
        finally:
            os.close(self._writer)


def _open_bus(interface: str, channel: str, bitrate: int) -> can.BusABC:
    """Open a bus, with the echo of our own frames where the interface has one.

    Raises:
        RefusedError: it cannot be opened.
    """
    reason = ""
    for own in (True, False):
        try:
            return can.ThreadSafeBus(
                channel=channel, interface=interface, bitrate=bitrate, receive_own_messages=own
            )
        except can.CanInterfaceNotImplementedError as fault:
            reason = str(fault)
        except (can.CanError, OSError, ValueError, TypeError) as fault:
            raise RefusedError("missing", _one_line(fault)) from fault
    raise RefusedError("foreign", _one_line(reason))


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
