"""Send the final command to a port whose acquisition process is gone."""

import contextlib
import os
import select
import termios
import threading
import time

from gyrorig_daemon.links.ports.serial_port import PortRefusedError, open_port

ANSWER_TIMEOUT_S = 1.0
QUIET_S = 0.2  # after this time without a byte the reply is complete
OPEN_TIMEOUT_S = 2.0  # a driver that hangs does not return from the opening of its port
_READ_BYTES = 4096


def send_final_command(path: str, baud: int, final_command: str) -> bool:
    """Open a port, send the command, and wait for a reply.

    Closing at once could discard the command; a reply shows that it arrived. A thread does this,
    because the driver of the port can hang; the call takes no longer than both timeouts.

    Returns:
        Whether there was a reply.
    """
    answers: list[bool] = []
    thread = threading.Thread(
        target=lambda: answers.append(_send(path, baud, final_command)), name="halt", daemon=True
    )
    thread.start()
    thread.join(OPEN_TIMEOUT_S + ANSWER_TIMEOUT_S)
    return answers == [True]


def _send(path: str, baud: int, final_command: str) -> bool:
    with contextlib.suppress(PortRefusedError, OSError):
        fd = open_port(path, baud)
        try:
            os.write(fd, final_command.encode("latin-1"))
            return _wait_for_answer(fd)
        finally:
            # bytes that the adapter did not take until now would delay the close by 30 s
            with contextlib.suppress(termios.error):
                termios.tcflush(fd, termios.TCOFLUSH)
            os.close(fd)
    return False


def _wait_for_answer(fd: int) -> bool:
    answered = False
    end_s = time.monotonic() + ANSWER_TIMEOUT_S
    while (left_s := end_s - time.monotonic()) > 0.0:
        ready, _, _ = select.select([fd], [], [], min(left_s, QUIET_S) if answered else left_s)
        if not ready or not os.read(fd, _READ_BYTES):
            break
        answered = True
    return answered
