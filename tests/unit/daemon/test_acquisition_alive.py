"""The liveness check of the acquisition process depends on its replies, not on our delay.

A daemon that is behind has its answer lying behind all that was read before: taken for a
process that hangs, it was not fed to the watchdog any more and killed with what it had.
"""

import os
import pty
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from gyrorig_daemon.links.ports.acquisition_hub import AcquisitionHub, PortSettings
from gyrorig_daemon.links.ports.raw_clock import raw_ns

BEHIND_S = 1.5
SECOND_NS = 1_000_000_000
PATIENCE_NS = 60 * SECOND_NS


@contextmanager
def talking() -> Iterator[str]:
    """Yield a pty on which somebody says something a hundred times a second."""
    device, held = pty.openpty()
    os.set_blocking(device, False)
    ended = threading.Event()

    def talk() -> None:
        while not ended.wait(0.01):
            os.write(device, b"0123456789")

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield os.ttyname(held)
    finally:
        ended.set()
        thread.join()
        os.close(held)
        os.close(device)


def test_a_late_daemon_does_not_consider_the_acquisition_dead() -> None:
    with talking() as path, AcquisitionHub({"board": PortSettings(path, 115200)}) as hub:
        hub.ping()
        time.sleep(BEHIND_S)  # its answer lies in the pipe all the while
        assert hub.read(raw_ns() + PATIENCE_NS) is not None
        assert raw_ns() - hub.last_report_ns < BEHIND_S / 2 * SECOND_NS
        behind_ns = hub.buffered_chunks[0].received_ns if hub.buffered_chunks else 0
        assert behind_ns < hub.last_report_ns


def test_a_silent_process_is_not_considered_alive() -> None:
    device, held = pty.openpty()
    settings = {"board": PortSettings(os.ttyname(held), 115200)}
    with AcquisitionHub(settings) as hub:
        assert hub.read(raw_ns() + SECOND_NS // 5) is None
        hub._child.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        assert hub.read(raw_ns() + SECOND_NS // 5) is None  # what it had sent before
        before_ns = hub.last_report_ns
        assert hub.read(raw_ns() + 2 * SECOND_NS) is None
        assert hub.last_report_ns == before_ns
        hub._child.send_signal(signal.SIGCONT)
        hub.ping()
        end_ns = raw_ns() + PATIENCE_NS
        while hub.last_report_ns == before_ns:
            assert raw_ns() < end_ns
            assert hub.read(raw_ns() + SECOND_NS // 10) is None  # an answer is no chunk
    os.close(held)
    os.close(device)
