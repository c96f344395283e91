"""What a recording holds, as the reader gives it back.

What to use when: `array` or the named shortcuts for fixed-size messages in bulk,
`imu_columns` for a board's samples in a solver, `messages` for texts, `times_ns` to turn
a `Time` field into nanoseconds, `losses` to know what is missing before believing the
rest. Of more than half an hour at 800 Hz no records of samples are kept: `imu` reads the
file once more then and takes 95 bytes a sample, so ask `len(topics[...])` for their count.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.arrays import array_dtype
from gyrorig_protocol.recording.cdr import fixed_layout
from gyrorig_protocol.recording.chunks import RECORD_BYTES
from gyrorig_protocol.recording.framing import AttachmentRecord
from gyrorig_protocol.recording.imu_columns import (
    FOR_SOLVING,
    Columns,
    ColumnsChannel,
    ImuColumns,
)
from gyrorig_protocol.recording.losses import Loss
from gyrorig_protocol.recording.mapped import Passage
from gyrorig_protocol.recording.messages import (
    HOST_CLOCK_TOPIC,
    PTU_COMMAND_TOPIC,
    PTU_POSITION_TOPIC,
    REFERENCE_ATTITUDE_TOPIC,
    SESSION_EVENT_TOPIC,
    ClockPing,
    HostClock,
    ImuRaw,
    Message,
    PtuCommandRecord,
    PtuPosition,
    ReferenceAttitude,
    SessionEvent,
    clock_topic,
    imu_topic,
)
from gyrorig_protocol.recording.schemas import SCHEMAS
from gyrorig_protocol.recording.standard_messages import Diagnostics, Log

RecordArray = npt.NDArray[np.void]
_DIGESTED_BYTES = 1 << 20  # at a time

M = TypeVar("M", bound=Message)

MESSAGE_TYPES: Mapping[str, type[Any]] = {
    kind.TYPE: kind
    for kind in (
        ImuRaw,
        PtuPosition,
        PtuCommandRecord,
        SessionEvent,
        ClockPing,
        HostClock,
        ReferenceAttitude,
        Diagnostics,
        Log,
    )
}


def times_ns(field: npt.NDArray[np.void]) -> npt.NDArray[np.int64]:
    """A `builtin_interfaces/Time` field of an array as nanoseconds, any shape."""
    time_ns: npt.NDArray[np.int64] = field["sec"].astype(np.int64)
    time_ns *= 1_000_000_000
    time_ns += field["nanosec"]
    return time_ns


def board_of(topic: str) -> str | None:
    """The name in a board's topic of samples, not yet checked; None for other topics."""
    parts = topic.split("/")
    ours = len(parts) == 4 and parts[0] == "" and parts[1] == "board" and parts[3] == "imu_raw"
    return parts[2] if ours else None


def is_board_id(name: str) -> bool:
    """Whether `BoardId` takes it."""
    try:
        BoardId(name)
    except InputError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class Stamped(Generic[M]):
    """A decoded message with what its record says about it."""

    log_time_ns: int
    publish_time_ns: int
    message_sequence: int
    message: M


@dataclass(frozen=True, slots=True, eq=False)
class Topic:
    """The messages of one topic: an array where they have one size, else a list.

    Where samples are too many to keep their records, columns; what is asked here is then
    answered without them.
    """

    type: str
    array: RecordArray | None
    stamped: tuple[Stamped[Message], ...] = ()
    columns: ColumnsChannel | None = None

    def __len__(self) -> int:
        """How many messages."""
        if self.columns is not None:
            return self.columns.count
        return len(self.stamped) if self.array is None else len(self.array)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Least and largest log time; None without any message."""
        if len(self) == 0:
            return None
        if self.columns is not None:
            return self.columns.log_times_ns
        if self.array is not None:
            return int(self.array["log_time"].min()), int(self.array["log_time"].max())
        times_ns = [one.log_time_ns for one in self.stamped]
        return min(times_ns), max(times_ns)

    @property
    def dropped(self) -> int:
        """How many messages of one size the writer counted that are not here."""
        if self.columns is not None:
            return self.columns.dropped
        if self.array is None or len(self.array) < 2:
            return 0
        gaps = np.diff(np.sort(self.array["message_sequence"].astype(np.int64))) - 1
        return int(gaps[gaps > 0].sum())


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording, read whole. Arrays must not be written to: they are shared."""

    path: Path
    metadata: Mapping[str, Mapping[str, str]]
    attachments: tuple[AttachmentRecord, ...]
    topics: Mapping[str, Topic]
    losses: tuple[Loss, ...]  # what is missing, by cause
    notes: tuple[str, ...]  # what is odd, without anything missing
    file: memoryview  # the bytes that were read, for the digest
    read_again: Callable[[str, tuple[str, ...]], Topic]  # fields of a topic of samples, or ()

    @property
    def complete(self) -> bool:
        """True when the file was finished and nothing of it is missing."""
        return not self.losses

    @property
    def lost_messages(self) -> int | None:
        """How many messages are missing; None when nobody can tell."""
        counts = [loss.messages for loss in self.losses]
        return None if None in counts else sum(count or 0 for count in counts)

    @cached_property
    def sha256(self) -> str:
        """Digest of the bytes that were read, in hexadecimal; computed when first asked for."""
        digest, passage = hashlib.sha256(), Passage(self.file)
        for at in range(0, len(self.file), _DIGESTED_BYTES):
            digest.update(self.file[at : at + _DIGESTED_BYTES])
            passage.reached(at)
        return digest.hexdigest()

    @property
    def board_ids(self) -> tuple[BoardId, ...]:
        """The boards that have samples here, sorted."""
        names = (board_of(topic) for topic in self.topics)
        return tuple(sorted(BoardId(name) for name in names if name and is_board_id(name)))

    @cached_property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time; (0, 0) without any message."""
        spans = [topic.span_ns for topic in self.topics.values()]
        first, last = zip(*filter(None, spans), strict=True) if any(spans) else ((0,), (0,))
        return min(first), max(last)

    @property
    def start_ns(self) -> int:
        """First log time."""
        return self.span_ns[0]

    @property
    def end_ns(self) -> int:
        """Last log time."""
        return self.span_ns[1]

    def array(self, topic: str) -> RecordArray:
        """All messages of a fixed-size topic.

        Args:
            topic: as in `topics`.

        Returns:
            Structured array, shape (n,), in the order of log time: log_time and
            publish_time (ns, int64), message_sequence, then the payload's fields by
            name; `Time` fields hold sec and nanosec, see `times_ns`.

        Raises:
            InputError: no such topic, or its messages vary in size.
        """
        found = self.topics.get(topic)
        if found is None:
            raise InputError(f"{self.path} holds no {topic}", self._topics_here())
        if found.columns is not None:
            found = self.read_again(topic, ())
        if found.array is None:
            raise InputError(
                f"{self.path}: {topic} holds {found.type}, whose messages vary in size",
                "take its messages one by one: stamped()",
            )
        return found.array

    def stamped(self, topic: str) -> list[Stamped[Message]]:
        """All messages of a topic, decoded one by one, with their records' times.

        Raises:
            InputError: no such topic, or of a type that is not of format 1.
        """
        found = self.topics.get(topic)
        if found is None:
            raise InputError(f"{self.path} holds no {topic}", self._topics_here())
        kind = MESSAGE_TYPES.get(found.type)
        if kind is None:
            raise InputError(
                f"{self.path}: {topic} holds {found.type}, which is not of format 1",
                "read it with a program that knows it",
            )
        if found.array is None and found.columns is None:
            return list(found.stamped)
        array = self.array(topic)
        raw = np.ascontiguousarray(array).tobytes()
        size = array.dtype.itemsize
        heads = zip(
            array["log_time"].tolist(),
            array["publish_time"].tolist(),
            array["message_sequence"].tolist(),
            range(RECORD_BYTES, len(raw), size),
            strict=True,
        )
        return [
            Stamped(log_ns, publish_ns, sequence, kind.decode(raw[at : at + size - RECORD_BYTES]))
            for log_ns, publish_ns, sequence, at in heads
        ]

    def messages(self, topic: str) -> list[Message]:
        """All messages of a topic, decoded one by one; raises as `stamped`."""
        return [one.message for one in self.stamped(topic)]

    def imu(self, board_id: BoardId) -> RecordArray:
        """A board's samples, as `array`.

        Raises:
            InputError: the recording holds none of that board.
        """
        self._samples_of(board_id)
        return self._array_of(imu_topic(board_id), ImuRaw)

    def imu_columns(self, board_id: BoardId) -> ImuColumns:
        """What a solver needs of a board's samples, in a third of the memory of `imu`.

        The arrays are the caller's own. Asked for again, a long recording is read again.

        Raises:
            InputError: the recording holds none of that board.
        """
        return self._columns(board_id, FOR_SOLVING).imu()

    def imu_field(self, board_id: BoardId, name: str) -> npt.NDArray[np.signedinteger]:
        """One field of a board's samples: `host_time` in ns, or a triple, shape (n, 3).

        Raises:
            InputError: the recording holds none of that board.
        """
        return self._columns(board_id, (name,)).array(name)

    def ptu_positions(self) -> RecordArray:
        """The pan-tilt unit's positions, as `array`; empty without any."""
        return self._array_of(PTU_POSITION_TOPIC, PtuPosition)

    def host_clock(self) -> RecordArray:
        """The host's clocks, as `array`; empty without any."""
        return self._array_of(HOST_CLOCK_TOPIC, HostClock)

    def reference_attitude(self) -> RecordArray:
        """The reference attitudes, as `array`; empty without any."""
        return self._array_of(REFERENCE_ATTITUDE_TOPIC, ReferenceAttitude)

    def clock_pings(self, board_id: BoardId) -> RecordArray:
        """A board's clock exchanges, as `array`; empty without any."""
        return self._array_of(clock_topic(board_id), ClockPing)

    def ptu_commands(self) -> list[PtuCommandRecord]:
        """The exchanges with the pan-tilt unit that are no position polls."""
        return self._list_of(PTU_COMMAND_TOPIC, PtuCommandRecord)

    def events(self) -> list[SessionEvent]:
        """The session's phases, notes and faults."""
        return self._list_of(SESSION_EVENT_TOPIC, SessionEvent)

    def _columns(self, board_id: BoardId, names: tuple[str, ...]) -> Columns:
        found = self._samples_of(board_id)
        if found.array is not None:
            columns = Columns(names, len(found))
            columns.append(found.array)
            return columns
        kept = found.columns.take() if found.columns and names == FOR_SOLVING else None
        if kept is None:
            again = self.read_again(imu_topic(board_id), names).columns
            kept = again.take() if again is not None else None
        return kept or Columns(names, 0)

    def _topics_here(self) -> str:
        there = sorted(self.topics)
        return f"name one of {', '.join(there)}" if there else "nothing was recorded in it"

    def _samples_of(self, board_id: BoardId) -> Topic:
        topic = imu_topic(board_id)
        if topic not in self.topics:
            known = ", ".join(self.board_ids) or "no board at all"
            raise InputError(
                f"{self.path} holds no samples of {board_id}", f"name one that it holds: {known}"
            )
        self._check_type(topic, ImuRaw)
        return self.topics[topic]

    def _array_of(self, topic: str, kind: type[Message]) -> RecordArray:
        if topic not in self.topics:
            layout = fixed_layout(kind.TYPE, SCHEMAS[kind.TYPE])
            return np.empty(0, array_dtype(cast(Any, layout)))
        self._check_type(topic, kind)
        return self.array(topic)

    def _list_of(self, topic: str, kind: type[M]) -> list[M]:
        if topic not in self.topics:
            return []
        self._check_type(topic, kind)
        return cast(list[M], self.messages(topic))

    def _check_type(self, topic: str, kind: type[Message]) -> None:
        found = self.topics[topic].type
        if found != kind.TYPE:
            raise InputError(
                f"{self.path}: {topic} holds {found}, not {kind.TYPE}",
                "another program wrote it: copy it from the rig again, or record anew",
            )
