"""Standard ROS 2 messages in a recording: diagnostics at 1 Hz and log lines.

They are in a separate module, because ROS 2 defines their layout.

Source: diagnostic_msgs/msg/DiagnosticArray and rcl_interfaces/msg/Log.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar, Self

from gyrorig_protocol.recording.encoding.cdr_codec import CdrDecoder, CdrEncoder


class DiagnosticLevel(IntEnum):
    """The level of a diagnostic status."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


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
    """A DiagnosticArray: the state of every part of the rig at one time."""

    TYPE: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticArray"

    stamp_ns: int
    status: tuple[DiagnosticStatus, ...]
    frame_id: str = ""

    @property
    def capture_time_ns(self) -> int:
        """The time of the state."""
        return self.stamp_ns

    def encode(self) -> bytes:
        """Return the payload."""
        out = CdrEncoder()
        out.add_time(self.stamp_ns)
        out.add_string(self.frame_id)
        out.add_number("I", len(self.status))
        for status in self.status:
            out.add_number("B", status.level)
            for text in (status.name, status.message, status.hardware_id):
                out.add_string(text)
            out.add_number("I", len(status.values))
            for key, value in status.values.items():
                out.add_string(key)
                out.add_string(value)
        return out.to_payload()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a payload; raises InputError if it is invalid."""
        decoder = CdrDecoder(data)
        stamp_ns, frame_id = decoder.read_time(), decoder.read_string()
        # An element has at least its level, three strings and a count.
        status = tuple(
            cls._decode_status(decoder) for _ in range(decoder.read_count(min_element_bytes=20))
        )
        decoder.check_end()
        return cls(stamp_ns, status, frame_id)

    @staticmethod
    def _decode_status(decoder: CdrDecoder) -> DiagnosticStatus:
        level = decoder.read_integer("B")
        name, message, hardware_id = (
            decoder.read_string(),
            decoder.read_string(),
            decoder.read_string(),
        )
        pairs = [
            (decoder.read_string(), decoder.read_string())
            for _ in range(decoder.read_count(min_element_bytes=10))
        ]
        return DiagnosticStatus(level, name, message, hardware_id, dict(pairs))


@dataclass(frozen=True, slots=True)
class Log:
    """One line of the daemon's log."""

    TYPE: ClassVar[str] = "rcl_interfaces/msg/Log"

    stamp_ns: int
    level: int  # DEBUG 10, INFO 20, WARN 30, ERROR 40, FATAL 50
    name: str
    msg: str
    file: str = ""
    function: str = ""
    line: int = 0

    @property
    def capture_time_ns(self) -> int:
        """The time of the line."""
        return self.stamp_ns

    def encode(self) -> bytes:
        """Return the payload."""
        out = CdrEncoder()
        out.add_time(self.stamp_ns)
        out.add_number("B", self.level)
        for text in (self.name, self.msg, self.file, self.function):
            out.add_string(text)
        out.add_number("I", self.line)
        return out.to_payload()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a payload; raises InputError if it is invalid."""
        decoder = CdrDecoder(data)
        stamp_ns, level = decoder.read_time(), decoder.read_integer("B")
        name, msg, file, function = (decoder.read_string() for _ in range(4))
        log = cls(stamp_ns, level, name, msg, file, function, decoder.read_integer("I"))
        decoder.check_end()
        return log
