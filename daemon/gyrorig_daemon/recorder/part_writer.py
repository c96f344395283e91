"""The part writer: a session's recording as a series of files, whatever the disk does.

What to use when: under `recorder`, in the thread that writes. `write_message` for each message,
`do_due_work` several times per second, `close` at the end.

Theory of operation. There is a file, or there is none because the disk failed:

    with a file    -- due by time or size --> the disk thread opens the next part; then this
                                              one is flushed and handed over to be closed:
                                              there is always one open
                   -- the disk is full --> without: what is in no complete chunk goes to
                                              memory, the file is cut back and left
                   -- another error --> the same with everything that is not synced: a disk
                                              that becomes read-only loses that
                   -- less free than the reserve --> without: the file is closed cleanly
    without a file -- every few seconds --> the disk thread tries to open the next part
                   -- it is open --> with: memory is written first, then new messages

Each message is numbered on its topic when it arrives. Therefore messages that memory had to
drop, or that never reached it, are a gap in the next file. Nothing here waits for the disk,
except a write into the system's buffers.
"""

from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path

from gyrorig_daemon.recorder.disk_worker import DiskWorker
from gyrorig_daemon.recorder.part_files import (
    NextPart,
    OpenedPart,
    PartCloser,
    PartOpener,
    SpaceCheck,
    part_path,
)
from gyrorig_daemon.recorder.part_schedule import PartSchedule
from gyrorig_daemon.recorder.ram_buffer import RamBuffer, Record
from gyrorig_daemon.recorder.recorder_counts import RecorderCounts
from gyrorig_daemon.recorder.recorder_settings import RecorderSettings, RecordingPlan
from gyrorig_daemon.recorder.sequence_numbers import SequenceNumbers
from gyrorig_daemon.recorder.state_replay import StateReplay
from gyrorig_daemon.recorder.sync_tracker import SyncTracker
from gyrorig_protocol.errors import GyrorigError, MachineError, UsageError
from gyrorig_protocol.recording.mcap.disk_file import Disk
from gyrorig_protocol.recording.messages import (
    SESSION_EVENT_TOPIC,
    EventKind,
    Message,
    SessionEvent,
)
from gyrorig_protocol.recording.writer import RecordingWriter

MAX_RECORDS_PER_TURN = 2_000  # taken from memory per turn: 20 ms of work
CLOSE_ATTEMPTS = 2
REPORT_BUG = (
    "report the error to the project with this line. The data that were written before are kept"
)


class PartWriter:
    """Writes the parts of one session. It must not be used by two threads at once."""

    def __init__(
        self,
        plan: RecordingPlan,
        settings: RecorderSettings,
        counts: RecorderCounts,
        worker: DiskWorker,
        disk: Disk,
        make_room: Callable[[], object] | None = None,
    ) -> None:
        self._plan, self._settings, self._counts = plan, settings, counts
        self._worker = worker
        self._opener = PartOpener(plan, settings, disk, make_room)
        self._replay = StateReplay()
        self._writer: RecordingWriter | None = None
        self._sync_tracker: SyncTracker  # of the open file, or of the last one
        self._ram_buffer = RamBuffer(settings.ram_bytes, settings.ram_s)
        self._sequence_numbers = SequenceNumbers()
        self._schedule = PartSchedule(settings)
        self._needs_replay = False
        self._next_part = NextPart(worker, self._opener)
        self._space_check = SpaceCheck(worker, self._opener)
        self._closer = PartCloser(counts)
        self._closed_bytes = 0
        self._part_number = 0
        self.paths: list[Path] = []  # final paths
        self.degraded_reason = ""  # why there is no file

    @property
    def path(self) -> Path:
        """Present path of the newest part."""
        return self.paths[-1] if self._writer is None else self._writer.path

    @property
    def waiting_messages(self) -> int:
        """Number of messages in memory that a file could take now."""
        return 0 if self._writer is None else len(self._ram_buffer)

    def open(self) -> None:
        """Create the first part, without waiting until it is synced.

        Raises:
            UsageError: a file of that name exists.
            MachineError: the disk fails, or has less free space than the reserve.
        """
        job = self._worker.submit(lambda: self._opener.open(0, "", self._settings.resume_bytes))
        self._switch_to_part(job.result())
        self._sync_tracker.sync()

    def write_message(
        self, topic: str, message: Message, log_ns: int, publish_ns: int, skipped: int = 0
    ) -> None:
        """Write one message, after `skipped` messages of its topic that were dropped.

        It was complete at the capture time `log_ns`, and measured at `publish_ns`.

        Raises:
            MachineError: the disk failed, and the settings do not tolerate that.
        """
        try:
            record = self._sequence_numbers.make_record(topic, message, log_ns, publish_ns, skipped)
        except ValueError as fault:
            self._reject_message(topic, fault)
            return
        if self._writer is None or len(self._ram_buffer):
            self._ram_buffer.append(record)
        else:
            self._write(self._writer, record)

    def do_due_work(self, now_ns: int) -> None:
        """Do what is due by any monotonic clock; never waits for the disk.

        Raises:
            MachineError: the disk failed, and the settings do not tolerate that.
        """
        self._schedule.set_time(now_ns)
        self._collect_jobs()
        writer = self._writer
        if writer is not None:
            self._run_step(writer, lambda: writer.tick(now_ns))
        if self._writer is None:
            self._retry_opening()
        else:
            self._start_due_jobs(self._writer)
        self._drain_memory(MAX_RECORDS_PER_TURN)
        self._update_counts()

    def add_metadata(self, plan: RecordingPlan) -> None:
        """Add metadata and attachments that were not known at the start of the session.

        Raises:
            MachineError: the disk failed, and the settings do not tolerate that.
        """
        self._opener.session_metadata.add(plan.metadata, plan.attachments)
        self._write_new_metadata()

    def close(self) -> Path:
        """Write the remaining messages, close the last part and return its path.

        Raises:
            MachineError: the disk failed; what was written is kept and readable.
        """
        if self._writer is not None:
            self._next_part.discard()
            self._sync_tracker.wait()
            self._collect_jobs()
        for _ in range(CLOSE_ATTEMPTS):
            writer = self._write_remaining()
            if writer is not None and self._hand_over_to_closer(writer):
                break
        else:
            self._counts.dropped_at_close += len(self._ram_buffer)
            raise MachineError(
                f"{self.degraded_reason}, and {len(self._ram_buffer)} messages in memory are lost",
                "check the disk. The data that were written before are kept in "
                f"{self.paths[-1].name}",
            )
        self._writer = None
        self._update_counts()
        return self._closer.finish() or self.paths[-1]

    def _write_remaining(self) -> RecordingWriter | None:
        """Wait for a file, and empty the memory into it; None without a file."""
        if self._writer is None:
            self._retry_opening(at_once=True)
        self._next_part.wait()
        self._collect_jobs()
        while self._writer is not None and len(self._ram_buffer):
            self._drain_memory(MAX_RECORDS_PER_TURN)
        return self._writer

    def abandon(self) -> None:
        """Abandon the file after an error that the settings do not tolerate."""
        if self._writer is not None:
            self._worker.submit(self._writer.truncate_and_close)

    def _write(self, writer: RecordingWriter, record: Record) -> None:
        if self._needs_replay:
            self._needs_replay = False
            if not self._write_replay(writer, record.log_ns):
                self._ram_buffer.push_front(deque([record]))
                return
        sync_tracker = self._sync_tracker
        sync_tracker.add(record)
        try:
            writer.write_encoded(*record)
        except ValueError as fault:
            sync_tracker.remove_last()
            self._reject_message(record.topic, fault)
        except MachineError as fault:
            self._counts.written += 1
            self._continue_in_memory(writer, fault)
        else:
            self._counts.written += 1
            self._replay.observe(record)

    def _reject_message(self, topic: str, fault: Exception) -> None:
        """Count a message that is not valid, or too late on its topic; continue the recording."""
        self._counts.refused += 1
        if not self._settings.survives_faults:
            raise MachineError(
                f"the recording ended because of an internal error on the topic {topic} ({fault})",
                REPORT_BUG,
            )

    def _run_step(self, writer: RecordingWriter, step: Callable[[], None]) -> bool:
        """Do a step of `writer`; False if it failed and the file was abandoned."""
        try:
            step()
        except MachineError as fault:
            self._continue_in_memory(writer, fault)
            return False
        return True

    def _continue_in_memory(self, writer: RecordingWriter, fault: MachineError) -> None:
        """Continue in memory, with what the file has not taken, or would lose with the disk."""
        self._counts.disk_faults += 1
        if not self._settings.survives_faults:
            raise fault
        unsaved, has_saved_records = self._sync_tracker.salvage_after_fault(fault)
        self._counts.written -= len(unsaved)  # they are counted when they are written again
        self._ram_buffer.push_front(unsaved)
        self._replay.invalidate_unit()
        self._closed_bytes += writer.bytes_written
        if not has_saved_records:
            self._discard_empty_part(writer)
        self._enter_degraded_state(fault.problem)

    def _discard_empty_part(self, writer: RecordingWriter) -> None:
        """Delete a file without messages, unless it is the only one of the session."""
        if len(self.paths) > 1:
            self.paths.pop()
            self._worker.submit(writer.discard)
        else:
            synced_bytes = self._sync_tracker.synced_bytes
            self._worker.submit(lambda: writer.truncate_and_close(synced_bytes))

    def _enter_degraded_state(self, reason: str) -> None:
        self._writer = None
        self.degraded_reason = reason
        self._schedule.postpone_opening()
        self._record_event(EventKind.FAULT, f"recording continues in memory, because {reason}")

    def _record_event(self, kind: EventKind, text: str) -> None:
        now_ns = self._sequence_numbers.latest_ns
        self.write_message(
            SESSION_EVENT_TOPIC, SessionEvent(now_ns, int(kind), "", text), now_ns, now_ns
        )

    def _write_replay(self, writer: RecordingWriter, at_ns: int) -> bool:
        """Repeat the open phases and unfinished moves at the start of a part."""
        records = self._replay.replay_records(at_ns, self._ram_buffer.dropped)
        steps = [partial(writer.write_encoded, *record) for record in records]
        return all(self._run_step(writer, step) for step in steps)

    def _write_new_metadata(self) -> None:
        writer = self._writer
        if writer is None:
            return
        metadata, attachments = self._opener.session_metadata.take_new()
        if metadata or attachments:
            self._run_step(writer, lambda: writer.add_metadata(metadata, attachments))

    def _drain_memory(self, limit: int) -> None:
        for _ in range(limit):
            if self._writer is None:
                return
            record = self._ram_buffer.pop()
            if record is None:
                return
            self._write(self._writer, record)

    def _collect_jobs(self) -> None:
        writer = self._writer
        if writer is not None and (error := self._sync_tracker.poll_sync()):
            self._run_step(writer, lambda: writer.fail_with(error))
        self._closer.count_finished()
        if self._writer is not None and self._sync_tracker.is_syncing:
            return  # if it fails, the next part takes what was not synced
        part = self._next_part.take(self.paths[-1].name)
        if isinstance(part, OpenedPart):
            self._switch_to_part(part)
        elif part is not None:
            self._handle_open_failure(part)
        free_bytes = self._space_check.take_answer()
        if free_bytes is not None:
            self._counts.free_bytes = free_bytes
            if free_bytes < self._settings.reserve_bytes:
                self._stop_for_space()

    def _handle_open_failure(self, error: BaseException) -> None:
        if isinstance(error, UsageError):  # a file of that name exists: take the next number
            self._part_number += 1
            return
        if not isinstance(error, GyrorigError):
            raise error
        self._schedule.postpone_opening()
        self._counts.open_failures += 1
        if self._writer is None:
            self.degraded_reason = error.problem
        else:
            self._counts.rotations_postponed += 1

    def _switch_to_part(self, part: OpenedPart) -> None:
        old = self._writer
        if old is not None:
            self._hand_over_to_closer(old)
            self._counts.rotations += 1
        is_resumed = old is None and bool(self.paths)
        self._writer, self._part_number = part.writer, part.number
        self._opener.session_metadata.set_written(part.metadata_version)
        self.paths.append(part_path(self._plan.path, part.number))
        self._schedule.start_part()
        self._sync_tracker = SyncTracker(part.writer, self._worker, self._counts)
        self._counts.parts_opened += 1
        self._needs_replay = part.number > 0
        self.degraded_reason = ""
        if is_resumed:
            self._counts.resumes += 1
            self._record_event(EventKind.NOTE, f"recording continues in {self.paths[-1].name}")
        self._write_new_metadata()

    def _hand_over_to_closer(self, old: RecordingWriter) -> bool:
        """Hand over a completely written file to be closed; False if that failed."""
        if self._sync_tracker.is_empty and len(self.paths) > 1:
            self._discard_empty_part(old)
            return True
        if not self._run_step(old, old.flush):
            return False  # what it did not take is in memory for the next file
        self._closed_bytes += old.bytes_written
        self._closer.add(self._sync_tracker.close_file())
        return True

    def _stop_for_space(self) -> None:
        """Close the file while there is space for its end."""
        writer = self._writer
        if writer is None:
            return
        self._counts.room_stops += 1
        free_mib = max(self._counts.free_bytes, 0) >> 20
        reason = f"the folder {self._plan.path.parent} has only {free_mib} MiB of free space"
        self._hand_over_to_closer(writer)
        if not self._settings.survives_faults:
            self._writer = None
            raise MachineError(
                f"the recording was ended, because {reason}",
                "free some disk space, and start another recording",
            )
        if self._writer is not None:  # otherwise the flush has failed, and reported it
            self._enter_degraded_state(reason)

    def _start_due_jobs(self, writer: RecordingWriter) -> None:
        schedule, reserve_bytes = self._schedule, self._settings.reserve_bytes
        if not self._sync_tracker.is_syncing and schedule.take_sync():
            self._sync_tracker.sync()
        if not self._space_check.is_running and schedule.take_space_check():
            self._space_check.start(reserve_bytes)
        can_open = not self._next_part.is_opening and schedule.may_open and not self._closer.is_full
        if can_open and schedule.is_part_due(writer.bytes_written, self._sync_tracker.is_empty):
            self._begin_part(reserve_bytes)
        if not self._worker.threaded:
            self._collect_jobs()

    def _retry_opening(self, at_once: bool = False) -> None:
        if not self._next_part.is_opening and (at_once or self._schedule.may_open):
            self._begin_part(self._settings.resume_bytes)
            if not self._worker.threaded:
                self._collect_jobs()

    def _begin_part(self, room_bytes: int) -> None:
        self._next_part.open(self._part_number + 1, self.paths[-1].name, room_bytes)

    def _update_counts(self) -> None:
        counts, ram_buffer = self._counts, self._ram_buffer
        counts.update_memory(len(ram_buffer), ram_buffer.bytes, ram_buffer.dropped)
        counts.update_disk(self._worker.busy_ns())
        open_bytes = 0 if self._writer is None else self._writer.bytes_written
        counts.bytes_written = self._closed_bytes + open_bytes
