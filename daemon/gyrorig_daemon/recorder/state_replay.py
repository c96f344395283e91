"""State replay: what a part must repeat because it starts in the middle of a session.

What to use when: under `part_writer`, one `StateReplay` per session. `observe` gets each
written record; `replay_records` returns what a new part starts with: open phases, and the
unit's unfinished commands (`PendingCommands`).
"""

from gyrorig_daemon.recorder.pending_commands import PendingCommands
from gyrorig_daemon.recorder.ram_buffer import Record
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import (
    PTU_COMMAND_TOPIC,
    PTU_POSITION_TOPIC,
    SESSION_EVENT_TOPIC,
    EventKind,
    SessionEvent,
)

# The angle of a turn is known only for the whole turn, so half of it must not be repeated.
_WHOLE_ONLY = "turn"


class StateReplay:
    """The state of a session according to the records written so far."""

    def __init__(self) -> None:
        self._phases, self._unit = OpenPhases(), PendingCommands()
        self._dropped_count = 0
        self._observers = {
            SESSION_EVENT_TOPIC: self._phases.observe,
            PTU_COMMAND_TOPIC: self._unit.observe,
            PTU_POSITION_TOPIC: self._unit.observe,
        }

    def observe(self, record: Record) -> None:
        """Process a record that was written."""
        observer = self._observers.get(record.topic)
        if observer is not None:
            observer(record)

    def invalidate_unit(self) -> None:
        """Forget the unit's commands, because some records will be written again."""
        self._unit.invalidate()

    def replay_records(self, at_ns: int, dropped_count: int) -> list[Record]:
        """Return the first records of a part.

        Args:
            at_ns: log time of the first record that follows.
            dropped_count: number of records that the buffer in memory has dropped so far.
        """
        if dropped_count != self._dropped_count:
            self._dropped_count = dropped_count
            self._unit.invalidate()
        return [*self._phases.replay_records(at_ns), *self._unit.replay_records()]


class OpenPhases:
    """Phases that have begun and not ended, according to the events written so far."""

    def __init__(self) -> None:
        self._open_events: list[SessionEvent] = []
        self._next_sequence = 0  # number of the next event in the files

    def observe(self, record: Record) -> None:
        """Process an event that was written."""
        self._next_sequence = record.sequence + 1
        try:
            event = SessionEvent.decode(record.payload)
        except InputError:
            return  # written by this program; whatever it is, it opens no phase
        if event.kind == EventKind.PHASE_BEGIN:
            self._open_events.append(event)
        elif event.kind == EventKind.PHASE_END:
            for open_event in reversed(self._open_events):
                if open_event.phase == event.phase:
                    self._open_events.remove(open_event)
                    break

    def replay_records(self, at_ns: int) -> list[Record]:
        """Return the open phases as starting at `at_ns`, numbered so that no gap follows."""
        events = [
            SessionEvent(at_ns, open_event.kind, open_event.phase, open_event.text)
            for open_event in self._open_events
            if open_event.phase != _WHOLE_ONLY
        ]
        first_sequence = self._next_sequence - len(events)
        return [
            Record(
                SESSION_EVENT_TOPIC,
                SessionEvent.TYPE,
                event.encode(),
                at_ns,
                at_ns,
                (first_sequence + index) & 0xFFFF_FFFF,
            )
            for index, event in enumerate(events)
        ]
