"""The session's recording: a bounded queue in front of one writer.

In real time a thread of its own writes, so that a slow disk delays no answer; under
simulated time nothing waits for the disk, and the same calls write at once. What must
be in the file but happens before it can be opened (the unit and the boards have to say
first who they are) is held until then.
"""

import queue
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.errors import GyrorigError, MachineError
from gyrorig_protocol.recording.messages import Message
from gyrorig_protocol.recording.writer import Attachment, RecordingWriter

QUEUE_LIMIT = 65_536  # five seconds of 16 boards at 800 Hz
HELD_LIMIT = 4_096
TICK_S = 0.2
CLOSE_PATIENCE_S = 60.0


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """What a recording begins with."""

    path: Path
    metadata: Mapping[str, Mapping[str, str]]
    attachments: Sequence[Attachment]


@dataclass(frozen=True, slots=True)
class _Entry:
    topic: str
    message: Message
    log_ns: int
    publish_ns: int
    skipped: int = 0  # messages of this topic before it that found the queue full


class Recorder:
    """Takes messages from one thread, in the order of their log times on each topic.

    What finds the queue full is dropped, counted, and left out of its topic's message
    sequence, so that a reader sees where it is missing.
    """

    def __init__(self, threaded: bool) -> None:
        """Begin without a file; `hold` and `put` before `open` as each says."""
        self._threaded = threaded
        self._held: list[_Entry] = []
        self._queue: queue.Queue[_Entry | None] = queue.Queue(QUEUE_LIMIT)
        self._writer: RecordingWriter | None = None
        self._thread: threading.Thread | None = None
        self._fault: GyrorigError | None = None
        self._muted = False
        self._skipped: Counter[str] = Counter()
        self.high_water = 0
        self.dropped = 0
        self.written = 0

    @property
    def is_open(self) -> bool:
        """True between `open` and `close`."""
        return self._writer is not None

    @property
    def path(self) -> Path | None:
        """Where the file is now, None before `open`."""
        return None if self._writer is None else self._writer.path

    def open(self, plan: RecordingPlan) -> None:
        """Create the file and write what was held.

        Raises:
            UsageError: a file of that name exists.
            MachineError: the disk refuses.
        """
        self._writer = RecordingWriter(plan.path, plan.metadata, plan.attachments)
        for entry in self._held:
            self._write(self._writer, entry)
        self._held.clear()
        if self._threaded:
            self._thread = threading.Thread(target=self._run, name="writer", daemon=True)
            self._thread.start()

    def hold(self, topic: str, message: Message, log_ns: int) -> None:
        """Record one message, whether or not there is a file yet."""
        if self._writer is None:
            if len(self._held) < HELD_LIMIT:
                self._held.append(_Entry(topic, message, log_ns, log_ns))
        else:
            self.put(topic, message, log_ns)

    def put(self, topic: str, message: Message, log_ns: int, publish_ns: int | None = None) -> None:
        """Record one message; before there is a file it is forgotten.

        Args:
            topic: where it belongs.
            message: what to record.
            log_ns: capture time at which it was complete in the host's hands.
            publish_ns: best estimate of when it was taken, None for the same.

        Raises:
            MachineError: the disk refused this or an earlier message.
        """
        if self._writer is None or self._muted:
            return
        self.check()
        skipped = self._skipped[topic]
        taken_ns = log_ns if publish_ns is None else publish_ns
        entry = _Entry(topic, message, log_ns, taken_ns, skipped)
        if not self._threaded:
            self._write(self._writer, entry)
            return
        try:
            self._queue.put_nowait(entry)
            self._skipped[topic] = 0
        except queue.Full:
            self._skipped[topic] += 1
            self.dropped += 1
        self.high_water = max(self.high_water, self._queue.qsize())

    def tick(self, now_ns: int) -> None:
        """Let the writer flush what is due, where no thread does.

        Raises:
            MachineError: the disk refused.
        """
        if self._muted:
            return
        self.check()
        if self._writer is None or self._threaded:
            return
        try:
            self._writer.tick(now_ns)
        except GyrorigError as fault:
            self._fault = fault
            raise

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

    def close(self) -> Path:
        """Write what is queued, finish the file and return its name.

        Raises:
            MachineError: the disk refused; what was written is kept and readable.
        """
        if self._writer is None:
            raise MachineError("there is no recording to close", "open one first")
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(CLOSE_PATIENCE_S)
            if self._thread.is_alive():
                raise MachineError(
                    f"{self._writer.path} could not be written in {CLOSE_PATIENCE_S:.0f} s",
                    "look at the disk; the file is readable up to its last second",
                )
            self._thread = None
        self.check()
        return self._writer.close()

    def _write(self, writer: RecordingWriter, entry: _Entry) -> None:
        try:
            if entry.skipped:
                writer.skip(entry.topic, entry.skipped)
            writer.write(entry.topic, entry.message, entry.log_ns, entry.publish_ns)
        except GyrorigError as fault:
            self._fault = fault
            raise
        self.written += 1

    def _run(self) -> None:
        """Write until told to end; on a fault go on emptying the queue, so that no one waits."""
        writer = self._writer
        while writer is not None:
            entry: _Entry | None = None
            try:
                entry = self._queue.get(timeout=TICK_S)
                if entry is None:
                    return
            except queue.Empty:
                pass
            if self._fault is not None:
                continue
            try:
                if entry is not None:
                    self._write(writer, entry)
                writer.tick(time.monotonic_ns())
            except GyrorigError as fault:
                self._fault = fault
            except Exception as fault:  # a fault of this program must not pass unseen
                self._fault = MachineError(f"the recording broke off: {fault!r}", "report this")
