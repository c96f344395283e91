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

import pytest

from gyrorig_daemon.links.ports import halt_on_disconnect
from gyrorig_daemon.links.ports.acquisition_hub import AcquisitionHub, PortSettings
from gyrorig_daemon.links.ports.port_hub import PortsGoneError
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


def test_the_halt_does_not_wait_for_a_process_that_cannot_be_killed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A process in uninterruptible sleep, below the driver of a board, is not ended by SIGKILL."""
    ports = "gyrorig_daemon.links.ports"
    monkeypatch.setattr(f"{ports}.acquisition_hub.REPORT_DEADLINE_NS", SECOND_NS // 5)
    monkeypatch.setattr(f"{ports}.halt_on_disconnect.ANSWER_TIMEOUT_S", 0.05)
    device, kept_open = pty.openpty()
    path = os.ttyname(kept_open)
    problems: list[str] = []
    hub = AcquisitionHub({"ptu": PortSettings(path, 9600, " H ")}, on_problem=problems.append)
    monkeypatch.setattr(hub._child, "kill", lambda: None)
    os.kill(hub._child.pid, signal.SIGSTOP)
    faults: list[Exception] = []

    def write_and_close() -> None:
        try:
            hub.write("ptu", b"V ")
        except PortsGoneError as fault:
            faults.append(fault)
        hub.close()

    thread = threading.Thread(target=write_and_close, daemon=True)
    thread.start()
    thread.join(20.0)
    has_returned = not thread.is_alive()
    os.kill(hub._child.pid, signal.SIGKILL)
    hub._child.wait()
    thread.join()
    os.close(kept_open)
    os.close(device)
    assert has_returned
    assert "driver of the system" in str(faults[0])
    assert "Check that the pan-tilt unit has stopped" in str(faults[0])
    assert "still has the ports" in problems[0]


def test_a_port_whose_driver_hangs_does_not_delay_the_daemon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The opening of its port does not return."""
    released = threading.Event()

    def open_slowly(path: str, baud: int) -> int:
        released.wait(20.0)
        raise OSError

    monkeypatch.setattr(halt_on_disconnect, "open_port", open_slowly)
    monkeypatch.setattr(halt_on_disconnect, "OPEN_TIMEOUT_S", 0.05, raising=False)
    monkeypatch.setattr(halt_on_disconnect, "ANSWER_TIMEOUT_S", 0.05)
    begin_ns = raw_ns()
    assert not halt_on_disconnect.send_final_command("/dev/ttyUSB0", 9600, " H ")
    assert raw_ns() - begin_ns < 10 * SECOND_NS
    released.set()
