"""Recordings small enough to be damaged everywhere."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.clock_messages import (
    HOST_CLOCK_TOPIC,
    ClockPing,
    HostClock,
    clock_ping_topic,
)
from gyrorig_protocol.recording.messages import (
    PTU_COMMAND_TOPIC,
    PTU_POSITION_TOPIC,
    REFERENCE_ATTITUDE_TOPIC,
    SESSION_EVENT_TOPIC,
    EventKind,
    ImuRaw,
    Message,
    PtuCommandRecord,
    PtuPosition,
    ReferenceAttitude,
    SessionEvent,
    imu_raw_topic,
)
from gyrorig_protocol.recording.writer import Attachment, RecordingWriter

START_NS = 1_790_000_000_000_000_000
BOARDS = (BoardId("B-1"), BoardId("B-2"))

_PTU = [
    "model",
    "pan_resolution_arcsec",
    "tilt_resolution_arcsec",
    "pan_acceleration",
    "tilt_acceleration",
    "pan_base_speed",
    "tilt_base_speed",
]


def metadata() -> dict[str, dict[str, str]]:
    """What the contract asks for."""
    board = {"uid": "u", "sensor": "L3G4200D", "link": "serial", "gyro_scale_rad_s": "0.000153"}
    return {
        "gyrorig": {
            "session": "s-1",
            "rig": "rig-1",
            "anchor_utc_ns": str(START_NS),
            "anchor_monotonic_raw_ns": "5000000000",
        },
        "gyrorig.ptu": dict.fromkeys(_PTU, "185.142857"),
        **{f"gyrorig.board.{board_id}": dict(board) for board_id in BOARDS},
    }


@dataclass
class Script:
    """Messages in the order of writing, and where chunks end."""

    entries: list[tuple[str, Message, int]] = field(default_factory=list)
    flush_every: int = 10

    def write(self, path: Path) -> Path:
        with RecordingWriter(path, metadata(), [Attachment("rig.yaml", "text/x", b"a: 1")]) as out:
            for i, (topic, message, time_ns) in enumerate(self.entries):
                out.write(topic, message, time_ns)
                if i % self.flush_every == self.flush_every - 1:
                    out.flush()
        return path

    def by_topic(self, count: int | None = None) -> dict[str, list[Message]]:
        actual: dict[str, list[Message]] = {}
        for topic, message, _ in self.entries[:count]:
            actual.setdefault(topic, []).append(message)
        return actual


def make_script(steps: int, flush_every: int = 10) -> Script:
    """Two boards, positions, and one of everything else, all values different."""
    random = np.random.default_rng(7)
    script = Script(flush_every=flush_every)

    def triple() -> tuple[int, int, int]:
        a, b, c = (int(v) for v in random.integers(-(2**31), 2**31, 3))
        return a, b, c

    def add(topic: str, message: Message, time_ns: int) -> None:
        script.entries.append((topic, message, time_ns))

    for k in range(steps):
        t = START_NS + k * 10_000_000
        for board in BOARDS:
            imu = ImuRaw(t + 7, k * 10_000, k, 0x104, -k, triple(), triple(), triple())
            add(imu_raw_topic(board), imu, t + 7)
        position = PtuPosition(t, t + 3, t + 5, k, -k, k * 0.1, -k * 0.1, 2**40 + k, k, 3)
        add(PTU_POSITION_TOPIC, position, t + 5)
        if k % 3 == 0:
            command = PtuCommandRecord(t, t + 1, t + 2, k, k % 4, f"PP{k} ", "* é" * (k % 5))
            add(PTU_COMMAND_TOPIC, command, t + 2)
            event = SessionEvent(t, EventKind.NOTE, "sweep", "x" * (k % 7))
            add(SESSION_EVENT_TOPIC, event, t)
            add(clock_ping_topic(BOARDS[0]), ClockPing(t, t + 9, k, k + 1, k, 1), t + 9)
            add(HOST_CLOCK_TOPIC, HostClock(k, k + 1, t, 0.5, 1e-6, 64), t)
            attitude = ReferenceAttitude(t, (0.0, 0.6, 0.0, 0.8), 1e-4, 1)
            add(REFERENCE_ATTITUDE_TOPIC, attitude, t)
    return script


@pytest.fixture
def script() -> Script:
    return make_script(12)


@pytest.fixture
def scripted() -> Callable[..., Any]:
    """`make_script`, for tests that need another length."""
    return make_script


@pytest.fixture
def contract_metadata() -> dict[str, dict[str, str]]:
    return metadata()


def as_plain(value: Any) -> Any:
    """A message that mcap-ros2-support or rosbags decoded, as dicts, lists and numbers."""
    if hasattr(value, "sec") and hasattr(value, "nanosec"):
        return value.sec * 10**9 + value.nanosec
    if hasattr(value, "tolist"):
        return value.tolist()
    names = getattr(value, "__slots__", None) or getattr(value, "__dict__", None)
    if names and not isinstance(value, str):
        return {n: as_plain(getattr(value, n)) for n in names if n[0].islower()}
    if isinstance(value, list | tuple):
        return [as_plain(item) for item in value]
    return value


@pytest.fixture(scope="session")
def plain() -> Callable[[Any], Any]:
    return as_plain
