"""The unit is halted in a bounded time, whatever blocks, hangs, floods or dies: docs/halting.md."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from tests.support.halt_trials import (
    XOFF,
    XON,
    flooding_board,
    hanging_disk,
    make_unit_say,
    prepare_hang,
    set_in_motion,
    terminal,
)
from tests.support.served_rig import FAR, GYRORIGD, Devices, Service, wait_for

from gyrorig_daemon.emulator.pty_server import raw_now_ns
from gyrorig_daemon.service.service_client import send_command

ORDERED_S = 0.5  # bound of a halt that a person or systemd orders
UNIT_S = 10.0  # bound of the halt of a unit whose replies are missing or wrong
SILENCE_S = 3.0  # of the daemon, after which the acquisition process halts the unit


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


def test_a_stopped_daemon_loses_its_unit(service: Service, devices: Devices) -> None:
    service.config.write_text(
        service.sane.replace("board_patience", "aftermath_s: 5, board_patience")
    )
    process = service.start_ready()
    set_in_motion(service, devices)
    begun_ns = raw_now_ns()
    process.send_signal(signal.SIGSTOP)
    try:
        halted_s = devices.halt_after_s(begun_ns, 10.0)
        assert SILENCE_S - 1.0 < halted_s < SILENCE_S + 1.0
        wait_for(lambda: not devices.turning())
    finally:
        process.send_signal(signal.SIGCONT)
    wait_for(lambda: service.results("failed"))  # it does not go on with the program
    (result,) = service.results("failed")
    assert "the daemon did not run for 3 s" in result["reason"]
    assert not devices.turning()
    assert service.status()["state"] == "fault"
    send_command(service.socket, "clear")
    wait_for(lambda: service.status()["state"] == "ready")


@pytest.mark.parametrize("order", ["stop-motion", "SIGTERM"])
def test_an_order_halts_a_unit_whose_daemon_hangs(
    service: Service, devices: Devices, order: str
) -> None:
    prepare_hang(service)
    process = service.start_ready()
    set_in_motion(service, devices)
    with hanging_disk(service):
        begun_ns = raw_now_ns()
        if order == "SIGTERM":
            process.send_signal(signal.SIGTERM)
        else:
            send_command(service.socket, "halt")
        assert devices.halt_after_s(begun_ns, 10.0) < ORDERED_S


def test_a_board_that_floods_delays_no_halt(service: Service, devices: Devices) -> None:
    with flooding_board(service):
        service.start_ready()
        set_in_motion(service, devices)
        wait_for(lambda: service.status()["acquisition_dropped_bytes"] > 0)
        begun_ns = raw_now_ns()
        send_command(service.socket, "halt")
        assert devices.halt_after_s(begun_ns, 10.0) < ORDERED_S
        wait_for(lambda: service.results("failed"))
        status = service.status()
    assert status["counts"]["motion_faults"] == 0
    assert status["boards"][0]["counts"]["missing"] == 0


@pytest.mark.parametrize("victim", ["daemon", "acquisition"])
def test_a_death_halts_the_unit(service: Service, devices: Devices, victim: str) -> None:
    process = service.start_ready()
    set_in_motion(service, devices)
    (child,) = service.children()
    begun_ns = raw_now_ns()
    os.kill(process.pid if victim == "daemon" else child, signal.SIGKILL)
    assert devices.halt_after_s(begun_ns, 10.0) < ORDERED_S


@pytest.mark.parametrize("noise", [b"", b"\xa5"])
def test_a_unit_that_says_nothing_right_is_halted(
    service: Service, devices: Devices, noise: bytes
) -> None:
    service.start_ready()
    set_in_motion(service, devices)
    begun_ns = raw_now_ns()
    make_unit_say(devices, lambda data: noise * len(data))
    assert devices.halt_after_s(begun_ns, 2 * UNIT_S) < UNIT_S


def test_a_queue_of_very_many_files_delays_no_halt(service: Service, devices: Devices) -> None:
    service.start_ready()
    set_in_motion(service, devices)
    for number in range(5_000):
        (service.state / "queue" / f"x{number}.yaml").touch()
    begun_ns = raw_now_ns()
    send_command(service.socket, "halt")
    assert devices.halt_after_s(begun_ns, 10.0) < ORDERED_S


def test_a_stopped_terminal_delays_no_halt_of_a_recording(
    service: Service, devices: Devices
) -> None:
    program = service.folder / "far.yaml"
    program.write_bytes(FAR)
    command: list[str | Path] = [*GYRORIGD, "--verbose", "record", "--config", service.config]
    command += ["--program", program, "--out", service.folder / "out"]
    with terminal() as (screen, line):
        process = subprocess.Popen(command, stderr=line, stdout=subprocess.DEVNULL)
        wait_for(devices.turning)
        os.write(screen, XOFF)
        time.sleep(SILENCE_S + 1.0)  # a loop that waits for the terminal would be halted
        assert devices.turning()
        begun_ns = raw_now_ns()
        process.send_signal(signal.SIGTERM)
        assert devices.halt_after_s(begun_ns, 10.0) < ORDERED_S
        wait_for(lambda: list((service.folder / "out").glob("*.mcap")))
        os.write(screen, XON)
        assert process.wait(30) == 1
