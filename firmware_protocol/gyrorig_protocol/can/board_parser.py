"""From our own board's CAN frames to samples, with whole stamps and numbers.

Theory of operation. A sample carries only 16 bits of time; STATUS, ten times a second, says
the newest sample's whole time and number. Between two STATUS each sample's stamp is the
first one after the last that has its low bits, and its number is as many sensor periods
on, the period being what passed between two STATUS. That holds while less than a wrap of
131 ms, half a wrap, passes between two samples; so the samples of a bus that swaps two of
them keep their order. After a longer gap, and at the start, samples wait for the next STATUS
and are counted back from it; those too old for that are dropped and counted.

Contract: device bytes raise nothing. What is no frame of a board is a `FrameFault` event,
counted by cause; at most `MAX_WAITING` samples wait.
"""

from collections import deque
from collections.abc import Callable
from typing import TypeAlias

import msgspec

from gyrorig_protocol.board.decode import decode_payload
from gyrorig_protocol.board.events import BoardEvent, FaultCause, FrameEvent, FrameFault
from gyrorig_protocol.board.frames import (
    NO_AIR_TEMPERATURE,
    Sample,
    SampleFlag,
    Slow,
    Triple,
)
from gyrorig_protocol.board.hello import Hello
from gyrorig_protocol.can.board import (
    HEALTH_LAYOUT,
    LATCH_BYTES,
    MAX_NODE,
    NODE_BITS,
    SAMPLE_LAYOUT,
    SAMPLE_UNIT_TICKS,
    SAMPLE_WRAP_TICKS,
    STATUS_LAYOUT,
    FrameType,
)
from gyrorig_protocol.can.frame import CanFrame
from gyrorig_protocol.can.segments import SegmentCollector

MAX_WAITING = 256  # a wrap of 262 ms at 800 Hz is 210
_GAP_NS = 131_000_000  # half a wrap: beyond it the next stamp could be one wrap off
_TIME_MASK = 0xFFFF_FFFF
_NUMBER_MASK = 0xFFFF
_DATA_READY = int(SampleFlag.STAMPED_AT_DATA_READY)
_SATURATED = int(SampleFlag.SATURATED)


class LatchEvent(msgspec.Struct, frozen=True, gc=False):
    """A board's clock at the host's edge number `counter` (low 8 bits)."""

    counter: int
    boot: int  # low 8 bits
    clock: int  # ticks, 48 bits
    received_ns: int


CanBoardEvent: TypeAlias = BoardEvent | LatchEvent


class _Waiting(msgspec.Struct, frozen=True, gc=False):
    """A sample without a whole stamp yet."""

    gyro: Triple
    accel: Triple | None
    time16: int
    received_ns: int
    data: bytes


class BoardFrameParser:
    """Turn one board's frames into events.

    `full_scale_counts` is the code beyond which a rate is flagged as saturated: the link
    sets it from the board's HELLO.
    """

    def __init__(self, node: int) -> None:
        """Read the frames of `node`."""
        self._node = node
        self.full_scale_counts = (1 << 15) - 1
        self.frames = 0
        self.faults = dict.fromkeys(FaultCause, 0)
        self._segments = SegmentCollector()
        self._waiting: deque[_Waiting] = deque()
        self._accel: tuple[int, Triple] | None = None
        self._time: int | None = None  # of the last sample, 32 bits; None: wait for STATUS
        self._number = 0  # of the last sample
        self._heard_ns = 0
        self._anchor: tuple[int, int] | None = None  # time and number of the last STATUS
        self._period: float | None = None  # ticks
        self._boot: int | None = None
        self._own_temperature = 0
        self._air: int | None = None
        self._temperature: int | None = None  # of samples: the better sensor's
        self._counters = [0, 0, 0, 0]
        self._feeders: dict[int, Callable[[CanFrame], list[CanBoardEvent]]] = {
            FrameType.LATCH: self._latch,
            FrameType.ACCEL: self._take_accel,
            FrameType.GYRO: self._gyro,
            FrameType.STATUS: self._status,
            FrameType.HEALTH: self._health,
            FrameType.HELLO: self._hello,
        }

    @property
    def waiting(self) -> int:
        """How many samples wait for a STATUS, at most `MAX_WAITING`."""
        return len(self._waiting)

    def wants(self, key: int) -> bool:
        """Return whether frames of this key (`CanFrame.key`) are this board's."""
        return key & MAX_NODE == self._node and key >> NODE_BITS in self._feeders

    def reset(self) -> None:
        """Forget what was begun, as after the bus was away."""
        self._segments.reset()
        self._waiting.clear()
        self._accel = self._time = self._anchor = self._period = None

    def feed(self, frame: CanFrame) -> list[CanBoardEvent]:
        """Return the events that a frame of this board's node completes."""
        feeder = self._feeders.get(frame.identifier >> NODE_BITS)
        if feeder is None or frame.flags:
            return self._fault(FaultCause.UNKNOWN_TYPE, frame)
        return feeder(frame)

    def _latch(self, frame: CanFrame) -> list[CanBoardEvent]:
        if len(frame.data) != LATCH_BYTES:
            return self._fault(FaultCause.LENGTH, frame)
        self.frames += 1
        counter, boot = frame.data[:2]
        clock = int.from_bytes(frame.data[2:], "little")
        return [LatchEvent(counter, boot, clock, frame.stamp_ns)]

    def _take_accel(self, frame: CanFrame) -> list[CanBoardEvent]:
        if len(frame.data) != SAMPLE_LAYOUT.size:
            return self._fault(FaultCause.LENGTH, frame)
        self.frames += 1
        x, y, z, time16 = SAMPLE_LAYOUT.unpack(frame.data)
        self._accel = time16, (x, y, z)
        return []

    def _gyro(self, frame: CanFrame) -> list[CanBoardEvent]:
        if len(frame.data) != SAMPLE_LAYOUT.size:
            return self._fault(FaultCause.LENGTH, frame)
        self.frames += 1
        x, y, z, time16 = SAMPLE_LAYOUT.unpack(frame.data)
        accel, self._accel = self._accel, None
        paired = accel[1] if accel is not None and accel[0] == time16 else None
        heard_ns, self._heard_ns = self._heard_ns, frame.stamp_ns
        if frame.stamp_ns - heard_ns > _GAP_NS:
            self._time = None
        if self._time is None:
            self._waiting.append(_Waiting((x, y, z), paired, time16, frame.stamp_ns, frame.data))
            if len(self._waiting) > MAX_WAITING:
                return self._drop_waiting()
            return []
        time, number = self._place(self._time, time16)
        sample = self._sample(time, number, (x, y, z), paired)
        return [FrameEvent(sample, frame.stamp_ns, 0, frame.data)]

    def _place(self, before: int, time16: int) -> tuple[int, int]:
        """Return stamp and number of a sample beside the last one's stamp."""
        passed = (time16 * SAMPLE_UNIT_TICKS - before) % SAMPLE_WRAP_TICKS
        if passed > SAMPLE_WRAP_TICKS // 2:
            passed -= SAMPLE_WRAP_TICKS  # older: two samples came in the wrong order
        steps = (passed > 0) - (passed < 0)
        if self._period is not None and steps:
            steps *= max(1, round(abs(passed) / self._period))
        time, number = (before + passed) & _TIME_MASK, (self._number + steps) & _NUMBER_MASK
        if steps > 0:
            self._time, self._number = time, number
        return time, number

    def _sample(self, time: int, number: int, gyro: Triple, accel: Triple | None) -> Sample:
        limit = self.full_scale_counts
        flags = _DATA_READY
        if max(gyro) >= limit or min(gyro) <= -limit:
            flags |= _SATURATED
        return Sample(flags, number, time, gyro, accel, self._temperature)

    def _status(self, frame: CanFrame) -> list[CanBoardEvent]:
        if len(frame.data) != STATUS_LAYOUT.size:
            return self._fault(FaultCause.LENGTH, frame)
        self.frames += 1
        time, number, boot = STATUS_LAYOUT.unpack(frame.data)
        events: list[CanBoardEvent] = []
        if boot != self._boot:
            if self._boot is not None:
                events += self._drop_waiting()  # of the start before: nothing dates them now
            self._boot = boot
            self._period = self._anchor = self._time = None
            self._counters = [0, 0, 0, 0]
        slow = self._slow(time, number, boot)
        events.append(FrameEvent(slow, frame.stamp_ns, 0, frame.data))
        self._learn_period(time, number)
        self._anchor = time, number
        if self._time is None:
            self._time, self._number = time & ~(SAMPLE_UNIT_TICKS - 1), number
            events += self._date_waiting(frame.stamp_ns)
            self._heard_ns = frame.stamp_ns
        else:
            self._check_anchor(time, number)
        return events

    def _slow(self, time: int, number: int, boot: int) -> Slow:
        overruns, dropped, errors, saturations = self._counters
        return Slow(
            device_time=time,
            boot=boot,
            sequence=number,
            sensor_overruns=overruns,
            frames_dropped=dropped,
            bus_errors=errors,
            saturations=saturations,
            temperature=self._own_temperature,
            air_temperature_decidegc=self._air,
            supply_mv=None,
        )

    def _learn_period(self, time: int, number: int) -> None:
        if self._anchor is None:
            return
        passed = (time - self._anchor[0]) & _TIME_MASK
        steps = (number - self._anchor[1]) & _NUMBER_MASK
        if 0 < steps < 1 << 15 and 0 < passed < 1 << 31:
            self._period = passed / steps

    def _check_anchor(self, time: int, number: int) -> None:
        """Number the last sample as STATUS says, and wait for the next if stamps disagree."""
        if self._time is None:
            return
        behind = (time - self._time) & _TIME_MASK
        behind -= (behind >> 31) << 32
        if abs(behind) > SAMPLE_WRAP_TICKS // 2:
            self._time = None  # frames were lost for longer than the stamps reach
            return
        # The newest sample of STATUS may wait behind it on the bus, or have overtaken it.
        steps = 0 if self._period is None else round(behind / self._period)
        self._number = (number - steps) & _NUMBER_MASK

    def _date_waiting(self, now_ns: int) -> list[CanBoardEvent]:
        """Return the samples that waited, dated and numbered back from a STATUS.

        Each is within half a wrap of the one behind it, or too old to be dated at all.
        """
        time, number = self._time or 0, self._number
        found: list[CanBoardEvent] = []
        heard_ns = now_ns
        while self._waiting:
            held = self._waiting.pop()
            if heard_ns - held.received_ns > _GAP_NS:
                self._waiting.append(held)
                break
            heard_ns = held.received_ns
            back = (time - held.time16 * SAMPLE_UNIT_TICKS) % SAMPLE_WRAP_TICKS
            if back > SAMPLE_WRAP_TICKS // 2:
                back -= SAMPLE_WRAP_TICKS  # it overtook what is behind it
            steps = (back >= SAMPLE_UNIT_TICKS) - (back <= -SAMPLE_UNIT_TICKS)
            if self._period is not None:
                steps = round(back / self._period)
            time, number = (time - back) & _TIME_MASK, (number - steps) & _NUMBER_MASK
            if back < 0 and not found:
                self._time, self._number = time, number
            sample = self._sample(time, number, held.gyro, held.accel)
            found.append(FrameEvent(sample, held.received_ns, 0, held.data))
        return [*self._drop_waiting(), *reversed(found)]

    def _drop_waiting(self) -> list[CanBoardEvent]:
        waiting, self._waiting = self._waiting, deque()
        events: list[CanBoardEvent] = []
        for held in waiting:
            events += self._fault(FaultCause.CONTENT, CanFrame(0, held.data, 0, held.received_ns))
        return events

    def _health(self, frame: CanFrame) -> list[CanBoardEvent]:
        if len(frame.data) != HEALTH_LAYOUT.size:
            return self._fault(FaultCause.LENGTH, frame)
        self.frames += 1
        self._own_temperature, air, *counters = HEALTH_LAYOUT.unpack(frame.data)
        self._air = None if air == NO_AIR_TEMPERATURE else air
        # As on a serial line, a sample's temperature is the better sensor's.
        self._temperature = self._own_temperature if self._air is None else self._air
        self._counters = [
            known + ((count - known) & 0xFF)
            for known, count in zip(self._counters, counters, strict=True)
        ]
        return []

    def _hello(self, frame: CanFrame) -> list[CanBoardEvent]:
        text = self._segments.feed(frame.data)
        if isinstance(text, FaultCause):
            return self._fault(text, frame)
        self.frames += 1
        if text is None:
            return []
        payload = bytes([Hello.TYPE]) + text
        hello = decode_payload(payload)
        if not isinstance(hello, Hello):
            return self._fault(FaultCause.CONTENT, frame)
        return [FrameEvent(hello, frame.stamp_ns, 0, payload)]

    def _fault(self, cause: FaultCause, frame: CanFrame) -> list[CanBoardEvent]:
        self.faults[cause] += 1
        return [FrameFault(cause, frame.stamp_ns, 0, frame.data)]
