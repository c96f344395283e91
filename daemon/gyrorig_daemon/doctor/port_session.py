"""An open serial port for queries, with a time limit for every wait.

What to use when: `open_for_check` around all queries to a device. At the end the port is closed
and unread data is discarded.
"""

import contextlib
import os
import select
import termios
import time
from collections.abc import Iterator

from gyrorig_daemon.links.ports.serial_port import open_port

_READ_BYTES = 65536


@contextlib.contextmanager
def open_for_check(path: str, baud: int) -> Iterator[int]:
    """Yield the descriptor of a port, opened exclusively.

    Raises:
        PortRefusedError: the port cannot be opened.
    """
    fd = open_port(path, baud)
    try:
        yield fd
    finally:
        with contextlib.suppress(termios.error):
            termios.tcflush(fd, termios.TCIOFLUSH)
        os.close(fd)


def receive(fd: int, end_s: float) -> bytes | None:
    """Return the next data before a monotonic time, b"" if none, None if the port hung up."""
    ready, _, _ = select.select([fd], [], [], max(0.0, end_s - time.monotonic()))
    if not ready:
        return b""
    try:
        return os.read(fd, _READ_BYTES) or None
    except BlockingIOError:
        return b""
    except OSError:
        return None


def send(fd: int, data: bytes) -> bool:
    """Write what the port accepts now; return whether it accepted everything."""
    try:
        return os.write(fd, data) == len(data)
    except OSError:
        return False
