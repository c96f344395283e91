"""What the unit was told and has not done yet, as a part has to say it again.

What to use when: under `spool`, which hands every record of the unit to `follow` as it is
written; `restated` is what a part begins with.

Theory of operation. A part that begins in the middle of a move holds answers on the way and
no order: nobody could say from it where the unit came from, how fast it was to go, and when
it set off. So the orders since the unit last stood are kept as they were recorded, and the
last answers before them. It stands where both axes have twice answered their targets; where
a halt, an offset or a homing left it, when the answers have not changed for a second; and at
its first answer, unless a target was told before. While it stands nothing has to be said
again: every move is told with its speeds.
"""

import re

from gyrorig_daemon.recorder.ring import Record
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import (
    PTU_COMMAND_TOPIC,
    PTU_POSITION_TOPIC,
    CommandCode,
    PtuCommandRecord,
    PtuPosition,
    PtuStatus,
)

MOST_ORDERS = 256  # without a rest: then what the unit does is told by its answers alone
STILL_NS = 1_000_000_000
_BITS = (int(PtuStatus.PAN_ANSWERED), int(PtuStatus.TILT_ANSWERED))  # an enum's cost a microsecond
_TARGET = re.compile(r"([PT])P([-+]?\d+)\s*")
# Whatever may set an axis off or change its way: targets, speeds, halts, modes, homing.
_ORDER = re.compile(r"[PT][PSODAB][-+]?\d+\s*|B[-+]?\d+,.*|[AIS]\s*|H[PT]?\s*|C[IV]\s*|R[PT]?\s*")
_UNAIMED = re.compile(r"[PT]O.*|B.*|H[PT]?\s*|C[IV]\s*|R[PT]?\s*")  # ends where nobody was told


class UnitState:
    """The orders since the unit last stood, and where that was."""

    def __init__(self) -> None:
        self._orders: list[Record] = []
        self._stood: list[Record | None] = [None, None]  # last answers before them, by axis
        self._targets: list[int | None] = [None, None]
        self._at: list[list[int]] = [[], []]  # the last two answers of each axis
        self._unaimed = self._is_seen = False
        self._still: tuple[int, int, int] = (0, 0, 0)  # both counts, and since when
        self._next = {PTU_COMMAND_TOPIC: 0, PTU_POSITION_TOPIC: 0}

    def follow(self, record: Record) -> None:
        """Take in a record of the unit that was written; any other is no fault."""
        try:
            if record.topic == PTU_POSITION_TOPIC:
                self._take_position(record, PtuPosition.decode(record.payload))
            elif record.topic == PTU_COMMAND_TOPIC:
                self._take_command(record, PtuCommandRecord.decode(record.payload))
        except InputError:
            return  # written by this program; whatever it is, it moves nothing

    def forget(self) -> None:
        """Something was lost between two records: what was told is not known any more."""
        self._orders.clear()
        self._stood = [None, None]
        self._unaimed = self._is_seen = True  # until it stands

    def restated(self) -> list[Record]:
        """Return what a part begins with, numbered so that no gap follows."""
        stood = [record for record in self._stood if record is not None]
        if not self._orders or len(stood) < len(self._stood):
            return []
        answers = sorted({record.sequence: record for record in stood}.values(), key=_number)
        return [*self._numbered(answers), *self._numbered(self._orders)]

    def _numbered(self, records: list[Record]) -> list[Record]:
        first = self._next[records[0].topic] - len(records)
        return [
            record._replace(sequence=(first + place) & 0xFFFF_FFFF)
            for place, record in enumerate(records)
        ]

    def _take_command(self, record: Record, told: PtuCommandRecord) -> None:
        self._next[PTU_COMMAND_TOPIC] = record.sequence + 1
        text = told.command.strip().upper()
        if told.code != CommandCode.OK or not _ORDER.fullmatch(text):
            return
        self._orders.append(record)
        if match := _TARGET.fullmatch(text):
            self._targets["PT".index(match[1])] = int(match[2])
            self._unaimed = False
        self._unaimed = self._unaimed or bool(_UNAIMED.fullmatch(text))
        for seen in self._at:
            seen.clear()
        self._still = (*self._still[:2], record.log_ns)
        if len(self._orders) > MOST_ORDERS:
            self.forget()

    def _take_position(self, record: Record, seen: PtuPosition) -> None:
        self._next[PTU_POSITION_TOPIC] = record.sequence + 1
        here = (seen.pan_steps, seen.tilt_steps)
        if here != self._still[:2]:
            self._still = (*here, record.log_ns)
        for axis, bit in enumerate(_BITS):
            if seen.status & bit:
                self._at[axis] = [*self._at[axis][-1:], here[axis]]
        if self._orders or self._unaimed:
            if not self._stands(record.log_ns):
                return
            self._orders.clear()
            self._unaimed = False
        for axis, bit in enumerate(_BITS):
            if seen.status & bit:
                self._stood[axis] = record

    def _stands(self, now_ns: int) -> bool:
        is_first, self._is_seen = not self._is_seen, True
        if is_first and self._targets == [None, None]:
            return True
        if self._unaimed:
            return now_ns - self._still[2] >= STILL_NS
        return all(
            target is None or seen == [target, target]
            for target, seen in zip(self._targets, self._at, strict=True)
        )


def _number(record: Record) -> int:
    return record.sequence
