"""A session's recording as a row of files, whatever the disk does meanwhile.

What to use when: under `recorder`, in the thread that writes. `take` for each message,
`turn` several times a second, `close` at the end.

Theory of operation. There is a file, or there is none because the disk did not take it:

    with a file    -- due by time or size --> the disk's thread opens the next part;
                                              then this one is flushed and handed over
                                              to be closed: there is always one open
                   -- the disk is full --> without: what is in no whole chunk goes to
                                              memory, the file is cut back and left
                   -- another error --> the same with all that is not synced: a disk that
                                              turns read-only loses that
                   -- less free than the reserve --> without: the file is closed cleanly
    without a file -- every few seconds --> the disk's thread tries to open the next part
                   -- it is open --> with: memory is written first, then what comes

Each message is numbered when it comes, on its topic; so what memory has to forget, or
what never reached it, shows as a gap in the file that follows. Nothing here waits for the
disk, except a write into the system's own buffers.
"""

from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path

from gyrorig_daemon.recorder.counts import RecorderCounts
from gyrorig_daemon.recorder.disk_worker import DiskWorker, Job
from gyrorig_daemon.recorder.durability import Durability
from gyrorig_daemon.recorder.numbers import Numbers
from gyrorig_daemon.recorder.parts import (
    Closing,
    OpenedPart,
    PartOpener,
    part_path,
)
from gyrorig_daemon.recorder.restating import Restating
from gyrorig_daemon.recorder.ring import RamRing, Record
from gyrorig_daemon.recorder.settings import RecorderSettings, RecordingPlan
from gyrorig_protocol.errors import GyrorigError, MachineError, UsageError
from gyrorig_protocol.recording.disk_file import Disk
from gyrorig_protocol.recording.messages import (
    SESSION_EVENT_TOPIC,
    EventKind,
    Message,
    SessionEvent,
)
from gyrorig_protocol.recording.writer import RecordingWriter

RETRY_NS = 5_000_000_000  # between attempts to open a part where the last one failed
ROOM_NS = 1_000_000_000  # between looks at the free space
TURN_RECORDS = 2_000  # taken out of memory in one turn: 20 ms of work
CLOSE_ATTEMPTS = 2
REPORT = "report it with this line; what was written before is kept"
_MS_NS = 1_000_000


class Spool:
    """The parts of one session. Not to be used by two threads at once."""

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
        self._restating = Restating()
        self._writer: RecordingWriter | None = None
        self._durable: Durability  # of the writer's file, or of the last one
        self._written_facts = 0
        self._ring = RamRing(settings.ring_bytes, settings.ring_s)
        self._numbers = Numbers()
        self._now_ns = self._begun_ns = self._synced_ns = self._looked_ns = 0
        self._retry_ns = 0
        self._restate = False
        self._opening: Job[OpenedPart] | None = None
        self._looking: Job[int] | None = None
        self._closing = Closing(worker, counts)
        self._closed_bytes = 0
        self._number = 0
        self.paths: list[Path] = []  # final names
        self.degraded = ""  # why there is no file

    @property
    def path(self) -> Path:
        """Where the newest part is now."""
        return self.paths[-1] if self._writer is None else self._writer.path

    @property
    def waiting(self) -> int:
        """Messages in memory that a file could take now."""
        return 0 if self._writer is None else len(self._ring)

    def open(self) -> None:
        """Create the first part; that it lasts is not waited for.

        Raises:
            UsageError: a file of that name exists.
            MachineError: the disk refuses, or has less free than the reserve.
        """
        job = self._worker.submit(lambda: self._opener.open(0, "", self._settings.resume_bytes))
        job.wait()
        self._adopt(job.result())
        self._durable.sync()

    def take(
        self, topic: str, message: Message, log_ns: int, publish_ns: int, skipped: int = 0
    ) -> None:
        """Take in one message.

        Args:
            topic: where it belongs.
            message: what to record.
            log_ns: capture time at which it was complete.
            publish_ns: when it was taken.
            skipped: messages of the topic before it that never came here.

        Raises:
            MachineError: the disk refused, and the recording is not to survive that.
        """
        try:
            record = self._numbers.record(topic, message, log_ns, publish_ns, skipped)
        except ValueError as fault:
            self._refuse(topic, fault)
            return
        if self._writer is None or len(self._ring):
            self._ring.append(record)
        else:
            self._write(self._writer, record)

    def turn(self, now_ns: int) -> None:
        """Do what is due; never waits for the disk.

        Args:
            now_ns: any clock that does not go back.

        Raises:
            MachineError: the disk refused, and the recording is not to survive that.
        """
        if not self._now_ns:
            self._begun_ns = self._synced_ns = now_ns
        self._now_ns = now_ns
        self._look_at_jobs()
        writer = self._writer
        if writer is not None:
            self._guarded(writer, lambda: writer.tick(now_ns))
        if self._writer is None:
            self._try_again()
        else:
            self._start_what_is_due(self._writer)
        self._empty_memory(TURN_RECORDS)
        self._count()

    def add_facts(self, plan: RecordingPlan) -> None:
        """Take in metadata and files of the session that were not known at its beginning.

        Raises:
            MachineError: the disk refused, and the recording is not to survive that.
        """
        self._opener.facts.add(plan.metadata, plan.attachments)
        self._write_new_facts()

    def close(self) -> Path:
        """Write what is left, close the last part and return its name.

        Raises:
            MachineError: the disk refused; what was written is kept and readable.
        """
        self._drop_next()
        for _ in range(CLOSE_ATTEMPTS):
            writer = self._write_the_rest()
            if writer is not None and self._hand_over(writer):
                break
        else:
            self._counts.dropped_at_close += len(self._ring)
            raise MachineError(
                f"{self.degraded}; {len(self._ring)} messages in memory are lost",
                f"what was written before is kept: {self.paths[-1].name}",
            )
        self._writer = None
        self._count()
        return self._closing.finish() or self.paths[-1]

    def _drop_next(self) -> None:
        """Let go of a part that is being opened to follow this one: nothing will be in it."""
        opening = self._opening
        if opening is not None and self._writer is not None:
            opening.wait()
            self._opening = None
            if opening.error is None:
                self._worker.submit(opening.result().writer.discard)

    def _write_the_rest(self) -> RecordingWriter | None:
        """Wait for a file, and empty the memory into it; None where there is none."""
        if self._writer is None:
            self._try_again(at_once=True)
        if self._opening is not None:
            self._opening.wait()
        self._look_at_jobs()
        while self._writer is not None and len(self._ring):
            self._empty_memory(TURN_RECORDS)
        return self._writer

    def abandon(self) -> None:
        """Let go of the file after an error that the recording does not survive."""
        if self._writer is not None:
            self._worker.submit(self._writer.salvage)

    def _write(self, writer: RecordingWriter, record: Record) -> None:
        if self._restate:
            self._restate = False
            if not self._restate_state(writer, record.log_ns):
                self._ring.give_back(deque([record]))
                return
        durable = self._durable
        durable.add(record)
        try:
            writer.write_encoded(*record)
        except ValueError as fault:
            durable.withdraw()
            self._refuse(record.topic, fault)
        except MachineError as fault:
            self._counts.written += 1
            self._break_off(writer, fault)
        else:
            self._counts.written += 1
            self._restating.follow(record)

    def _refuse(self, topic: str, fault: Exception) -> None:
        """One message that is none, or comes too late on its topic, must not end a recording."""
        self._counts.refused += 1
        if not self._settings.survive:
            raise MachineError(
                f"{topic}: the recording broke off by a fault of the program: {fault}", REPORT
            )

    def _guarded(self, writer: RecordingWriter, step: Callable[[], None]) -> bool:
        """Do a step of `writer`; False where that was its last."""
        try:
            step()
        except MachineError as fault:
            self._break_off(writer, fault)
            return False
        return True

    def _break_off(self, writer: RecordingWriter, fault: MachineError) -> None:
        """Go on in memory, with what the file has not taken, or would lose with the disk."""
        self._counts.disk_faults += 1
        if not self._settings.survive:
            raise fault
        again, something_is_left = self._durable.give_up(fault)
        self._counts.written -= len(again)  # they will be counted when they are again
        self._ring.give_back(again)
        self._restating.break_off()
        self._closed_bytes += writer.bytes_written
        if not something_is_left:
            self._let_go_of_empty(writer)
        self._lose_file(fault.what)

    def _let_go_of_empty(self, writer: RecordingWriter) -> None:
        """Delete a file without a message, if it is not the only one of the session."""
        if len(self.paths) > 1:
            self.paths.pop()
            self._worker.submit(writer.discard)
        else:
            beginning = self._durable.synced_bytes
            self._worker.submit(lambda: writer.salvage(beginning))

    def _lose_file(self, why: str) -> None:
        self._writer = None
        self.degraded = why
        self._retry_ns = self._now_ns + RETRY_NS
        self._tell(EventKind.FAULT, f"recording goes on in memory: {why}")

    def _tell(self, kind: EventKind, text: str) -> None:
        now_ns = self._numbers.latest_ns
        self.take(SESSION_EVENT_TOPIC, SessionEvent(now_ns, int(kind), "", text), now_ns, now_ns)

    def _restate_state(self, writer: RecordingWriter, at_ns: int) -> bool:
        """Say in a new part which phases and moves it begins in the middle of."""
        again = self._restating.records(at_ns, self._ring.dropped)
        steps = [partial(writer.write_encoded, *one) for one in again]
        return all(self._guarded(writer, step) for step in steps)

    def _write_new_facts(self) -> None:
        writer = self._writer
        if writer is None:
            return
        metadata, attachments = self._opener.facts.since(self._written_facts)
        if metadata or attachments:
            self._guarded(writer, lambda: writer.add_facts(metadata, attachments))
        self._written_facts = self._opener.facts.version

    def _empty_memory(self, limit: int) -> None:
        for _ in range(limit):
            if self._writer is None:
                return
            record = self._ring.pop()
            if record is None:
                return
            self._write(self._writer, record)

    # What became of it

    def _look_at_jobs(self) -> None:
        opening = self._opening
        if opening is not None and opening.done:
            self._opening = None
            if opening.error is None:
                self._adopt(opening.result())
            else:
                self._could_not_open(opening.error)
        writer = self._writer
        if writer is not None and (error := self._durable.look()):
            self._guarded(writer, lambda: writer.fail(error))
        looking = self._looking
        if looking is not None and looking.done:
            self._looking = None
            if looking.error is None:
                self._counts.free_bytes = looking.result()
                if looking.result() < self._settings.reserve_bytes:
                    self._stop_for_room()
        self._closing.look()

    def _could_not_open(self, error: Exception) -> None:
        if isinstance(error, UsageError):  # a file of that name: take the next number
            self._number += 1
            return
        if not isinstance(error, GyrorigError):
            raise error
        self._retry_ns = self._now_ns + RETRY_NS
        self._counts.open_failures += 1
        if self._writer is None:
            self.degraded = error.what
        else:
            self._counts.rotations_postponed += 1

    def _adopt(self, part: OpenedPart) -> None:
        old = self._writer
        if old is not None:
            self._hand_over(old)
            self._counts.rotations += 1
        resumed = old is None and bool(self.paths)
        self._writer, self._number, self._written_facts = part.writer, part.number, part.facts
        self.paths.append(part_path(self._plan.path, part.number))
        self._begun_ns = self._synced_ns = self._now_ns
        self._durable = Durability(part.writer, self._worker, self._counts)
        self._counts.parts_opened += 1
        self._restate = part.number > 0
        self.degraded = ""
        if resumed:
            self._counts.resumes += 1
            self._tell(EventKind.NOTE, f"recording goes on in {self.paths[-1].name}")
        self._write_new_facts()

    def _hand_over(self, old: RecordingWriter) -> bool:
        """Have a file closed in which nothing is left to be written; False if it failed."""
        if self._durable.is_empty and len(self.paths) > 1:
            self._let_go_of_empty(old)
            return True
        if not self._guarded(old, old.flush):
            return False  # what it did not take is in memory, and goes to the next file
        self._closed_bytes += old.bytes_written
        self._closing.add(old)
        return True

    def _stop_for_room(self) -> None:
        """Close the file while there is room for its end."""
        writer = self._writer
        if writer is None:
            return
        self._counts.room_stops += 1
        free_mib = max(self._counts.free_bytes, 0) >> 20
        why = f"only {free_mib} MiB are free in {self._plan.path.parent}"
        self._hand_over(writer)
        if not self._settings.survive:
            self._writer = None
            raise MachineError(why, "make room and begin another recording")
        if self._writer is not None:  # else the flush has failed, and said so
            self._lose_file(why)

    # What is due

    def _start_what_is_due(self, writer: RecordingWriter) -> None:
        settings, now_ns = self._settings, self._now_ns
        if not self._durable.is_syncing and self._is_over(self._synced_ns, settings.sync_s):
            self._synced_ns = now_ns
            self._durable.sync()
        if settings.reserve_bytes and self._looking is None and now_ns - self._looked_ns >= ROOM_NS:
            self._looked_ns = now_ns
            wanted = settings.reserve_bytes
            self._looking = self._worker.submit(lambda: self._opener.free_bytes(wanted))
        due = settings.part_s is not None and self._is_over(self._begun_ns, settings.part_s)
        if settings.part_bytes is not None:
            due = due or writer.bytes_written >= settings.part_bytes
        if due and self._opening is None and now_ns >= self._retry_ns and not self._closing.is_full:
            self._begin_part(settings.reserve_bytes)
        if not self._worker.threaded:
            self._look_at_jobs()

    def _try_again(self, at_once: bool = False) -> None:
        if self._opening is None and (at_once or self._now_ns >= self._retry_ns):
            self._begin_part(self._settings.resume_bytes)
            if not self._worker.threaded:
                self._look_at_jobs()

    def _begin_part(self, room_bytes: int) -> None:
        number, previous = self._number + 1, self.paths[-1].name
        self._opening = self._worker.submit(lambda: self._opener.open(number, previous, room_bytes))

    def _is_over(self, since_ns: int, limit_s: float) -> bool:
        return self._now_ns - since_ns >= limit_s * 1e9

    def _count(self) -> None:
        counts, ring = self._counts, self._ring
        counts.memory_messages = len(ring)
        counts.memory_bytes = ring.bytes
        counts.memory_high_water_bytes = max(counts.memory_high_water_bytes, ring.bytes)
        counts.dropped_from_memory = ring.dropped
        counts.disk_busy_ms = self._worker.busy_ns() // _MS_NS
        counts.disk_busy_max_ms = max(counts.disk_busy_max_ms, counts.disk_busy_ms)
        now_bytes = 0 if self._writer is None else self._writer.bytes_written
        counts.bytes_written = self._closed_bytes + now_bytes
