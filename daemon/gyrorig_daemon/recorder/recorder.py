"""The session's recording: a bounded queue in front of whoever writes.

In real time a thread of its own writes, and another does what takes the disk long, so
that a slow disk delays no answer; under simulated time nothing waits for the disk, and
the same calls write at once. What must be in the file but happens before it can be opened
(the unit and the boards have to say first who they are) is held until then.
"""

import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from gyrorig_daemon.live import NO_VIEW, View
from gyrorig_daemon.recorder.counts import RecorderCounts
from gyrorig_daemon.recorder.disk_worker import DiskWorker
from gyrorig_daemon.recorder.settings import (
    ONE_SHOT,
    SIMULATED,
    RecorderSettings,
    RecordingPlan,
)
from gyrorig_daemon.recorder.spool import REPORT, Spool
from gyrorig_protocol.errors import GyrorigError, MachineError
from gyrorig_protocol.recording.disk_file import DISK, Disk
from gyrorig_protocol.recording.messages import Message
from gyrorig_protocol.recording.writer import Attachment

QUEUE_LIMIT = 65_536  # five seconds of 16 boards at 800 Hz
HELD_LIMIT = 4_096
BATCH = 1_024  # messages written before the writer looks at what else is due
PAUSE_S = 0.02  # the writer sleeps this long on an empty queue: waking it for each costs more
CLOSE_PATIENCE_S = 60.0


class RecorderState(Enum):
    """What a recorder is doing."""

    IDLE = "idle"  # no file yet
    RECORDING = "recording"
    DEGRADED = "degraded"  # the disk does not take it: `Recorder.degraded` says why
    CLOSED = "closed"


class _Entry(NamedTuple):
    topic: str
    message: Message
    log_ns: int
    publish_ns: int
    skipped: int = 0  # messages of this topic before it that found the queue full


_Queued = _Entry | RecordingPlan | None  # a message, facts that came late, the end


class Recorder:
    """Takes messages from one thread, in the order of their log times on each topic.

    What finds the queue full is dropped, counted, and left out of its topic's message
    sequence, so that a reader sees where it is missing.
    """

    def __init__(
        self,
        threaded: bool,
        settings: RecorderSettings | None = None,
        make_room: Callable[[], object] | None = None,
        disk: Disk = DISK,
        view: View = NO_VIEW,
    ) -> None:
        """Begin without a file; `hold` and `put` before `open` as each says.

        Args:
            threaded: whether time is real; else nothing waits.
            settings: how the recording is cut, and what happens when the disk fails; left
                out, as for one shot.
            make_room: called in the disk's thread when less than the reserve is free.
            disk: where the files go.
            view: shown every message, whatever becomes of it on the disk.
        """
        self._view = None if view is NO_VIEW else view
        self._threaded = threaded
        self._settings = settings or (ONE_SHOT if threaded else SIMULATED)
        self._make_room = make_room
        self._disk = disk
        self._held: list[_Entry] = []
        self._queue: queue.SimpleQueue[_Queued] = queue.SimpleQueue()
        self._worker = DiskWorker(threaded)
        self._spool: Spool | None = None
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._fault: GyrorigError | None = None
        self._closed: Path | None = None
        self._muted = False
        self._skipped: Counter[str] = Counter()
        self.counts = RecorderCounts()
        self.progress_ns = time.monotonic_ns()  # of the writer's last turn

    @property
    def is_open(self) -> bool:
        """True from `open` on."""
        return self._spool is not None

    @property
    def path(self) -> Path | None:
        """Where the newest file is now, None before `open`."""
        return self._closed or (None if self._spool is None else self._spool.path)

    @property
    def paths(self) -> tuple[Path, ...]:
        """The final names of all parts so far, oldest first."""
        return () if self._spool is None else tuple(self._spool.paths)

    @property
    def state(self) -> RecorderState:
        """What it is doing."""
        if self._closed is not None:
            return RecorderState.CLOSED
        if self._spool is None:
            return RecorderState.IDLE
        return RecorderState.DEGRADED if self.degraded else RecorderState.RECORDING

    @property
    def degraded(self) -> str:
        """Why nothing reaches the disk, empty when all is well."""
        if self._fault is not None:
            return self._fault.what
        return "" if self._spool is None else self._spool.degraded

    @property
    def high_water(self) -> int:
        """The longest that the queue has been."""
        return self.counts.queue_high_water

    @property
    def dropped(self) -> int:
        """Messages that are in no file and will be in none."""
        return self.counts.lost

    @property
    def written(self) -> int:
        """Messages handed to a file."""
        return self.counts.written

    def open(self, plan: RecordingPlan) -> None:
        """Create the file and write what was held.

        Raises:
            UsageError: a file of that name exists.
            MachineError: the disk refuses, or has less free than the reserve.
        """
        spool = Spool(plan, self._settings, self.counts, self._worker, self._disk, self._make_room)
        spool.open()
        self._spool = spool
        for entry in self._held:
            self._write(spool, entry)
        self._held.clear()
        if self._threaded:
            self.progress_ns = time.monotonic_ns()
            self._thread = threading.Thread(target=self._run, args=(spool,), name="writer")
            self._thread.daemon = True
            self._thread.start()

    def hold(self, topic: str, message: Message, log_ns: int) -> None:
        """Record one message, whether or not there is a file yet."""
        if self._spool is not None:
            self.put(topic, message, log_ns)
            return
        if self._view is not None:
            self._view.take(topic, message, log_ns)
        if len(self._held) < HELD_LIMIT:
            self._held.append(_Entry(topic, message, log_ns, log_ns))
        else:
            self.counts.dropped_too_early += 1

    def put(self, topic: str, message: Message, log_ns: int, publish_ns: int | None = None) -> None:
        """Record one message; before there is a file it is forgotten.

        Args:
            topic: where it belongs.
            message: what to record.
            log_ns: capture time at which it was complete in the host's hands.
            publish_ns: best estimate of when it was taken, None for the same.

        Raises:
            MachineError: the disk refused this or an earlier message, and the recording
                is not to survive that.
        """
        if self._view is not None:
            self._view.take(topic, message, log_ns)
        spool = self._spool
        if spool is None or self._muted:
            return
        if self._fault is not None:
            raise self._fault
        skipped = self._skipped.get(topic, 0)  # a Counter's own way costs a call
        taken_ns = log_ns if publish_ns is None else publish_ns
        entry = _Entry(topic, message, log_ns, taken_ns, skipped)
        if not self._threaded:
            self._write(spool, entry)
            return
        waiting = self._queue.qsize()
        if waiting >= QUEUE_LIMIT:
            self._skipped[topic] += 1
            self.counts.dropped_queue_full += 1
            return
        self._queue.put(entry)
        if skipped:
            self._skipped[topic] = 0
        if waiting >= self.counts.queue_high_water:
            self.counts.queue_high_water = waiting + 1

    def add_facts(
        self,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment] = (),
    ) -> None:
        """Add metadata and files to the running session, and to every later part.

        Example: a board that came in mid-session, and its HELLO.

        Raises:
            MachineError: as `put`.
        """
        spool = self._spool
        if spool is None or self._muted:
            return
        self.check()
        facts = RecordingPlan(spool.path, metadata, attachments)
        if self._threaded:
            self._queue.put(facts)
        else:
            self._guarded(lambda: spool.add_facts(facts))

    def tick(self, now_ns: int) -> None:
        """Let the writer do what is due, where no thread does.

        Raises:
            MachineError: as `put`.
        """
        if self._muted:
            return
        self.check()
        spool = self._spool
        if spool is None or self._threaded:
            return
        self.progress_ns = time.monotonic_ns()
        self._guarded(lambda: spool.turn(now_ns))

    def check(self) -> None:
        """Raise what the writer's thread ran into.

        Raises:
            MachineError: the disk refused; what was written is kept.
        """
        if self._fault is not None:
            raise self._fault

    def mute(self) -> None:
        """Take no more messages: the disk has failed, and the unit must be halted yet."""
        self._muted = True

    def close(self, patience_s: float = CLOSE_PATIENCE_S) -> Path:
        """Write what is queued, finish the last file and return its name.

        Raises:
            MachineError: the disk refused; what was written is kept and readable.
        """
        spool = self._spool
        if spool is None:
            raise MachineError("there is no recording to close", "open one first")
        if self._closed is not None:
            return self._closed
        if self._thread is None:
            if self._fault is None:
                self._guarded(lambda: self._end(spool))
        else:
            self._queue.put(None)
            self._ending.set()
            self._thread.join(patience_s)
            if self._thread.is_alive():
                raise MachineError(
                    f"{spool.path} could not be written in {patience_s:.0f} s",
                    "look at the disk; the file is readable up to its last second",
                )
        if self._fault is not None:
            spool.abandon()
        self._worker.close(patience_s)
        self.check()
        if self._closed is None:
            raise AssertionError("closed without a fault, and not closed")
        return self._closed

    def _guarded(self, step: Callable[[], None]) -> None:
        try:
            step()
        except GyrorigError as fault:
            self._fault = fault
            raise

    def _write(self, spool: Spool, entry: _Entry) -> None:
        try:
            spool.take(entry.topic, entry.message, entry.log_ns, entry.publish_ns, entry.skipped)
        except GyrorigError as fault:
            self._fault = fault
            raise

    def _end(self, spool: Spool) -> None:
        self._closed = spool.close()

    def _run(self, spool: Spool) -> None:
        """Write until told to end; on a fault go on emptying the queue, so that no one waits."""
        try:
            while self._serve(spool):
                self.progress_ns = time.monotonic_ns()
        except Exception as fault:  # a fault of this program must not pass unseen
            self._fault = MachineError(
                f"the recording broke off by a fault of the program: {fault!r}", REPORT
            )
            while self._queue.get() is not None:
                self.progress_ns = time.monotonic_ns()

    def _serve(self, spool: Spool) -> bool:
        """Write a batch and do what is due; False at the end."""
        ends = idle = False
        for _ in range(BATCH):
            try:
                entry = self._queue.get_nowait()
            except queue.Empty:
                idle = not spool.waiting
                break
            if entry is None:
                ends = True
                break
            self._take(spool, entry)
        if self._fault is None:
            try:
                spool.turn(time.monotonic_ns())
                if ends:
                    self._end(spool)
            except GyrorigError as fault:
                self._fault = fault
        if idle:
            self._ending.wait(PAUSE_S)
        return not ends

    def _take(self, spool: Spool, entry: _Entry | RecordingPlan) -> None:
        if self._fault is not None:
            return
        try:
            if isinstance(entry, RecordingPlan):
                spool.add_facts(entry)
            else:
                self._write(spool, entry)
        except GyrorigError as fault:
            self._fault = fault
