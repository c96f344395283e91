"""What a part begins in the middle of, and therefore has to say again.

What to use when: under `spool`, one `Restating` a session: `follow` for each record that was
written, `records` for what a new part says first: the phases, and the unit's last orders
(`unit_state`).
"""

from gyrorig_daemon.recorder.ring import Record
from gyrorig_daemon.recorder.unit_state import UnitState
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import (
    PTU_COMMAND_TOPIC,
    PTU_POSITION_TOPIC,
    SESSION_EVENT_TOPIC,
    EventKind,
    SessionEvent,
)

# A turn by a known angle is known only as a whole: half of it in a part would be a lie.
_WHOLE_ONLY = "turn"


class Restating:
    """The state of a session as the records written so far tell it."""

    def __init__(self) -> None:
        self._phases, self._unit = Phases(), UnitState()
        self._dropped = 0
        self._followers = {
            SESSION_EVENT_TOPIC: self._phases.follow,
            PTU_COMMAND_TOPIC: self._unit.follow,
            PTU_POSITION_TOPIC: self._unit.follow,
        }

    def follow(self, record: Record) -> None:
        """Take in a record that was written."""
        follower = self._followers.get(record.topic)
        if follower is not None:
            follower(record)

    def break_off(self) -> None:
        """Some of what was followed will be written again: the unit's orders are not sure."""
        self._unit.forget()

    def records(self, at_ns: int, dropped: int) -> list[Record]:
        """Return what a part says first.

        Args:
            at_ns: log time of the first record that comes to it.
            dropped: how many records memory had to forget so far.
        """
        if dropped != self._dropped:
            self._dropped = dropped
            self._unit.forget()
        return [*self._phases.restated(at_ns), *self._unit.restated()]


class Phases:
    """Which phases have begun and not ended, as the events written so far say."""

    def __init__(self) -> None:
        self._open: list[SessionEvent] = []
        self._next = 0  # number of the next event in the files

    def follow(self, record: Record) -> None:
        """Take in one event that was written."""
        self._next = record.sequence + 1
        try:
            event = SessionEvent.decode(record.payload)
        except InputError:
            return  # written by this program; whatever it is, it opens no phase
        if event.kind == EventKind.PHASE_BEGIN:
            self._open.append(event)
        elif event.kind == EventKind.PHASE_END:
            for one in reversed(self._open):
                if one.phase == event.phase:
                    self._open.remove(one)
                    break

    def restated(self, at_ns: int) -> list[Record]:
        """The open phases as beginning at `at_ns`, numbered so that no gap follows them."""
        events = [
            SessionEvent(at_ns, one.kind, one.phase, one.text)
            for one in self._open
            if one.phase != _WHOLE_ONLY
        ]
        first = self._next - len(events)
        return [
            Record(
                SESSION_EVENT_TOPIC,
                SessionEvent.TYPE,
                event.encode(),
                at_ns,
                at_ns,
                (first + place) & 0xFFFF_FFFF,
            )
            for place, event in enumerate(events)
        ]
