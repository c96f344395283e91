"""State replay: what a part must repeat because it starts in the middle of a session.

What to use when: under `part_writer`, one `StateReplay` per session. `observe` gets each
written record; `replay_records` returns what a new part starts with: open phases, and the
unit's unfinished commands (`PendingCommands`).

Theory of operation. A part that starts in the middle of a move contains positions but no
order. From such a part nobody could determine where the unit came from, how fast it should
go, and when it started. Therefore the commands since the unit was last at rest are kept as
recorded, and the last positions before them. The unit is at rest when both axes have twice
reported their targets; after a halt, an offset or a homing, when the positions have not changed
for a second; and at its first report, unless a target was commanded before. While it is at
rest nothing must be repeated, because every move is commanded with its speeds.
"""

import math

from gyrorig_daemon.recorder.ram_buffer import Record
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.motion_orders import OrderAxis, OrderKind
from gyrorig_protocol.recording.messages import (
    PTU_COMMAND_TOPIC,
    PTU_POSITION_TOPIC,
    SESSION_EVENT_TOPIC,
    EventKind,
    PtuPosition,
    PtuStatus,
    SessionEvent,
)
from gyrorig_protocol.recording.motion_messages import MOTION_ORDER_TOPIC, MotionOrder

MAX_COMMANDS = 256  # limit without a rest
STANDSTILL_NS = 1_000_000_000
_AXIS_BITS = (
    int(PtuStatus.PAN_ANSWERED),
    int(PtuStatus.TILT_ANSWERED),
)  # enum members take 1 us
_SINGLE_AXES = (OrderAxis.PAN, OrderAxis.TILT)
# after these the axis ends at a position that no order states
_UNKNOWN_TARGET_KINDS = (
    OrderKind.OFFSET, OrderKind.HALT, OrderKind.HOME, OrderKind.RATE, OrderKind.RATE_CHANGE
)  # fmt: skip
# The angle of a turn is known only for the whole turn, so half of it must not be repeated.
_WHOLE_ONLY = "turn"


class PendingCommands:
    """The commands since the unit was last at rest, and where that was."""

    def __init__(self) -> None:
        self._commands: list[Record] = []  # commands as sent, and the orders in them
        self._order_count = 0
        # last positions before the commands, by axis
        self._rest_records: list[Record | None] = [None, None]
        self._targets: list[int | None] = [None, None]
        self._last_answers: list[list[int]] = [[], []]  # the last two positions of each axis
        self._has_unknown_target = self._has_answer = False
        self._last_change: tuple[int, int, int] = (0, 0, 0)  # both counts, and since when
        self._verbatim: Record | None = None  # the last command; its orders follow
        self._next_sequence = {PTU_COMMAND_TOPIC: 0, PTU_POSITION_TOPIC: 0, MOTION_ORDER_TOPIC: 0}

    def observe(self, record: Record) -> None:
        """Process a record of the unit that was written; others are ignored."""
        try:
            if record.topic == PTU_POSITION_TOPIC:
                self._observe_position(record, PtuPosition.decode(record.payload))
            elif record.topic == MOTION_ORDER_TOPIC:
                self._observe_order(record, MotionOrder.decode(record.payload))
            elif record.topic == PTU_COMMAND_TOPIC:
                self._next_sequence[PTU_COMMAND_TOPIC] = record.sequence + 1
                self._verbatim = record
        except InputError:
            return  # written by this program; whatever it is, it moves nothing

    def invalidate(self) -> None:
        """Forget the commands, because records were lost."""
        self._commands.clear()
        self._order_count = 0
        self._rest_records = [None, None]
        self._has_unknown_target = self._has_answer = True  # until it is at rest

    def replay_records(self) -> list[Record]:
        """Return the first records of a part, numbered so that no gap follows."""
        rest_records = [record for record in self._rest_records if record is not None]
        if not self._commands or len(rest_records) < len(self._rest_records):
            return []
        position_records = sorted(
            {record.sequence: record for record in rest_records}.values(), key=_sequence_of
        )
        return [
            *self._renumbered(position_records),
            *self._renumbered([r for r in self._commands if r.topic == PTU_COMMAND_TOPIC]),
            *self._renumbered([r for r in self._commands if r.topic == MOTION_ORDER_TOPIC]),
        ]

    def _renumbered(self, records: list[Record]) -> list[Record]:
        if not records:
            return []
        first_sequence = self._next_sequence[records[0].topic] - len(records)
        return [
            record._replace(sequence=(first_sequence + index) & 0xFFFF_FFFF)
            for index, record in enumerate(records)
        ]

    def _observe_order(self, record: Record, order: MotionOrder) -> None:
        self._next_sequence[MOTION_ORDER_TOPIC] = record.sequence + 1
        verbatim, self._verbatim = self._verbatim, None
        if not order.accepted:
            return
        if verbatim is not None and verbatim.log_ns == record.log_ns:
            self._commands.append(verbatim)
        self._commands.append(record)
        self._order_count += 1
        if order.kind == OrderKind.TARGET and order.axis in _SINGLE_AXES:
            self._targets[order.axis] = round(order.steps)
            self._has_unknown_target = not math.isnan(order.speed_steps_s)
        elif order.kind in _UNKNOWN_TARGET_KINDS:
            self._has_unknown_target = True
        for answers in self._last_answers:
            answers.clear()
        self._last_change = (*self._last_change[:2], record.log_ns)
        if self._order_count > MAX_COMMANDS:
            self.invalidate()

    def _observe_position(self, record: Record, position: PtuPosition) -> None:
        self._next_sequence[PTU_POSITION_TOPIC] = record.sequence + 1
        steps = (position.pan_steps, position.tilt_steps)
        if steps != self._last_change[:2]:
            self._last_change = (*steps, record.log_ns)
        for axis, bit in enumerate(_AXIS_BITS):
            if position.status & bit:
                self._last_answers[axis] = [*self._last_answers[axis][-1:], steps[axis]]
        if self._commands or self._has_unknown_target:
            if not self._is_at_rest(record.log_ns):
                return
            self._commands.clear()
            self._order_count = 0
            self._has_unknown_target = False
        for axis, bit in enumerate(_AXIS_BITS):
            if position.status & bit:
                self._rest_records[axis] = record

    def _is_at_rest(self, now_ns: int) -> bool:
        is_first, self._has_answer = not self._has_answer, True
        if is_first and self._targets == [None, None]:
            return True
        if self._has_unknown_target:
            return now_ns - self._last_change[2] >= STANDSTILL_NS
        return all(
            target is None or answers == [target, target]
            for target, answers in zip(self._targets, self._last_answers, strict=True)
        )


def _sequence_of(record: Record) -> int:
    return record.sequence


class StateReplay:
    """The state of a session according to the records written so far."""

    def __init__(self) -> None:
        self._phases, self._unit = OpenPhases(), PendingCommands()
        self._dropped_count = 0
        self._observers = {
            SESSION_EVENT_TOPIC: self._phases.observe,
            PTU_COMMAND_TOPIC: self._unit.observe,
            MOTION_ORDER_TOPIC: self._unit.observe,
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
