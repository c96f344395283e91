"""Sequence numbers: each message gets one on its topic when it arrives.

What to use when: under `part_writer`. Messages that never reach a file are a gap in the
numbers of the next file.
"""

import struct

from gyrorig_daemon.recorder.ram_buffer import Record
from gyrorig_protocol.recording.messages import Message


class SequenceNumbers:
    """Numbers and encodes the messages of one session."""

    def __init__(self) -> None:
        self._next_by_topic: dict[str, int] = {}
        self.latest_ns = 0  # the largest log time so far

    def make_record(
        self, topic: str, message: Message, log_ns: int, publish_ns: int, skipped: int
    ) -> Record:
        """Encode and number a message.

        Args:
            topic: topic of the message.
            message: what to record.
            log_ns: capture time when it was complete.
            publish_ns: capture time when it was measured.
            skipped: messages of the topic before it that were dropped.

        Raises:
            ValueError: it cannot be encoded; its number is used up.
        """
        number = self._next_by_topic.get(topic)
        # There cannot be a gap before the first message of a topic.
        number = 0 if number is None else number + skipped
        self._next_by_topic[topic] = number + 1
        self.latest_ns = max(self.latest_ns, log_ns)
        try:
            payload = message.encode()
        except (OverflowError, struct.error) as fault:
            raise ValueError(f"a message at {log_ns} ns cannot be encoded: {fault}") from fault
        return Record(topic, message.TYPE, payload, log_ns, publish_ns, number & 0xFFFF_FFFF)
