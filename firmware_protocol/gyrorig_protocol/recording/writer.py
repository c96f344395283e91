"""Writer of recordings of format 1; a crash costs one second of data, a power cut ten.

What to use when: one `RecordingWriter` per file, in one thread. `write` for single messages,
`write_imu_array` for importers with arrays, `tick` from the loop of the same thread, `close` at the
end.

Theory of operation: messages are collected into a chunk, which is safe only when it is completely
written. `tick` writes the chunk every second (the loss if the process is killed) and syncs every
ten seconds (the loss at a power cut). After an error of the disk the file is truncated to the last
complete chunk and never written again, because an incomplete record in the middle would hide all
later data from most readers.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self, TypeVar

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.encoding.imu_packing import pack_imu_payloads
from gyrorig_protocol.recording.mcap.disk_file import DISK, Disk
from gyrorig_protocol.recording.messages import ImuRaw, Message, imu_raw_topic
from gyrorig_protocol.recording.part_file import create_part_file, part_path
from gyrorig_protocol.recording.recording_metadata import (
    Attachment,
    complete_metadata,
    software_version,
)

__all__ = ["Attachment", "RecordingWriter", "part_path", "software_version"]

T = TypeVar("T")

IntArray = npt.NDArray[np.integer]

MAX_FLUSH_INTERVAL_NS = (
    1_000_000_000  # docs/recordings.md: a chunk is written at least once per second
)
MAX_SYNC_INTERVAL_NS = 10_000_000_000  # docs/recordings.md: synced at least every 10 s


class RecordingWriter:
    """A recording that is being written. Use it in one thread.

    Args:
        path: the final name, ending in `.mcap`; `.mcap.part` until it is closed.
        metadata: name -> record. `gyrorig` with `session`, `anchor_utc_ns` and
            `anchor_monotonic_raw_ns` is required; `format`, `software`, `part`,
            `previous` and `foxglove` are added if missing.
        attachments: files to write into the recording first.
        disk: the disk interface.
        owner_syncs: the owner does slow work: it calls `sync` every ten seconds or more often, and
            `truncate_and_close` after an error; other threads can call them.
        sync_at_start: wait until the beginning is on the disk; otherwise the first `sync` does.

    Raises:
        UsageError: the file or its `.part` file exists.
        MachineError: a disk error; the text names the file that is kept.
        ValueError: the metadata are invalid.
    """

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment] = (),
        *,
        disk: Disk = DISK,
        owner_syncs: bool = False,
        sync_at_start: bool = True,
    ) -> None:
        if path.suffix != ".mcap":
            raise ValueError(f"the name of a recording ends in .mcap, not {path.name}")
        records = complete_metadata(metadata)
        self._final = path
        self._part = part_path(path)
        self._disk = disk
        self._owner_syncs = owner_syncs
        self._last_flush_ns: int | None = None
        self._last_sync_ns: int | None = None
        self._is_open = False
        self._file = create_part_file(self._final, self._part, disk)
        self._is_open = True
        try:
            self._run_disk_step(lambda: self._file.begin(records, attachments, sync_at_start))
        except MachineError:
            with suppress(OSError):  # the caller still has all of its data
                if owner_syncs:
                    self._file.truncate_and_close()
                disk.unlink(self._part)
            raise

    @property
    def path(self) -> Path:
        """The present path: `.mcap.part` until `close` succeeded."""
        return self._final if self._file.is_renamed else self._part

    @property
    def closed(self) -> bool:
        """True after `close` and after a disk error."""
        return not self._is_open

    @property
    def lost_messages(self) -> int:
        """Number of messages that are not in the file because of a disk error."""
        return self._file.committed.lost_messages

    @property
    def has_failed_sync(self) -> bool:
        """Whether a sync failed, so that the data before it can be lost."""
        return self._file.sync_error is not None

    @property
    def waiting_messages(self) -> int:
        """Number of messages not yet in a complete chunk, which an error now would cost."""
        return self._file.committed.waiting_messages

    @property
    def bytes_written(self) -> int:
        """Length of the file so far, without the chunk in progress."""
        return self._file.committed.position

    def write(
        self,
        topic: str,
        message: Message,
        log_time_ns: int | None = None,
        publish_time_ns: int | None = None,
    ) -> None:
        """Append one message.

        Args:
            topic: begins with a slash; its channel is created at the first message.
            message: one of `messages` or `standard_messages`.
            log_time_ns: capture time at which the message was received completely; can be left
                out if the payload has it.
            publish_time_ns: best estimate of the time of the sample.

        Raises:
            ValueError: the log time decreases on its topic or differs from the payload's, or the
                topic has another type.
            MachineError: a disk error; see the class.
        """
        payload_time_ns = message.capture_time_ns
        time_ns = payload_time_ns if log_time_ns is None else log_time_ns
        if time_ns is None:
            raise ValueError(f"{message.TYPE} has no log time; give log_time_ns")
        is_own_type = message.TYPE.startswith("gyrorig_msgs/")
        if is_own_type and payload_time_ns is not None and payload_time_ns != time_ns:
            raise ValueError(f"{topic}: log time {time_ns} is not the payload's {payload_time_ns}")
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
        """Append one encoded message.

        Args:
            topic: as in `write`.
            type_name: the name of its schema.
            payload: header and fields.
            log_time_ns: as in `write`; times in the payload are not checked.
            publish_time_ns: as in `write`.
            sequence: the number of the message if the caller counts, else the next number.

        Raises:
            ValueError: as in `write`.
            MachineError: a disk error; see the class.
        """
        self._check_open()
        file = self._file
        channel = file.channels.get(topic)
        if channel is None:
            channel = self._run_disk_step(lambda: file.open_channel(topic, type_name))
        if channel.type_name != type_name:
            raise ValueError(f"{topic} holds {channel.type_name}, not {type_name}")
        if log_time_ns < channel.last_log_time_ns:
            previous_ns = channel.last_log_time_ns
            raise ValueError(f"{topic}: log time {log_time_ns} < {previous_ns} before it")
        if sequence is not None:
            channel.sequence = sequence
        try:
            file.append(channel, log_time_ns, publish_time_ns, payload)
        except OSError as error:
            self._stop_after_error(error)

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
        """Append many samples of one board, about ten times faster than one by one.

        Args:
            board_id: the board.
            host_time_ns: capture times, not decreasing, shape (n,).
            publish_time_ns: times of the samples, shape (n,); None: the host times.
            device_time: ticks as sent, shape (n,).
            sequence: sample counters as sent, shape (n,).
            status: `ImuStatus` bits, shape (n,).
            temperature: raw, shape (n,).
            gyro: counts, shape (n, 3).
            accel: counts, shape (n, 3); None: zero.
            mag: counts, shape (n, 3); None: zero.

        Raises:
            ValueError: shapes differ, a value does not fit, or the time decreases.
            MachineError: a disk error; see the class.
        """
        payloads = pack_imu_payloads(
            host_time_ns=host_time_ns,
            device_time=device_time,
            sequence=sequence,
            status=status,
            temperature=temperature,
            gyro=gyro,
            accel=accel,
            mag=mag,
        )
        log_times_ns = [int(value) for value in host_time_ns]
        publish_times_ns = (
            log_times_ns if publish_time_ns is None else [int(value) for value in publish_time_ns]
        )
        if len(publish_times_ns) != len(log_times_ns):
            raise ValueError(
                f"{len(publish_times_ns)} publish times for {len(log_times_ns)} samples"
            )
        if not log_times_ns:
            return
        self._check_open()
        file = self._file
        channel = self._run_disk_step(
            lambda: file.open_channel(imu_raw_topic(board_id), ImuRaw.TYPE)
        )
        if log_times_ns[0] < channel.last_log_time_ns or bool(np.any(np.diff(host_time_ns) < 0)):
            raise ValueError(f"{imu_raw_topic(board_id)}: log time decreases")

        def append_all() -> None:
            for time_ns, publish_ns, payload in zip(
                log_times_ns, publish_times_ns, payloads, strict=True
            ):
                file.append(channel, time_ns, publish_ns, payload)

        self._run_disk_step(append_all)

    def skip_sequence(self, topic: str, count: int = 1) -> None:
        """Leave a gap in the message numbers of a topic for `count` lost messages.

        Before the first message of a topic it has no effect.
        """
        channel = self._file.channels.get(topic)
        if channel is not None:
            channel.sequence = (channel.sequence + count) & 0xFFFFFFFF

    def tick(self, now_ns: int) -> None:
        """Write the chunk and sync the file if they are due.

        Args:
            now_ns: time of any monotonic clock; call several times per second.

        Raises:
            MachineError: a disk error; see the class.
        """
        self._check_open()
        if self._last_flush_ns is None or self._last_sync_ns is None:
            # The first chunk is due early, because until then the file has only its beginning.
            self._last_flush_ns, self._last_sync_ns = now_ns - MAX_FLUSH_INTERVAL_NS // 2, now_ns
            return
        # Due early, because the calls can be late on a loaded machine: with 0.75 s one kill of 200
        # cost 1.14 s (ten times as many processes as cores).
        if now_ns - self._last_flush_ns >= MAX_FLUSH_INTERVAL_NS // 2:
            self._last_flush_ns = now_ns
            self._run_disk_step(self._file.flush)
        if not self._owner_syncs and now_ns - self._last_sync_ns >= MAX_SYNC_INTERVAL_NS * 3 // 4:
            self._last_sync_ns = now_ns
            self._run_disk_step(self._file.sync)

    def flush(self) -> None:
        """Write the chunk in progress now; if the process is killed, data up to here remain."""
        self._check_open()
        self._run_disk_step(self._file.flush)

    def sync(self) -> None:
        """Wait until the file is on the disk; any thread can call it before `close`.

        Raises:
            OSError: data written since the last sync can be lost; call `fail_with`.
        """
        self._file.sync()

    def fail_with(self, error: OSError) -> NoReturn:
        """Stop writing permanently after an error of `sync`.

        Raises:
            MachineError: always; see the class.
        """
        self._stop_after_error(error)

    def truncate_and_close(self, length: int | None = None) -> str:
        """Close the file after an error if `owner_syncs` is set; describe the part that is kept.

        Args:
            length: keep at most this many bytes, if the rest may not be on the disk.
        """
        return self._file.truncate_and_close(length)

    def discard(self) -> None:
        """Close and delete the file after an error if it has no messages."""
        self._file.truncate_and_close()
        with suppress(OSError):
            self._disk.unlink(self._part)

    def add_metadata(
        self,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment] = (),
    ) -> None:
        """Add metadata records and attachments after the beginning.

        Raises:
            MachineError: a disk error; see the class.
        """
        self._check_open()
        self._run_disk_step(lambda: self._file.add_metadata(metadata, attachments))

    def close(self) -> Path:
        """Finish, sync and rename the file; calling again does nothing.

        Returns:
            The final path.

        Raises:
            MachineError: a disk error, now or before; the text describes the part that is kept.
        """
        if self._file.is_renamed:
            return self._final
        self._check_open()
        self._owner_syncs = False  # the caller of `close` can wait
        self._run_disk_step(self._file.flush)
        self._run_disk_step(self._file.finish)
        self._is_open = False
        return self._final

    def __enter__(self) -> Self:
        """Return this writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file at the end of the block, also after an error, to keep the data."""
        if self._is_open:
            self.close()

    def _check_open(self) -> None:
        if not self._is_open:
            raise MachineError(
                f"the recording {self.path} is closed, so nothing can be added to it",
                "start another recording",
            )

    def _run_disk_step(self, step: Callable[[], T]) -> T:
        """Run a step; after a disk error keep the complete data and stop permanently."""
        try:
            return step()
        except OSError as error:
            self._stop_after_error(error)

    def _stop_after_error(self, error: OSError) -> NoReturn:
        committed = self._file.committed
        committed.lost_messages = committed.waiting_messages
        self._is_open = False
        outcome = f"the first {committed.position} bytes of the file are complete"
        if not self._owner_syncs:
            outcome = self._file.truncate_and_close()
        raise MachineError(
            f"the recording {self.path} cannot be written ({error.strerror}); {outcome}",
            "free disk space and start another recording",
        ) from error
