"""Losses by the boards' own counters in a recording of libraries alone."""

import struct
from pathlib import Path
from typing import Any

import can
import numpy as np
from mcap.reader import make_reader
from tests.bench.daemon_load.load import BUSES, NODES

from gyrorig_protocol.board import FrameEvent, FrameParser, Sample
from gyrorig_protocol.can import CanBoardParser, CanFrame

WRAP = 1 << 16
STAMPED = struct.Struct("<q")


class _Counter:
    """Counts the gaps of one board's numbers."""

    def __init__(self) -> None:
        self.samples = self.missing = 0
        self._last: int | None = None

    def count(self, number: int) -> None:
        self.samples += 1
        if self._last is not None:
            step = (number - self._last) % WRAP
            self.missing += step - 1 if 0 < step < WRAP // 2 else 0
        self._last = number


def read_plain_figures(folder: Path) -> dict[str, Any]:
    """Return counts and lateness of both halves."""
    serial, serial_late = _serial(folder / "serial.mcap")
    buses = _buses(folder)
    return {
        "serial_samples": sum(c.samples for c in serial.values()),
        "serial_missing": sum(c.missing for c in serial.values()),
        "serial_late_ms": {
            "p50": float(np.percentile(serial_late, 50)),
            "p99": float(np.percentile(serial_late, 99)),
            "max": float(np.max(serial_late)),
        },
        "can_samples": sum(c.samples for c in buses.values()),
        "can_missing": sum(c.missing for c in buses.values()),
    }


def _serial(path: Path) -> tuple[dict[str, _Counter], np.ndarray[Any, np.dtype[np.float64]]]:
    counters: dict[str, _Counter] = {}
    parsers: dict[str, FrameParser] = {}
    late_ms: list[float] = []
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            (arrived_ns,) = STAMPED.unpack_from(message.data)
            parser = parsers.setdefault(channel.topic, FrameParser())
            counter = counters.setdefault(channel.topic, _Counter())
            for event in parser.feed(message.data[STAMPED.size :], arrived_ns):
                if isinstance(event, FrameEvent) and isinstance(event.frame, Sample):
                    counter.count(event.frame.sequence)
                    late_us = (arrived_ns / 1000.0 - (event.frame.device_time or 0)) % 2**32
                    late_ms.append(late_us / 1000.0)
    return counters, np.array(late_ms)


def _buses(folder: Path) -> dict[tuple[int, int], _Counter]:
    counters: dict[tuple[int, int], _Counter] = {}
    for number in range(BUSES):
        parsers = {node: CanBoardParser(node) for node in range(1, NODES + 1)}
        for message in can.LogReader(folder / f"can{number}.blf"):
            node = message.arbitration_id & 0x7F
            if node not in parsers:
                continue
            stamp_ns = round(message.timestamp * 1e9)
            frame = CanFrame(message.arbitration_id, bytes(message.data), 0, stamp_ns)
            counter = counters.setdefault((number, node), _Counter())
            for event in parsers[node].feed(frame):
                if isinstance(event, FrameEvent) and isinstance(event.frame, Sample):
                    counter.count(event.frame.sequence)
    return counters
