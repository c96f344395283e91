"""The firmware as a program on a pty, and the daemon's own acquisition and board link."""

import os
import pty
import random
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import pytest

from gyrorig_daemon.clocks.capture_clock import anchor_now
from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.links.boards.board_link import BoardLink
from gyrorig_daemon.links.boards.sample_stream import BoardSinks
from gyrorig_daemon.links.ports.acquisition_hub import AcquisitionHub, PortSettings
from gyrorig_daemon.links.pump import Pump
from gyrorig_protocol.recording.clock_messages import ClockPing
from gyrorig_protocol.recording.messages import ImuRaw, ImuStatus

PATIENCE_NS = 60_000_000_000
PERIOD_US = 5_000  # of host_board.c
GAP_EVERY = 100


@pytest.fixture(params=[1, 5], ids=["samples", "batches"])
def port(request: pytest.FixtureRequest, host_board: Path) -> Iterator[str]:
    """The pty on which `host_board.c` speaks."""
    device, received = pty.openpty()
    os.set_blocking(device, False)
    program = subprocess.Popen([host_board, str(device), str(request.param)], pass_fds=[device])
    os.close(device)
    try:
        yield os.ttyname(received)
    finally:
        program.terminate()
        program.wait(60)
        with suppress(OSError):
            os.close(received)


def test_every_sample_arrives_unchanged(port: str) -> None:
    samples: list[tuple[ImuRaw, int]] = []
    pings: list[ClockPing] = []
    faults: list[str] = []
    sinks = BoardSinks(
        sample=lambda _, message, taken_ns: samples.append((message, taken_ns)),
        ping=lambda _, message: pings.append(message),
        note=faults.append,
        fault=faults.append,
    )
    config = BoardPort(id="A", port=port, baud=115200)
    with AcquisitionHub({config.hub_port: PortSettings(port, config.baud)}) as hub:
        pump = Pump(hub)
        link = BoardLink(pump, config, anchor_now(), sinks, random.Random(1))
        link.identify()
        end_ns = pump.now_ns() + PATIENCE_NS
        assert pump.run_until(end_ns, lambda: len(samples) > 200 and len(pings) > 0)
        output = link.metadata()
        broken = {cause: count for cause, count in link.faults().items() if count}
        counts = link.counts
    assert (output["uid"], output["sensor"], output["odr_hz"]) == (
        "00112233aabbccdd",
        "L3G4200D",
        "200.0",
    )
    assert len(samples) > 200
    numbers = [message.sequence for message, _ in samples]
    # all except those that the firmware reports as lost
    gaps = [n + 1 for n, after in pairwise(numbers) if after != n + 1]
    assert gaps == [n for n in range(numbers[0], numbers[-1]) if n % GAP_EVERY == GAP_EVERY - 1]
    assert counts.missing == len(gaps)
    for message, _ in samples:
        n = message.sequence
        assert message.gyro == tuple(_int16(value) for value in (n, -n, 3 * n))
        assert message.accel == (1, 2, 256)
        assert message.temperature == 215
    # a first batch that comes before HELLO has no period yet: the daemon gives it one timestamp
    stamps = [message.device_time for message, _ in samples[5:]]
    steps = {after - before for before, after in pairwise(stamps)}
    assert steps <= {PERIOD_US, 2 * PERIOD_US}
    overrun = [m.sequence for m, _ in samples if m.status & ImuStatus.OVERRUN]
    assert {n - 1 for n in overrun} >= set(gaps)
    assert pings
    assert all(ping.device_receive <= ping.device_send for ping in pings)
    assert broken in ({}, {"cobs": 1}, {"crc": 1}, {"length": 1})  # the port opens mid-frame
    assert counts.restarts == counts.reordered == counts.duplicated == 0
    assert not faults


def _int16(value: int) -> int:
    return (value + 0x8000) % 0x10000 - 0x8000
