"""The last word to a port whose acquisition process is gone: said by the daemon itself."""

import contextlib
import os
import select
import time

from gyrorig_daemon.links.serial_port import RefusedError, open_port

PATIENCE_S = 1.0
QUIET_S = 0.2  # so long without a byte after an answer, and the answer is whole
_READ_BYTES = 4096


def say_farewell(path: str, baud: int, farewell: str) -> bool:
    """Open a port, send `farewell`, and wait for an answer.

    Closing at once could lose the order with the port; an answer shows that it came.

    Returns:
        Whether anything was answered.
    """
    with contextlib.suppress(RefusedError, OSError):
        fd = open_port(path, baud)
        try:
            os.write(fd, farewell.encode("ascii"))
            return _is_answered(fd)
        finally:
            os.close(fd)
    return False


def _is_answered(fd: int) -> bool:
    answered = False
    end_s = time.monotonic() + PATIENCE_S
    while (left_s := end_s - time.monotonic()) > 0.0:
        ready, _, _ = select.select([fd], [], [], min(left_s, QUIET_S) if answered else left_s)
        if not ready or not os.read(fd, _READ_BYTES):
            break
        answered = True
    return answered
