"""The content of a recording, returned by the reader.

What to use when: `array` or the named shortcuts for many fixed-size messages; `imu_columns` for a
board's samples in a solver; `messages` for messages with text; `times_ns` to convert a `Time` field
to nanoseconds; `losses` for the missing data. For more than half an hour at 800 Hz no records of
samples are kept: `imu` reads the file again and needs 95 bytes per sample. Use `len(topics[...])`
for the number of samples.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.channel_arrays import array_dtype
from gyrorig_protocol.recording.clock_messages import (
    HOST_CLOCK_TOPIC,
    ClockPing,
    HostClock,
    clock_ping_topic,
)
from gyrorig_protocol.recording.encoding.message_layouts import FIXED_LAYOUTS
from gyrorig_protocol.recording.imu_columns import (
    SOLVER_FIELDS,
    GrowingColumns,
    ImuColumns,
    ImuColumnsChannel,
)
from gyrorig_protocol.recording.mcap.chunk_reader import RECORD_BYTES
from gyrorig_protocol.recording.mcap.losses import Loss
from gyrorig_protocol.recording.mcap.mapped_file import PageReleaser
from gyrorig_protocol.recording.mcap.record_scan import AttachmentRecord
from gyrorig_protocol.recording.messages import (
    PTU_COMMAND_TOPIC,
    PTU_POSITION_TOPIC,
    REFERENCE_ATTITUDE_TOPIC,
    SESSION_EVENT_TOPIC,
    ImuRaw,
    Message,
    PtuCommandRecord,
    PtuPosition,
    ReferenceAttitude,
    SessionEvent,
    imu_raw_topic,
)
from gyrorig_protocol.recording.motion_messages import MOTION_ORDER_TOPIC, MotionOrder
from gyrorig_protocol.recording.standard_messages import Diagnostics, Log

RecordArray = npt.NDArray[np.void]
FIRST_TIME_OF_DAY_NS = 946_684_800 * 10**9  # 2000-01-01; an earlier time counts from an origin
_DIGEST_BLOCK_BYTES = 1 << 20  # per step

M = TypeVar("M", bound=Message)

MESSAGE_TYPES: Mapping[str, type[Any]] = {
    kind.TYPE: kind
    for kind in (
        ImuRaw,
        PtuPosition,
        PtuCommandRecord,
        MotionOrder,
        SessionEvent,
        ClockPing,
        HostClock,
        ReferenceAttitude,
        Diagnostics,
        Log,
    )
}


def times_ns(time_field: npt.NDArray[np.void]) -> npt.NDArray[np.int64]:
    """Convert a `builtin_interfaces/Time` field of an array to nanoseconds, any shape."""
    time_ns: npt.NDArray[np.int64] = time_field["sec"].astype(np.int64)
    time_ns *= 1_000_000_000
    time_ns += time_field["nanosec"]
    return time_ns


def parse_board_topic(topic: str) -> str | None:
    """Return the unchecked board name in a topic of samples; None for other topics."""
    parts = topic.split("/")
    is_imu_topic = (
        len(parts) == 4 and parts[0] == "" and parts[1] == "board" and parts[3] == "imu_raw"
    )
    return parts[2] if is_imu_topic else None


def is_board_id(text: str) -> bool:
    """Return whether `text` is a valid board name."""
    try:
        BoardId(text)
    except InputError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class TimedMessage(Generic[M]):
    """A decoded message with the times and number of its record."""

    log_time_ns: int
    publish_time_ns: int
    message_sequence: int
    message: M


@dataclass(frozen=True, slots=True, eq=False)
class Topic:
    """The messages of one topic: an array if they have one size, else a list.

    For too many samples there are columns instead of records; the properties work in all cases.
    """

    type: str
    array: RecordArray | None
    timed_messages: tuple[TimedMessage[Message], ...] = ()
    columns: ImuColumnsChannel | None = None

    def __len__(self) -> int:
        """Return the number of messages."""
        if self.columns is not None:
            return self.columns.count
        return len(self.timed_messages) if self.array is None else len(self.array)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Least and largest log time; None without messages."""
        if len(self) == 0:
            return None
        if self.columns is not None:
            return self.columns.log_time_span_ns
        if self.array is not None:
            return int(self.array["log_time"].min()), int(self.array["log_time"].max())
        times_ns = [timed.log_time_ns for timed in self.timed_messages]
        return min(times_ns), max(times_ns)

    @property
    def missing_count(self) -> int:
        """Number of fixed-size messages that the writer counted and that are missing."""
        if self.columns is not None:
            return self.columns.missing_count
        if self.array is None or len(self.array) < 2:
            return 0
        gaps = np.diff(np.sort(self.array["message_sequence"].astype(np.int64))) - 1
        return int(gaps[gaps > 0].sum())


def in_order_of_time(recordings: "Sequence[Recording]") -> "tuple[Recording, ...]":
    """Return recordings in the order of time, or as given if a time of day is not known."""
    if not all(recording.has_time_of_day for recording in recordings):
        return tuple(recordings)
    return tuple(sorted(recordings, key=lambda recording: recording.start_ns))


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording. Do not write to its arrays, because they are shared."""

    path: Path
    metadata: Mapping[str, Mapping[str, str]]
    attachments: tuple[AttachmentRecord, ...]
    topics: Mapping[str, Topic]
    losses: tuple[Loss, ...]  # missing data, by cause
    notes: tuple[str, ...]  # irregularities without missing data
    file_bytes: memoryview  # for the checksum
    reread_topic: Callable[
        [str, tuple[str, ...]], Topic
    ]  # fields of a topic of samples, () for records

    @property
    def is_complete(self) -> bool:
        """True if the file was finished and no data are missing."""
        return not self.losses

    @property
    def lost_messages(self) -> int | None:
        """Number of missing messages; None if unknown."""
        counts = [loss.messages for loss in self.losses]
        return None if None in counts else sum(count or 0 for count in counts)

    @cached_property
    def sha256(self) -> str:
        """SHA-256 checksum of the file in hexadecimal, computed at the first call."""
        digest, page_releaser = hashlib.sha256(), PageReleaser(self.file_bytes)
        for start in range(0, len(self.file_bytes), _DIGEST_BLOCK_BYTES):
            digest.update(self.file_bytes[start : start + _DIGEST_BLOCK_BYTES])
            page_releaser.release_before(start)
        return digest.hexdigest()

    @property
    def board_ids(self) -> tuple[BoardId, ...]:
        """The boards with samples, sorted."""
        names = (parse_board_topic(topic) for topic in self.topics)
        return tuple(sorted(BoardId(name) for name in names if name and is_board_id(name)))

    @cached_property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time; (0, 0) without messages."""
        spans = [topic.span_ns for topic in self.topics.values()]
        first, last = zip(*filter(None, spans), strict=True) if any(spans) else ((0,), (0,))
        return min(first), max(last)

    @property
    def message_count(self) -> int:
        """The number of messages in all topics."""
        return sum(len(topic) for topic in self.topics.values())

    @property
    def start_ns(self) -> int:
        """First log time."""
        return self.span_ns[0]

    @property
    def has_time_of_day(self) -> bool:
        """Whether the times count from the epoch; an import may count from its own origin."""
        return self.start_ns >= FIRST_TIME_OF_DAY_NS

    @property
    def end_ns(self) -> int:
        """Last log time."""
        return self.span_ns[1]

    def array(self, topic: str) -> RecordArray:
        """Return all messages of a fixed-size topic.

        Args:
            topic: as in `topics`.

        Returns:
            Structured array, shape (n,), in the order of log time: log_time and
            publish_time (ns, int64), message_sequence, then the payload's fields by
            name; `Time` fields hold sec and nanosec, see `times_ns`.

        Raises:
            InputError: no such topic, or its messages vary in size.
        """
        entry = self.topics.get(topic)
        if entry is None:
            raise InputError(
                f"the recording {self.path} has no topic {topic}", self._available_topics()
            )
        if entry.columns is not None:
            entry = self.reread_topic(topic, ())
        if entry.array is None:
            raise InputError(
                f"in {self.path}, the messages on the topic {topic} differ in size, so they "
                "cannot be returned as one array",
                "read the messages one by one with timed_messages()",
            )
        return entry.array

    def timed_messages(self, topic: str) -> list[TimedMessage[Message]]:
        """Return all messages of a topic, decoded one by one, with the times of their records.

        Raises:
            InputError: no such topic, or of a type that is not of format 1.
        """
        entry = self.topics.get(topic)
        if entry is None:
            raise InputError(
                f"the recording {self.path} has no topic {topic}", self._available_topics()
            )
        message_type = MESSAGE_TYPES.get(entry.type)
        if message_type is None:
            raise InputError(
                f"in {self.path}, the topic {topic} has messages of type {entry.type}, which "
                "recording format 1 does not define",
                "read the topic with the program that wrote it",
            )
        if entry.array is None and entry.columns is None:
            return list(entry.timed_messages)
        array = self.array(topic)
        raw = np.ascontiguousarray(array).tobytes()
        size = array.dtype.itemsize
        record_heads = zip(
            array["log_time"].tolist(),
            array["publish_time"].tolist(),
            array["message_sequence"].tolist(),
            range(RECORD_BYTES, len(raw), size),
            strict=True,
        )
        return [
            TimedMessage(
                log_ns,
                publish_ns,
                sequence,
                message_type.decode(raw[start : start + size - RECORD_BYTES]),
            )
            for log_ns, publish_ns, sequence, start in record_heads
        ]

    def messages(self, topic: str) -> list[Message]:
        """Return all messages of a topic, decoded one by one; raises as `timed_messages`."""
        return [timed.message for timed in self.timed_messages(topic)]

    def imu(self, board_id: BoardId) -> RecordArray:
        """Return a board's samples, as `array`.

        Raises:
            InputError: the recording has no samples of that board.
        """
        self._imu_topic(board_id)
        return self._read_array(imu_raw_topic(board_id), ImuRaw)

    def imu_columns(self, board_id: BoardId) -> ImuColumns:
        """Return the fields that a solver needs, in a third of the memory of `imu`.

        The caller owns the arrays. A second call reads a long recording again.

        Raises:
            InputError: the recording has no samples of that board.
        """
        return self._read_columns(board_id, SOLVER_FIELDS).to_imu_columns()

    def imu_field(self, board_id: BoardId, name: str) -> npt.NDArray[np.signedinteger]:
        """Return one field of a board's samples: `host_time` in ns, or a triple, shape (n, 3).

        Raises:
            InputError: the recording has no samples of that board.
        """
        return self._read_columns(board_id, (name,)).column(name)

    def ptu_positions(self) -> RecordArray:
        """Return the pan-tilt unit's positions, as `array`; empty without any."""
        return self._read_array(PTU_POSITION_TOPIC, PtuPosition)

    def host_clock(self) -> RecordArray:
        """Return the host's clocks, as `array`; empty without any."""
        return self._read_array(HOST_CLOCK_TOPIC, HostClock)

    def reference_attitude(self) -> RecordArray:
        """Return the reference attitudes, as `array`; empty without any."""
        return self._read_array(REFERENCE_ATTITUDE_TOPIC, ReferenceAttitude)

    def clock_pings(self, board_id: BoardId) -> RecordArray:
        """Return a board's clock exchanges, as `array`; empty without any."""
        return self._read_array(clock_ping_topic(board_id), ClockPing)

    def ptu_commands(self) -> list[PtuCommandRecord]:
        """Return the commands to the pan-tilt unit and their replies, without position polling."""
        return self._read_messages(PTU_COMMAND_TOPIC, PtuCommandRecord)

    def motion_orders(self) -> RecordArray:
        """Return the unit's orders of motion, as `array`; empty in an old recording."""
        return self._read_array(MOTION_ORDER_TOPIC, MotionOrder)

    def events(self) -> list[SessionEvent]:
        """Return the session's phases, notes and faults."""
        return self._read_messages(SESSION_EVENT_TOPIC, SessionEvent)

    def _read_columns(self, board_id: BoardId, names: tuple[str, ...]) -> GrowingColumns:
        entry = self._imu_topic(board_id)
        if entry.array is not None:
            columns = GrowingColumns(names, len(entry))
            columns.append(entry.array)
            return columns
        stored = entry.columns.take_columns() if entry.columns and names == SOLVER_FIELDS else None
        if stored is None:
            reread = self.reread_topic(imu_raw_topic(board_id), names).columns
            stored = reread.take_columns() if reread is not None else None
        return stored or GrowingColumns(names, 0)

    def _available_topics(self) -> str:
        names = sorted(self.topics)
        return f"choose one of its topics: {', '.join(names)}" if names else "record again"

    def _imu_topic(self, board_id: BoardId) -> Topic:
        topic = imu_raw_topic(board_id)
        if topic not in self.topics:
            boards = self.board_ids
            raise InputError(
                f"the recording {self.path} has no samples of board {board_id}",
                f"choose one of its boards: {', '.join(boards)}"
                if boards
                else ("connect the board and record again"),
            )
        self._check_type(topic, ImuRaw)
        return self.topics[topic]

    def _read_array(self, topic: str, message_type: type[Message]) -> RecordArray:
        if topic not in self.topics:
            return np.empty(0, array_dtype(FIXED_LAYOUTS[message_type.TYPE]))
        self._check_type(topic, message_type)
        return self.array(topic)

    def _read_messages(self, topic: str, message_type: type[M]) -> list[M]:
        if topic not in self.topics:
            return []
        self._check_type(topic, message_type)
        return cast(list[M], self.messages(topic))

    def _check_type(self, topic: str, message_type: type[Message]) -> None:
        found_type = self.topics[topic].type
        if found_type != message_type.TYPE:
            raise InputError(
                f"in {self.path}, the topic {topic} has messages of type {found_type} "
                f"instead of {message_type.TYPE}",
                "copy the file from the rig again, or record again",
            )
