"""The kinds of ports that the acquisition process can serve, each behind the same few calls.

What to use when: `open_line` opens any port by its settings. A further kind is a module
with a function `open_line(settings) -> Line`, and its name in `KINDS`: it is imported
only where a rig has such a port, because the acquisition process stays small.
"""

import importlib
import os
import termios
from dataclasses import dataclass, field
from typing import Protocol, cast

from gyrorig_daemon.links.serial_port import open_port

SERIAL = "serial"
READ_BYTES = 65_536
# kind -> module with `open_line`; the serial port is at home here
KINDS: dict[str, str] = {"can": "gyrorig_daemon.links.can_line"}
STAMPED = frozenset({"can"})  # whose bytes hold when each frame came


@dataclass(frozen=True, slots=True)
class PortSettings:
    """How to open one port. `farewell` is sent to it if the daemon dies."""

    path: str
    baud: int
    farewell: str = ""
    kind: str = SERIAL
    options: dict[str, str | int | float | bool] = field(default_factory=dict)  # the kind's own


class Line(Protocol):
    """One open port, never blocking."""

    @property
    def fd(self) -> int:
        """What to poll."""
        ...

    def read(self) -> bytes:
        """Return what is there; nothing although the port is readable where it hung up.

        Raises:
            BlockingIOError: nothing is there.
            OSError: the port is gone.
        """
        ...

    def write(self, data: bytes) -> int:
        """Hand over what the port takes now; return how many bytes that were.

        Raises:
            BlockingIOError: none at present.
            OSError: the port is gone, or refuses these bytes.
        """
        ...

    def close(self) -> None:
        """Let go of the port, at once."""
        ...


class SerialLine:
    """A serial port or pseudo-terminal."""

    def __init__(self, fd: int) -> None:
        self._fd = fd

    @property
    def fd(self) -> int:
        """What to poll."""
        return self._fd

    def read(self) -> bytes:
        """See `Line.read`."""
        return os.read(self._fd, READ_BYTES)

    def write(self, data: bytes) -> int:
        """See `Line.write`."""
        return os.write(self._fd, data)

    def close(self) -> None:
        """Let go, and drop what was never taken: it would delay the closing by 30 s."""
        try:
            termios.tcflush(self._fd, termios.TCIOFLUSH)
        except termios.error:
            pass  # the device is gone, and what was in it too
        finally:
            os.close(self._fd)


def open_line(settings: PortSettings) -> Line:
    """Open a port of whatever kind.

    Raises:
        RefusedError: it is not there, of another sort, not permitted, or held by another.
    """
    if settings.kind == SERIAL:
        return SerialLine(open_port(settings.path, settings.baud))
    module = importlib.import_module(KINDS[settings.kind])
    return cast(Line, module.open_line(settings))
