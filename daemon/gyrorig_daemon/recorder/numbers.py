"""Each message gets its number on its topic when it comes, whatever becomes of it then.

What to use when: under `spool`. What never reaches a file is a gap in the numbers of the
file that follows.
"""

import struct

from gyrorig_daemon.recorder.ring import Record
from gyrorig_protocol.recording.messages import Message


class Numbers:
    """Numbers and encodes the messages of one session."""

    def __init__(self) -> None:
        self._next: dict[str, int] = {}
        self.latest_ns = 0  # the largest log time so far

    def record(
        self, topic: str, message: Message, log_ns: int, publish_ns: int, skipped: int
    ) -> Record:
        """Return a message as it goes on to a file.

        Args:
            topic: where it belongs.
            message: what to record.
            log_ns: capture time at which it was complete.
            publish_ns: when it was taken.
            skipped: messages of the topic before it that never came here.

        Raises:
            ValueError: it cannot be encoded; its number is used up.
        """
        number = self._next.get(topic)
        # Before the first message of a topic there is nothing that a gap could follow.
        number = 0 if number is None else number + skipped
        self._next[topic] = number + 1
        self.latest_ns = max(self.latest_ns, log_ns)
        try:
            payload = message.encode()
        except (OverflowError, struct.error) as fault:
            raise ValueError(f"a message at {log_ns} ns cannot be encoded: {fault}") from fault
        return Record(topic, message.TYPE, payload, log_ns, publish_ns, number & 0xFFFF_FFFF)
