"""The recorder of a session: a bounded queue in front of the writer.

In real time one thread writes and another does slow disk operations, so that a slow disk delays
no reply. In simulated time nothing waits for the disk, and the same calls write at once. Some
messages must be in the file but come before it can be opened, because the unit and the boards
must identify themselves first. They are held until then.
"""

import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from gyrorig_daemon.live import NO_VIEW, LiveView
from gyrorig_daemon.recorder.disk_worker import DiskWorker
from gyrorig_daemon.recorder.part_writer import REPORT_BUG, PartWriter
from gyrorig_daemon.recorder.recorder_counts import RecorderCounts
from gyrorig_daemon.recorder.recorder_settings import (
    ONE_SHOT,
    SIMULATED,
    RecorderSettings,
    RecordingPlan,
)
from gyrorig_protocol.errors import GyrorigError, MachineError
from gyrorig_protocol.recording.mcap.disk_file import DISK, Disk
from gyrorig_protocol.recording.messages import Message
from gyrorig_protocol.recording.writer import Attachment

MAX_QUEUED_MESSAGES = 65_536  # five seconds of 16 boards at 800 Hz
MAX_EARLY_MESSAGES = 4_096
BATCH_MESSAGES = 1_024  # messages written before the writer checks what else is due
IDLE_SLEEP_S = 0.02  # sleep of the writer when the queue is empty; waking it per message costs more
CLOSE_TIMEOUT_S = 60.0


class RecorderState(Enum):
    """State of a recorder."""

    IDLE = "idle"  # no file yet
    RECORDING = "recording"
    DEGRADED = "degraded"  # the disk fails: `Recorder.degraded_reason`
    CLOSED = "closed"


class _QueuedMessage(NamedTuple):
    topic: str
    message: Message
    log_ns: int
    publish_ns: int
    skipped: int = 0  # earlier messages of this topic that found the queue full


_QueueItem = _QueuedMessage | RecordingPlan | None  # a message, late metadata, the end


class Recorder:
    """Takes messages from one thread, in the order of their log times on each topic.

    Messages that find the queue full are dropped and counted. They leave a gap in the sequence
    numbers of their topic, so that a reader sees where messages are missing.
    """

    def __init__(
        self,
        threaded: bool,
        settings: RecorderSettings | None = None,
        make_room: Callable[[], object] | None = None,
        disk: Disk = DISK,
        view: LiveView = NO_VIEW,
    ) -> None:
        """Start without a file.

        Args:
            threaded: whether time is real; otherwise nothing waits.
            settings: how the recording is split, and what happens when the disk fails; None for
                `ONE_SHOT`, or `SIMULATED` without threads.
            make_room: called in the disk thread when less than the reserve is free.
            disk: where the files are written.
            view: is shown every message, whether it is written or not.
        """
        self._view = None if view is NO_VIEW else view
        self._threaded = threaded
        self._settings = settings or (ONE_SHOT if threaded else SIMULATED)
        self._make_room = make_room
        self._disk = disk
        self._early_entries: list[_QueuedMessage] = []
        self._queue: queue.SimpleQueue[_QueueItem] = queue.SimpleQueue()
        self._worker = DiskWorker(threaded)
        self._part_writer: PartWriter | None = None
        self._thread: threading.Thread | None = None
        self._close_requested = threading.Event()
        self._fault: GyrorigError | None = None
        self._closed_path: Path | None = None
        self._is_muted = False
        self._skipped: Counter[str] = Counter()
        self.counts = RecorderCounts()
        self.progress_ns = time.monotonic_ns()  # of the writer's last turn

    @property
    def is_open(self) -> bool:
        """True from `open` on."""
        return self._part_writer is not None

    @property
    def path(self) -> Path | None:
        """Present path of the newest file, None before `open`."""
        return self._closed_path or (None if self._part_writer is None else self._part_writer.path)

    @property
    def paths(self) -> tuple[Path, ...]:
        """Final paths of all parts so far, oldest first."""
        return () if self._part_writer is None else tuple(self._part_writer.paths)

    @property
    def state(self) -> RecorderState:
        """State of the recorder."""
        if self._closed_path is not None:
            return RecorderState.CLOSED
        if self._part_writer is None:
            return RecorderState.IDLE
        return RecorderState.DEGRADED if self.degraded_reason else RecorderState.RECORDING

    @property
    def degraded_reason(self) -> str:
        """Why nothing reaches the disk, empty if all is well."""
        if self._fault is not None:
            return self._fault.problem
        return "" if self._part_writer is None else self._part_writer.degraded_reason

    def open(self, plan: RecordingPlan) -> None:
        """Create the file and write the held messages.

        Raises:
            UsageError: a file of that name exists.
            MachineError: the disk fails, or has less free space than the reserve.
        """
        part_writer = PartWriter(
            plan, self._settings, self.counts, self._worker, self._disk, self._make_room
        )
        part_writer.open()
        self._part_writer = part_writer
        for entry in self._early_entries:
            self._write(part_writer, entry)
        self._early_entries.clear()
        if self._threaded:
            self.progress_ns = time.monotonic_ns()
            self._thread = threading.Thread(target=self._run, args=(part_writer,), name="writer")
            self._thread.daemon = True
            self._thread.start()

    def put_or_hold(self, topic: str, message: Message, log_ns: int) -> None:
        """Record one message; before `open` it is held."""
        if self._part_writer is not None:
            self.put(topic, message, log_ns)
            return
        if self._view is not None:
            self._view.show_message(topic, message, log_ns)
        if len(self._early_entries) < MAX_EARLY_MESSAGES:
            self._early_entries.append(_QueuedMessage(topic, message, log_ns, log_ns))
        else:
            self.counts.dropped_too_early += 1

    def put(self, topic: str, message: Message, log_ns: int, publish_ns: int | None = None) -> None:
        """Record one message; before `open` it is discarded.

        Args:
            topic: topic of the message.
            message: what to record.
            log_ns: capture time when it was complete in the host.
            publish_ns: best estimate of when it was measured, None for the same.

        Raises:
            MachineError: the disk failed for this or an earlier message, and the settings do not
                tolerate that.
        """
        if self._view is not None:
            self._view.show_message(topic, message, log_ns)
        part_writer = self._part_writer
        if part_writer is None or self._is_muted:
            return
        if self._fault is not None:
            raise self._fault
        skipped = self._skipped.get(topic, 0)  # faster than indexing the Counter
        taken_ns = log_ns if publish_ns is None else publish_ns
        entry = _QueuedMessage(topic, message, log_ns, taken_ns, skipped)
        if not self._threaded:
            self._write(part_writer, entry)
            return
        waiting = self._queue.qsize()
        if waiting >= MAX_QUEUED_MESSAGES:
            self._skipped[topic] += 1
            self.counts.dropped_queue_full += 1
            return
        self._queue.put(entry)
        if skipped:
            self._skipped[topic] = 0
        if waiting >= self.counts.queue_high_water:
            self.counts.queue_high_water = waiting + 1

    def add_metadata(
        self,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment] = (),
    ) -> None:
        """Add metadata and attachments to the running session, and to every later part.

        Example: a board that was connected during the session, and its HELLO.

        Raises:
            MachineError: as `put`.
        """
        part_writer = self._part_writer
        if part_writer is None or self._is_muted:
            return
        self.raise_fault()
        additions = RecordingPlan(part_writer.path, metadata, attachments)
        if self._threaded:
            self._queue.put(additions)
        else:
            self._run_step(lambda: part_writer.add_metadata(additions))

    def tick(self, now_ns: int) -> None:
        """Let the writer do what is due, without a thread.

        Raises:
            MachineError: as `put`.
        """
        if self._is_muted:
            return
        self.raise_fault()
        part_writer = self._part_writer
        if part_writer is None or self._threaded:
            return
        self.progress_ns = time.monotonic_ns()
        self._run_step(lambda: part_writer.do_due_work(now_ns))

    def raise_fault(self) -> None:
        """Raise the error of the writer's thread.

        Raises:
            MachineError: the disk failed; what was written is kept.
        """
        if self._fault is not None:
            raise self._fault

    def mute(self) -> None:
        """Take no more messages: the disk has failed, and the unit is not halted yet."""
        self._is_muted = True

    def close(self, timeout_s: float = CLOSE_TIMEOUT_S) -> Path:
        """Write what is queued, finish the last file and return its path.

        Raises:
            MachineError: the disk failed; what was written is kept and readable.
        """
        part_writer = self._part_writer
        if part_writer is None:
            raise MachineError(
                "there is no recording to close", "open a recording before you close it"
            )
        if self._closed_path is not None:
            return self._closed_path
        if self._thread is None:
            if self._fault is None:
                self._run_step(lambda: self._close_writer(part_writer))
        else:
            self._queue.put(None)
            self._close_requested.set()
            self._thread.join(timeout_s)
            if self._thread.is_alive():
                raise MachineError(
                    f"the recorder could not write {part_writer.path} to the disk within "
                    f"{timeout_s:.0f} s",
                    "check the disk. The file is readable, except for its last second",
                )
        if self._fault is not None:
            part_writer.abandon()
        self._worker.close(timeout_s)
        self.raise_fault()
        if self._closed_path is None:
            raise AssertionError("closed without a fault, and not closed")
        return self._closed_path

    def _run_step(self, step: Callable[[], None]) -> None:
        try:
            step()
        except GyrorigError as fault:
            self._fault = fault
            raise

    def _write(self, part_writer: PartWriter, entry: _QueuedMessage) -> None:
        try:
            part_writer.write_message(
                entry.topic, entry.message, entry.log_ns, entry.publish_ns, entry.skipped
            )
        except GyrorigError as fault:
            self._fault = fault
            raise

    def _close_writer(self, part_writer: PartWriter) -> None:
        self._closed_path = part_writer.close()

    def _run(self, part_writer: PartWriter) -> None:
        """Write until closed; after a fault keep emptying the queue, so that nobody waits."""
        try:
            while self._write_batch(part_writer):
                self.progress_ns = time.monotonic_ns()
        except Exception as fault:  # a bug of this program must not go unnoticed
            self._fault = MachineError(
                f"the recording ended because of the internal error {fault!r}", REPORT_BUG
            )
            while self._queue.get() is not None:
                self.progress_ns = time.monotonic_ns()

    def _write_batch(self, part_writer: PartWriter) -> bool:
        """Write a batch and do what is due; False at the end."""
        is_end = is_idle = False
        for _ in range(BATCH_MESSAGES):
            try:
                entry = self._queue.get_nowait()
            except queue.Empty:
                is_idle = not part_writer.waiting_messages
                break
            if entry is None:
                is_end = True
                break
            self._handle_item(part_writer, entry)
        if self._fault is None:
            try:
                part_writer.do_due_work(time.monotonic_ns())
                if is_end:
                    self._close_writer(part_writer)
            except GyrorigError as fault:
                self._fault = fault
        if is_idle:
            self._close_requested.wait(IDLE_SLEEP_S)
        return not is_end

    def _handle_item(self, part_writer: PartWriter, entry: _QueuedMessage | RecordingPlan) -> None:
        if self._fault is not None:
            return
        try:
            if isinstance(entry, RecordingPlan):
                part_writer.add_metadata(entry)
            else:
                self._write(part_writer, entry)
        except GyrorigError as fault:
            self._fault = fault
