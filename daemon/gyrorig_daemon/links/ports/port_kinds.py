"""Kinds of ports that the acquisition process serves, behind one interface.

What to use when: `open_line` opens any port by its settings. A new kind is a module with a
function `open_line(settings) -> Line` and an entry in `KINDS`. The module is imported only
for a rig that has such a port, because the acquisition process must stay small.
"""

import importlib
import os
import termios
from dataclasses import dataclass, field
from typing import Protocol, cast

from gyrorig_daemon.links.ports.serial_port import open_port

SERIAL = "serial"
READ_BYTES = 65_536
# kind -> module with `open_line`; the serial port is in this module
KINDS: dict[str, str] = {"can": "gyrorig_daemon.links.can.socketcan_line"}
# What a port may send per second. A board of 800 Hz sends 40 kB/s; a CAN bus of 1 Mbit/s sends at
# most 20 000 frames, of 24 bytes each as this process reports them.
SERIAL_QUOTA_BYTES_PER_S = 256_000
CAN_QUOTA_BYTES_PER_S = 1_000_000
SELF_TIMESTAMPED_KINDS = frozenset({"can"})  # their bytes contain the time of each frame


@dataclass(frozen=True, slots=True)
class PortSettings:
    """How to open one port.

    `final_command` is sent to it if the daemon dies: one character per byte, because it passes
    through JSON.
    """

    path: str
    baud: int
    final_command: str = ""
    kind: str = SERIAL
    options: dict[str, str | int | float | bool] = field(
        default_factory=dict
    )  # specific to the kind
    quota_bytes_per_s: int = SERIAL_QUOTA_BYTES_PER_S  # what exceeds it is discarded


class Line(Protocol):
    """One open port in non-blocking mode."""

    @property
    def fd(self) -> int:
        """File descriptor to poll."""
        ...

    def read(self) -> bytes:
        """Return the received bytes; none, although the port is readable, if it was unplugged.

        Raises:
            BlockingIOError: nothing was received.
            OSError: the port is gone.
        """
        ...

    def write(self, data: bytes) -> int:
        """Write what the port takes now and return the number of bytes.

        Raises:
            BlockingIOError: the port takes nothing at present.
            OSError: the port is gone, or rejects these bytes.
        """
        ...

    def close(self) -> None:
        """Release the port at once."""
        ...


class SerialLine:
    """A serial port or a pseudo-terminal."""

    def __init__(self, fd: int) -> None:
        self._fd = fd

    @property
    def fd(self) -> int:
        """File descriptor to poll."""
        return self._fd

    def read(self) -> bytes:
        """See `Line.read`."""
        return os.read(self._fd, READ_BYTES)

    def write(self, data: bytes) -> int:
        """See `Line.write`."""
        return os.write(self._fd, data)

    def close(self) -> None:
        """Release the port and discard unsent bytes, which would delay the close by 30 s."""
        try:
            termios.tcflush(self._fd, termios.TCIOFLUSH)
        except termios.error:
            pass  # the device is gone
        finally:
            os.close(self._fd)


def open_line(settings: PortSettings) -> Line:
    """Open a port of any kind.

    Raises:
        PortRefusedError: it does not exist, is of another kind, is not permitted, or is in use.
    """
    if settings.kind == SERIAL:
        return SerialLine(open_port(settings.path, settings.baud))
    module = importlib.import_module(KINDS[settings.kind])
    return cast(Line, module.open_line(settings))
