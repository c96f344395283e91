"""Parser of our own boards' CAN frames: samples with complete timestamps and numbers.

Theory of operation: a sample has only 16 bits of time. STATUS, ten times per second, has the
complete time and the number of the newest sample. Between two STATUS frames, the timestamp of a
sample is the first one after the previous sample with the same low bits. Its number is larger by
as many sensor periods as have elapsed; the period is computed from two STATUS frames. This is valid
while less than half a wrap, 131 ms, elapses between two samples; then two samples that changed
places on the bus also keep their order. After a longer gap, and at the start, samples wait for the
next STATUS and are timestamped backwards from it. Samples that are too old for that are dropped
and counted.

Contract: received bytes never raise an error. An invalid frame gives a `FrameFault` event and is
counted by cause. At most `MAX_WAITING_SAMPLES` samples wait.
"""

from collections import deque
from collections.abc import Callable
from typing import TypeAlias

import msgspec

from gyrorig_protocol.board.board_events import BoardEvent, FaultCause, FrameEvent, FrameFault
from gyrorig_protocol.board.board_frames import (
    NO_AIR_TEMPERATURE_DECIDEGC,
    Sample,
    SampleFlag,
    Slow,
    Triple,
)
from gyrorig_protocol.board.json_frames import Hello
from gyrorig_protocol.board.payload_decoder import decode_payload
from gyrorig_protocol.can.board_can_frames import (
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
from gyrorig_protocol.can.can_frame import CanFrame
from gyrorig_protocol.can.hello_segments import HelloAssembler

MAX_WAITING_SAMPLES = 256  # a wrap of 262 ms has 210 samples at 800 Hz
_MAX_GAP_NS = 131_000_000  # half a wrap; after a longer gap a timestamp could be wrong by one wrap
_TIME_MASK = 0xFFFF_FFFF
# Between two STATUS, which come ten times per second. The number of a sample wraps after 82 s at
# 800 Hz, so that the difference of two numbers does not give the period after a longer silence.
MAX_STATUS_TICKS = 2_000_000
_NUMBER_MASK = 0xFFFF
_DATA_BYTES: dict[int, int] = {
    FrameType.LATCH: LATCH_BYTES,
    FrameType.ACCEL: SAMPLE_LAYOUT.size,
    FrameType.GYRO: SAMPLE_LAYOUT.size,
    FrameType.STATUS: STATUS_LAYOUT.size,
    FrameType.HEALTH: HEALTH_LAYOUT.size,
}
_DATA_READY = int(SampleFlag.STAMPED_AT_DATA_READY)
_SATURATED = int(SampleFlag.SATURATED)


class LatchEvent(msgspec.Struct, frozen=True, gc=False):
    """A board's clock at the host's edge with the number `counter` (low 8 bits)."""

    counter: int
    boot: int  # low 8 bits
    clock_ticks: int  # ticks, 48 bits
    received_ns: int


CanBoardEvent: TypeAlias = BoardEvent | LatchEvent


class _UntimedSample(msgspec.Struct, frozen=True, gc=False):
    """A sample that waits for its complete timestamp."""

    gyro: Triple
    accel: Triple | None
    time_field: int
    received_ns: int
    data: bytes


class CanBoardParser:
    """Parse the frames of one board (node) into events.

    A rate of at least `full_scale_counts` is flagged as saturated. The link sets it from the
    board's HELLO.
    """

    def __init__(self, node: int) -> None:
        self._node = node
        self.frames = 0
        self.faults = dict.fromkeys(FaultCause, 0)
        self._segments = HelloAssembler()
        self._waiting: deque[_UntimedSample] = deque()
        self._forget_board()
        self._handlers: dict[int, Callable[[CanFrame], list[CanBoardEvent]]] = {
            FrameType.LATCH: self._read_latch,
            FrameType.ACCEL: self._read_accel,
            FrameType.GYRO: self._read_gyro,
            FrameType.STATUS: self._read_status,
            FrameType.HEALTH: self._read_health,
            FrameType.HELLO: self._read_hello,
        }

    def _forget_board(self) -> None:
        self.full_scale_counts = (1 << 15) - 1
        self._pending_accel: tuple[int, Triple] | None = None
        # Time (32 bits) and number of the last sample; None: wait for STATUS.
        self._last_time_ticks: int | None = None
        self._last_number = 0
        self._last_gyro_ns = 0
        self._last_status: tuple[int, int] | None = None  # time and number of the last STATUS
        self._period_ticks: float | None = None
        self._boot: int | None = None
        self._sensor_temperature = 0
        self._air_temperature_decidegc: int | None = None
        self._sample_temperature: int | None = None  # of the better sensor
        self._counters = [0, 0, 0, 0]

    @property
    def waiting_count(self) -> int:
        """Number of samples that wait for a STATUS, at most `MAX_WAITING_SAMPLES`."""
        return len(self._waiting)

    def wants(self, key: int) -> bool:
        """Return whether frames of this key (`CanFrame.key`) are this board's."""
        return key & MAX_NODE == self._node and key >> NODE_BITS in self._handlers

    def reset(self) -> None:
        """Forget the board and its unfinished data: another board can follow on the bus."""
        self._segments.reset()
        self._waiting.clear()
        self._forget_board()

    def feed(self, frame: CanFrame) -> list[CanBoardEvent]:
        """Return the events that a frame of this board's node completes."""
        frame_type = frame.identifier >> NODE_BITS
        handler = self._handlers.get(frame_type)
        if handler is None or frame.flags:
            return self._report_fault(FaultCause.UNKNOWN_TYPE, frame)
        if frame_type != FrameType.HELLO:
            if len(frame.data) != _DATA_BYTES[frame_type]:
                return self._report_fault(FaultCause.LENGTH, frame)
            self.frames += 1
        return handler(frame)

    def _read_latch(self, frame: CanFrame) -> list[CanBoardEvent]:
        counter, boot = frame.data[:2]
        clock_ticks = int.from_bytes(frame.data[2:], "little")
        return [LatchEvent(counter, boot, clock_ticks, frame.timestamp_ns)]

    def _read_accel(self, frame: CanFrame) -> list[CanBoardEvent]:
        x, y, z, time_field = SAMPLE_LAYOUT.unpack(frame.data)
        self._pending_accel = time_field, (x, y, z)
        return []

    def _read_gyro(self, frame: CanFrame) -> list[CanBoardEvent]:
        x, y, z, time_field = SAMPLE_LAYOUT.unpack(frame.data)
        pending_accel, self._pending_accel = self._pending_accel, None
        accel = None
        if pending_accel is not None and pending_accel[0] == time_field:
            accel = pending_accel[1]
        previous_ns, self._last_gyro_ns = self._last_gyro_ns, frame.timestamp_ns
        if frame.timestamp_ns - previous_ns > _MAX_GAP_NS:
            self._last_time_ticks = None
        if self._last_time_ticks is None:
            self._waiting.append(
                _UntimedSample((x, y, z), accel, time_field, frame.timestamp_ns, frame.data)
            )
            if len(self._waiting) > MAX_WAITING_SAMPLES:
                return self._drop_waiting()
            return []
        time_ticks, number = self._unwrap_time(self._last_time_ticks, time_field)
        sample = self._make_sample(time_ticks, number, (x, y, z), accel)
        return [FrameEvent(sample, frame.timestamp_ns, 0, frame.data)]

    def _unwrap_time(self, previous_ticks: int, time_field: int) -> tuple[int, int]:
        """Return timestamp and number of a sample from the timestamp of the previous one."""
        elapsed_ticks = (time_field * SAMPLE_UNIT_TICKS - previous_ticks) % SAMPLE_WRAP_TICKS
        if elapsed_ticks > SAMPLE_WRAP_TICKS // 2:
            elapsed_ticks -= SAMPLE_WRAP_TICKS  # older: two samples arrived in the wrong order
        steps = (elapsed_ticks > 0) - (elapsed_ticks < 0)
        if self._period_ticks is not None and steps:
            steps *= max(1, round(abs(elapsed_ticks) / self._period_ticks))
        time_ticks, number = (
            (previous_ticks + elapsed_ticks) & _TIME_MASK,
            (self._last_number + steps) & _NUMBER_MASK,
        )
        if steps > 0:
            self._last_time_ticks, self._last_number = time_ticks, number
        return time_ticks, number

    def _make_sample(
        self, time_ticks: int, number: int, gyro: Triple, accel: Triple | None
    ) -> Sample:
        full_scale = self.full_scale_counts
        flags = _DATA_READY
        if max(gyro) >= full_scale or min(gyro) <= -full_scale:
            flags |= _SATURATED
        return Sample(flags, number, time_ticks, gyro, accel, self._sample_temperature)

    def _read_status(self, frame: CanFrame) -> list[CanBoardEvent]:
        time_ticks, number, boot = STATUS_LAYOUT.unpack(frame.data)
        events: list[CanBoardEvent] = []
        if boot != self._boot:
            if self._boot is not None:
                events += (
                    self._drop_waiting()
                )  # from before the restart: they cannot be timestamped
            self._boot = boot
            self._period_ticks = self._last_status = self._last_time_ticks = None
            self._counters = [0, 0, 0, 0]
        slow = self._make_slow(time_ticks, number, boot)
        events.append(FrameEvent(slow, frame.timestamp_ns, 0, frame.data))
        self._update_period(time_ticks, number)
        self._last_status = time_ticks, number
        if self._last_time_ticks is None:
            self._last_time_ticks, self._last_number = time_ticks & ~(SAMPLE_UNIT_TICKS - 1), number
            events += self._timestamp_waiting(frame.timestamp_ns)
            self._last_gyro_ns = frame.timestamp_ns
        else:
            self._resynchronise(time_ticks, number)
        return events

    def _make_slow(self, time_ticks: int, number: int, boot: int) -> Slow:
        overruns, dropped, errors, saturations = self._counters
        return Slow(
            device_time=time_ticks,
            boot=boot,
            sequence=number,
            sensor_overruns=overruns,
            frames_dropped=dropped,
            bus_errors=errors,
            saturations=saturations,
            temperature=self._sensor_temperature,
            air_temperature_decidegc=self._air_temperature_decidegc,
            supply_mv=None,
        )

    def _update_period(self, time_ticks: int, number: int) -> None:
        if self._last_status is None:
            return
        elapsed_ticks = (time_ticks - self._last_status[0]) & _TIME_MASK
        steps = (number - self._last_status[1]) & _NUMBER_MASK
        if 0 < steps < 1 << 15 and 0 < elapsed_ticks < MAX_STATUS_TICKS:
            self._period_ticks = elapsed_ticks / steps

    def _resynchronise(self, time_ticks: int, number: int) -> None:
        """Set the last sample's number from STATUS; wait for the next if the times disagree."""
        if self._last_time_ticks is None:
            return
        lag_ticks = (time_ticks - self._last_time_ticks) & _TIME_MASK
        lag_ticks -= (lag_ticks >> 31) << 32
        if abs(lag_ticks) > SAMPLE_WRAP_TICKS // 2:
            self._last_time_ticks = None  # frames were lost for more than half a wrap
            return
        # The newest sample can arrive after its STATUS or before it.
        steps = 0 if self._period_ticks is None else round(lag_ticks / self._period_ticks)
        self._last_number = (number - steps) & _NUMBER_MASK

    def _timestamp_waiting(self, now_ns: int) -> list[CanBoardEvent]:
        """Return the waiting samples, timestamped and numbered backwards from a STATUS.

        Each is within half a wrap of the next one, or too old for a timestamp.
        """
        time_ticks, number = self._last_time_ticks or 0, self._last_number
        events: list[CanBoardEvent] = []
        next_received_ns = now_ns
        while self._waiting:
            waiting_sample = self._waiting.pop()
            if next_received_ns - waiting_sample.received_ns > _MAX_GAP_NS:
                self._waiting.append(waiting_sample)
                break
            next_received_ns = waiting_sample.received_ns
            earlier_ticks = (
                time_ticks - waiting_sample.time_field * SAMPLE_UNIT_TICKS
            ) % SAMPLE_WRAP_TICKS
            if earlier_ticks > SAMPLE_WRAP_TICKS // 2:
                earlier_ticks -= SAMPLE_WRAP_TICKS  # it arrived before an older sample
            steps = (earlier_ticks >= SAMPLE_UNIT_TICKS) - (earlier_ticks <= -SAMPLE_UNIT_TICKS)
            if self._period_ticks is not None:
                steps = round(earlier_ticks / self._period_ticks)
            time_ticks, number = (
                (time_ticks - earlier_ticks) & _TIME_MASK,
                (number - steps) & _NUMBER_MASK,
            )
            if earlier_ticks < 0 and not events:
                self._last_time_ticks, self._last_number = time_ticks, number
            sample = self._make_sample(
                time_ticks, number, waiting_sample.gyro, waiting_sample.accel
            )
            events.append(FrameEvent(sample, waiting_sample.received_ns, 0, waiting_sample.data))
        return [*self._drop_waiting(), *reversed(events)]

    def _drop_waiting(self) -> list[CanBoardEvent]:
        waiting, self._waiting = self._waiting, deque()
        events: list[CanBoardEvent] = []
        for waiting_sample in waiting:
            events += self._report_fault(
                FaultCause.CONTENT, CanFrame(0, waiting_sample.data, 0, waiting_sample.received_ns)
            )
        return events

    def _read_health(self, frame: CanFrame) -> list[CanBoardEvent]:
        self._sensor_temperature, air_field, *counters = HEALTH_LAYOUT.unpack(frame.data)
        self._air_temperature_decidegc = (
            None if air_field == NO_AIR_TEMPERATURE_DECIDEGC else air_field
        )
        # As on a serial line, the temperature of a sample is that of the better sensor.
        self._sample_temperature = (
            self._sensor_temperature
            if self._air_temperature_decidegc is None
            else self._air_temperature_decidegc
        )
        self._counters = [
            total + ((count_field - total) & 0xFF)
            for total, count_field in zip(self._counters, counters, strict=True)
        ]
        return []

    def _read_hello(self, frame: CanFrame) -> list[CanBoardEvent]:
        text = self._segments.feed(frame.data)
        if isinstance(text, FaultCause):
            return self._report_fault(text, frame)
        self.frames += 1
        if text is None:
            return []
        payload = bytes([Hello.TYPE]) + text
        hello = decode_payload(payload)
        if not isinstance(hello, Hello):
            return self._report_fault(FaultCause.CONTENT, frame)
        return [FrameEvent(hello, frame.timestamp_ns, 0, payload)]

    def _report_fault(self, cause: FaultCause, frame: CanFrame) -> list[CanBoardEvent]:
        self.faults[cause] += 1
        return [FrameFault(cause, frame.timestamp_ns, 0, frame.data)]
