"""Write a recording of format 1 so that a crash costs a second and a power cut ten.

What to use when: one `RecordingWriter` per file, used by one thread. `write` for
messages as they come, `write_imu_array` for importers that hold whole arrays, `tick`
from the loop of the same thread, `close` at the end.

Theory of operation: messages are collected into a chunk; a chunk is only safe once it is
written out whole. `tick` closes the chunk every second (a killed process loses
at most that) and syncs every ten (a power cut loses at most that). After an error of
the disk the file is cut back to the last whole chunk and never written again, because
a torn record in the middle would hide everything behind it from most readers.

Source: the recording contract, format 1, section "File".
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self, TypeVar

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.errors import MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.disk_file import DISK, Disk
from gyrorig_protocol.recording.head import Attachment, complete_metadata, software
from gyrorig_protocol.recording.imu_array import pack_imu
from gyrorig_protocol.recording.messages import ImuRaw, Message, imu_topic
from gyrorig_protocol.recording.part_file import PartFile

_NEVER_OVERWRITTEN = "a recording is never overwritten: name another, or move that one away"

__all__ = ["Attachment", "RecordingWriter", "software", "unfinished"]

T = TypeVar("T")

IntArray = npt.NDArray[np.integer]

FLUSH_NS = 1_000_000_000  # contract: "flushed to a complete chunk at least once a second"
SYNC_NS = 10_000_000_000  # contract: "synced to disk at least every 10 s"


class RecordingWriter:
    """A recording being written. Not to be used by two threads at once.

    Args:
        path: the final name, ending in `.mcap`; `.mcap.part` until it is closed.
        metadata: name -> record. `gyrorig` with `session`, `anchor_utc_ns` and
            `anchor_monotonic_raw_ns` is required; `format`, `software`, `part`,
            `previous` and `foxglove` are filled in where missing.
        attachments: files to carry, written first.
        disk: where it goes.
        aside: slow work is left to the owner, who calls `sync` as often as the contract
            asks and `salvage` after an error, from another thread if that suits.
        lasting: wait until the beginning is on the disk; else the first `sync` does that.

    Raises:
        UsageError: the file, or its `.part`, exists.
        MachineError: the disk refuses; the text names the file that is kept.
        ValueError: metadata that the contract does not allow.
    """

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment] = (),
        *,
        disk: Disk = DISK,
        aside: bool = False,
        lasting: bool = True,
    ) -> None:
        if path.suffix != ".mcap":
            raise ValueError(f"a recording is named .mcap, not {path.name}")
        records = complete_metadata(metadata)
        self._final = path
        self._part = unfinished(path)
        self._disk = disk
        self._aside = aside
        self._last_flush_ns: int | None = None
        self._last_sync_ns: int | None = None
        self._open = False
        self._file = self._create()
        self._open = True
        try:
            self._guard(lambda: self._begin(records, attachments, lasting))
        except MachineError:
            with suppress(OSError):  # nothing is in it that the caller does not have
                if aside:
                    self._file.salvage()
                disk.unlink(self._part)
            raise

    @property
    def path(self) -> Path:
        """Where the recording is now: `.mcap.part` until `close` has succeeded."""
        return self._final if self._file.renamed else self._part

    @property
    def closed(self) -> bool:
        """True after `close`, and after an error of the disk."""
        return not self._open

    @property
    def lost_messages(self) -> int:
        """Messages taken but not in the file, because the disk refused them."""
        return self._file.safe.lost

    @property
    def waiting_messages(self) -> int:
        """Messages taken that are in no whole chunk yet: what an error now would cost."""
        return self._file.safe.waiting

    @property
    def bytes_written(self) -> int:
        """Length of the file so far, without the open chunk."""
        return self._file.safe.position

    def write(
        self,
        topic: str,
        message: Message,
        log_time_ns: int | None = None,
        publish_time_ns: int | None = None,
    ) -> None:
        """Append one message.

        Args:
            topic: begins with a slash; its channel is made at the first message.
            message: one of `messages` or `standard_messages`.
            log_time_ns: capture time at which it was complete in the host's hands;
                may be left out where the payload repeats it.
            publish_time_ns: best estimate of when the sample was taken.

        Raises:
            ValueError: the log time goes back on its topic, or is not the payload's,
                or the topic holds another type.
            MachineError: the disk refused; see the class.
        """
        payload_time = message.capture_time_ns
        time_ns = payload_time if log_time_ns is None else log_time_ns
        if time_ns is None:
            raise ValueError(f"{message.TYPE} holds no log time: give one")
        ours = message.TYPE.startswith("gyrorig_msgs/")
        if ours and payload_time is not None and payload_time != time_ns:
            raise ValueError(f"{topic}: log time {time_ns} is not the payload's {payload_time}")
        publish_ns = time_ns if publish_time_ns is None else publish_time_ns
        self.write_encoded(topic, message.TYPE, message.encode(), time_ns, publish_ns)

    def write_encoded(
        self,
        topic: str,
        type_name: str,
        payload: bytes,
        log_time_ns: int,
        publish_time_ns: int,
        sequence: int | None = None,
    ) -> None:
        """Append one message that is encoded already.

        Args:
            topic: as in `write`.
            type_name: of its schema.
            payload: header and fields.
            log_time_ns: as in `write`; the payload's own times are not looked at.
            publish_time_ns: as in `write`.
            sequence: the message's own, where the caller counts; else the next one.

        Raises:
            ValueError: as in `write`.
            MachineError: the disk refused; see the class.
        """
        self._check_open()
        file = self._file
        channel = file.channels.get(topic)
        if channel is None:
            channel = self._guard(lambda: file.channel(topic, type_name))
        if channel.type != type_name:
            raise ValueError(f"{topic} holds {channel.type}, not {type_name}")
        if log_time_ns < channel.last_log_time_ns:
            before_ns = channel.last_log_time_ns
            raise ValueError(f"{topic}: log time {log_time_ns} < {before_ns} before it")
        if sequence is not None:
            channel.sequence = sequence
        try:
            file.append(channel, log_time_ns, publish_time_ns, payload)
        except OSError as error:
            self._stop_for_good(error)

    def write_imu_array(
        self,
        board_id: BoardId,
        *,
        host_time_ns: IntArray,
        publish_time_ns: IntArray | None,
        device_time: IntArray,
        sequence: IntArray,
        status: IntArray,
        temperature: IntArray,
        gyro: IntArray,
        accel: IntArray | None = None,
        mag: IntArray | None = None,
    ) -> None:
        """Append many samples of one board, about ten times as fast as one by one.

        Args:
            board_id: whose samples.
            host_time_ns: capture times, not decreasing, shape (n,).
            publish_time_ns: when each was taken, shape (n,); None: as the host times.
            device_time: ticks as sent, shape (n,).
            sequence: sample counters as sent, shape (n,).
            status: `ImuStatus` bits, shape (n,).
            temperature: raw, shape (n,).
            gyro: counts, shape (n, 3).
            accel: counts, shape (n, 3); None: zero.
            mag: counts, shape (n, 3); None: zero.

        Raises:
            ValueError: shapes differ, a value does not fit, or the time goes back.
            MachineError: the disk refused; see the class.
        """
        payloads = pack_imu(
            host_time_ns=host_time_ns,
            device_time=device_time,
            sequence=sequence,
            status=status,
            temperature=temperature,
            gyro=gyro,
            accel=accel,
            mag=mag,
        )
        times = [int(t) for t in host_time_ns]
        published = times if publish_time_ns is None else [int(t) for t in publish_time_ns]
        if len(published) != len(times):
            raise ValueError(f"{len(published)} publish times for {len(times)} samples")
        if not times:
            return
        self._check_open()
        file = self._file
        channel = self._guard(lambda: file.channel(imu_topic(board_id), ImuRaw.TYPE))
        if times[0] < channel.last_log_time_ns or bool(np.any(np.diff(host_time_ns) < 0)):
            raise ValueError(f"{imu_topic(board_id)}: log time goes back")

        def append_all() -> None:
            for time_ns, publish_ns, payload in zip(times, published, payloads, strict=True):
                file.append(channel, time_ns, publish_ns, payload)

        self._guard(append_all)

    def skip(self, topic: str, count: int = 1) -> None:
        """Leave a gap in a channel's message sequence: `count` messages never came here.

        Before the first message of a topic there is nothing that a gap could follow.
        """
        channel = self._file.channels.get(topic)
        if channel is not None:
            channel.sequence = (channel.sequence + count) & 0xFFFFFFFF

    def tick(self, now_ns: int) -> None:
        """Close the chunk and sync the file when they are due.

        Args:
            now_ns: any clock that does not go back; call several times a second.

        Raises:
            MachineError: the disk refused; see the class.
        """
        self._check_open()
        if self._last_flush_ns is None or self._last_sync_ns is None:
            # The first chunk soon: until then nothing but the beginning is there to be kept.
            self._last_flush_ns, self._last_sync_ns = now_ns - FLUSH_NS // 2, now_ns
            return
        # Due early, so that the calls' own spacing on a loaded machine does not exceed the limit:
        # at 0.75 s one kill of 200 cost 1.14 s (ten times as many processes as cores).
        if now_ns - self._last_flush_ns >= FLUSH_NS // 2:
            self._last_flush_ns = now_ns
            self._guard(self._file.flush)
        if not self._aside and now_ns - self._last_sync_ns >= SYNC_NS * 3 // 4:
            self._last_sync_ns = now_ns
            self._guard(self._file.sync)

    def flush(self) -> None:
        """Close the chunk in progress now; a killed process keeps what is before it."""
        self._check_open()
        self._guard(self._file.flush)

    def sync(self) -> None:
        """Wait until the file is on the disk; any thread may, between creation and `close`.

        Raises:
            OSError: what was written since the last sync may not last; tell `fail`.
        """
        self._file.sync()

    def fail(self, error: OSError) -> NoReturn:
        """Stop for good because of what `sync` ran into.

        Raises:
            MachineError: always; see the class.
        """
        self._stop_for_good(error)

    def salvage(self, length: int | None = None) -> str:
        """Let go of the file after an error, where that was left `aside`; say what is kept.

        Args:
            length: keep no more than this, where the rest is not on the disk for certain.
        """
        return self._file.salvage(length)

    def discard(self) -> None:
        """Let go of the file after an error, and delete it: nothing is in it."""
        self._file.salvage()
        with suppress(OSError):
            self._disk.unlink(self._part)

    def add_facts(
        self,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment] = (),
    ) -> None:
        """Add metadata records and files that were not known at the beginning.

        Raises:
            MachineError: the disk refused; see the class.
        """
        self._check_open()
        self._guard(lambda: self._file.add_facts(metadata, attachments))

    def close(self) -> Path:
        """Finish, sync and rename the file; calling again does nothing.

        Returns:
            The final path.

        Raises:
            MachineError: the disk refused, now or before; the text names what is kept.
        """
        if self._file.renamed:
            return self._final
        self._check_open()
        self._aside = False  # whoever closes has the time for what is slow
        self._guard(self._file.flush)
        self._guard(self._file.finish)
        self._open = False
        return self._final

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close, whatever ended the block: what was recorded is worth keeping."""
        if self._open:
            self.close()

    def _begin(
        self,
        records: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment],
        lasting: bool,
    ) -> None:
        self._file.begin(records, attachments)
        if lasting:
            self._file.sync()

    def _create(self) -> PartFile:
        for path in (self._final, self._part):
            if self._disk.exists(path):
                raise UsageError(f"{path} exists", _NEVER_OVERWRITTEN)
        try:
            return PartFile(self._final, self._part, self._disk)
        except FileExistsError as error:
            raise UsageError(f"{self._part} exists", _NEVER_OVERWRITTEN) from error
        except OSError as error:
            raise MachineError(
                f"cannot create {self._part}: {error.strerror}",
                "make room, mend the folder's rights, or name another",
            ) from error

    def _check_open(self) -> None:
        if not self._open:
            raise MachineError(f"{self.path} is closed", "open another recording")

    def _guard(self, step: Callable[[], T]) -> T:
        """Run a step; on an error of the disk keep what is whole and stop for good."""
        try:
            return step()
        except OSError as error:
            self._stop_for_good(error)

    def _stop_for_good(self, error: OSError) -> NoReturn:
        safe = self._file.safe
        safe.lost = safe.waiting
        self._open = False
        kept = f"its first {safe.position} bytes are whole"
        if not self._aside:
            kept = self._file.salvage()
        raise MachineError(
            f"cannot write {self.path}: {error.strerror}; {kept}",
            "make room and begin another recording",
        ) from error


def unfinished(path: Path) -> Path:
    """The name that `path` has while it is being written."""
    return path.with_name(path.name + ".part")
