"""The unit is halted in a bounded time, whatever blocks, hangs, floods or dies: docs/halting.md."""

import os
import pty
import select
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from tests.support.served_rig import FAR, Devices, Service, wait_for

from gyrorig_daemon.emulator.pty_server import raw_now_ns
from gyrorig_daemon.service.service_client import send_command

XOFF = b"\x13"
ORDERED_S = 0.5  # bound of a halt that a person or systemd orders


@contextmanager
def terminal() -> Iterator[tuple[int, int]]:
    """Yield both ends of a terminal whose output somebody reads."""
    screen, line = pty.openpty()
    ended = threading.Event()

    def read() -> None:
        while not ended.is_set():
            if select.select([screen], [], [], 0.05)[0]:
                os.read(screen, 4096)

    thread = threading.Thread(target=read)
    thread.start()
    try:
        yield screen, line
    finally:
        ended.set()
        thread.join()
        os.close(screen)
        os.close(line)


def set_in_motion(service: Service, devices: Devices) -> None:
    service.enqueue(FAR)
    wait_for(devices.turning)


@pytest.mark.parametrize("order", ["stop-motion", "SIGTERM"])
def test_a_terminal_that_takes_nothing_delays_no_halt(
    service: Service, devices: Devices, order: str
) -> None:
    with terminal() as (screen, line):
        process = service.start_ready(line)
        set_in_motion(service, devices)
        os.write(screen, XOFF)  # Ctrl-S
        begun_ns = raw_now_ns()
        if order == "SIGTERM":
            process.send_signal(signal.SIGTERM)
        else:
            send_command(service.socket, "halt")
        assert devices.halt_after_s(begun_ns, 10.0) < ORDERED_S
        if order == "SIGTERM":
            assert process.wait(30) == 0
