"""The two messages borrowed from ROS 2: diagnostics at 1 Hz and log lines.

Kept apart from `messages` because their layout is not ours to change.

Source: diagnostic_msgs/msg/DiagnosticArray and rcl_interfaces/msg/Log.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar, Self

from gyrorig_protocol.recording.cdr_stream import CdrDecoder, CdrEncoder


class DiagnosticLevel(IntEnum):
    """How well a part of the rig does."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class LogLevel(IntEnum):
    """Severity of a log line."""

    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


@dataclass(frozen=True, slots=True)
class DiagnosticStatus:
    """The state of one part of the rig."""

    level: int  # DiagnosticLevel
    name: str
    message: str
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """A DiagnosticArray: the state of every part at one time."""

    TYPE: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticArray"

    stamp_ns: int
    status: tuple[DiagnosticStatus, ...]
    frame_id: str = ""

    @property
    def capture_time_ns(self) -> int:
        """When the state was looked at."""
        return self.stamp_ns

    def encode(self) -> bytes:
        """The payload."""
        out = CdrEncoder()
        out.time(self.stamp_ns)
        out.string(self.frame_id)
        out.number("I", len(self.status))
        for one in self.status:
            out.number("B", one.level)
            for text in (one.name, one.message, one.hardware_id):
                out.string(text)
            out.number("I", len(one.values))
            for key, value in one.values.items():
                out.string(key)
                out.string(value)
        return out.take()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a payload; raises InputError when it is not one."""
        read = CdrDecoder(data)
        stamp_ns, frame_id = read.time(), read.string()
        # An element takes at least its level, three strings and a count.
        status = tuple(cls._status(read) for _ in range(read.count(least_bytes=20)))
        read.end()
        return cls(stamp_ns, status, frame_id)

    @staticmethod
    def _status(read: CdrDecoder) -> DiagnosticStatus:
        level = read.number("B")
        name, message, hardware_id = read.string(), read.string(), read.string()
        pairs = [(read.string(), read.string()) for _ in range(read.count(least_bytes=10))]
        return DiagnosticStatus(level, name, message, hardware_id, dict(pairs))


@dataclass(frozen=True, slots=True)
class Log:
    """One line of the daemon's log."""

    TYPE: ClassVar[str] = "rcl_interfaces/msg/Log"

    stamp_ns: int
    level: int  # LogLevel
    name: str
    msg: str
    file: str = ""
    function: str = ""
    line: int = 0

    @property
    def capture_time_ns(self) -> int:
        """When the line was written."""
        return self.stamp_ns

    def encode(self) -> bytes:
        """The payload."""
        out = CdrEncoder()
        out.time(self.stamp_ns)
        out.number("B", self.level)
        for text in (self.name, self.msg, self.file, self.function):
            out.string(text)
        out.number("I", self.line)
        return out.take()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a payload; raises InputError when it is not one."""
        read = CdrDecoder(data)
        stamp_ns, level = read.time(), read.number("B")
        name, msg, file, function = (read.string() for _ in range(4))
        found = cls(stamp_ns, level, name, msg, file, function, read.number("I"))
        read.end()
        return found
