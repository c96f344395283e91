"""A port that is opened to listen and to ask, with an end to every wait.

What to use when: `opened` around whatever is asked of a device; the port is closed, and
what was not read is thrown away, however that ends.
"""

import contextlib
import os
import select
import termios
import time
from collections.abc import Iterator

from gyrorig_daemon.links.serial_port import open_port

_READ_BYTES = 65536


@contextlib.contextmanager
def opened(path: str, baud: int) -> Iterator[int]:
    """Yield the descriptor of a port, ours alone until the end of the block.

    Raises:
        RefusedError: it cannot be had.
    """
    fd = open_port(path, baud)
    try:
        yield fd
    finally:
        with contextlib.suppress(termios.error):
            termios.tcflush(fd, termios.TCIOFLUSH)
        os.close(fd)


def receive(fd: int, end_s: float) -> bytes | None:
    """Return what comes before `end_s` of the monotonic clock; b"" then; None on hang-up."""
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
    """Write what the port takes now; False where it takes nothing or hung up."""
    try:
        return os.write(fd, data) == len(data)
    except OSError:
        return False
