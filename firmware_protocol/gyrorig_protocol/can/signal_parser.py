"""From any IMU's CAN frames to samples, by a bound signal map.

A sample is complete when every message that holds one of its rates has come; accelerations,
temperature, time and counter are the newest that came since the sample before, so those that
are sent behind the rates belong to the sample before. A message that comes a second time
before the others have come means that one was lost: what was begun is dropped, and the
number of the sample with it, so that the loss shows as a gap.

Contract: device bytes raise nothing; what is no value is a `FrameFault`, counted by cause.
"""

import math

from gyrorig_protocol.board.events import BoardEvent, FaultCause, FrameEvent, FrameFault
from gyrorig_protocol.board.frames import Sample, Triple
from gyrorig_protocol.can.frame import CanFrame
from gyrorig_protocol.can.signal_map import BoundMap, BoundSignal

_INT32, _INT16 = 2**31 - 1, 2**15 - 1
_NUMBER_MASK = 0xFFFF_FFFF
_EXTENDED = 1 << 31
_J1939_GROUP = 0x03FF_FF00  # without priority and source address


class SignalParser:
    """Turn the frames of one IMU into events."""

    def __init__(self, bound: BoundMap) -> None:
        self._map = bound
        self._rate_keys = {part.key for part in bound.gyro if part is not None}
        self._keys = dict.fromkeys(bound.lengths)
        self._groups = {key & _J1939_GROUP: key for key in bound.lengths if key & _EXTENDED}
        self._fresh: dict[int, bytes] = {}  # messages since the last sample
        self._number = -1
        self._last_counter: int | None = None
        self.frames = 0
        self.faults = dict.fromkeys(FaultCause, 0)

    def wants(self, key: int) -> bool:
        """Return whether frames of this key (`CanFrame.key`) are this IMU's."""
        return self._message(key) is not None

    def reset(self) -> None:
        """Forget what was begun, as after the bus was away."""
        self._fresh.clear()

    def feed(self, frame: CanFrame) -> list[BoardEvent]:
        """Return the events that a frame completes."""
        key = self._message(frame.key)
        if key is None or not frame.is_data:
            return self._fault(FaultCause.UNKNOWN_TYPE, frame)
        if len(frame.data) < self._map.lengths[key]:
            return self._fault(FaultCause.LENGTH, frame)
        self.frames += 1
        if key in self._rate_keys and key in self._fresh:
            self._number += 1
            self._fresh = {}
        self._fresh[key] = frame.data
        if not self._rate_keys <= self._fresh.keys():
            return []
        fresh, self._fresh = self._fresh, {}
        return [self._sample(fresh, frame)]

    def _sample(self, fresh: dict[int, bytes], frame: CanFrame) -> BoardEvent:
        bound = self._map
        self._advance(fresh)
        gyro = self._triad(bound.gyro, fresh)
        if gyro is None:
            return self._fault(FaultCause.CONTENT, frame)[0]
        accel = temperature = time = None
        if bound.accel is not None:
            accel = self._triad(bound.accel, fresh)
        if bound.temperature is not None:
            temperature = self._count(bound.temperature, fresh, _INT16)
        if bound.time is not None and bound.time.key in fresh:
            time = int(bound.time.signal.raw(fresh[bound.time.key]))
        sample = Sample(0, self._number & _NUMBER_MASK, time, gyro, accel, temperature)
        return FrameEvent(sample, frame.stamp_ns, 0, frame.data)

    def _advance(self, fresh: dict[int, bytes]) -> None:
        """Number the sample: by the board's counter where it has one."""
        counter = self._map.counter
        if counter is None or counter.key not in fresh:
            self._number += 1
            return
        count = int(counter.signal.raw(fresh[counter.key]))
        if self._last_counter is None:
            self._number = count
        else:
            self._number += (count - self._last_counter) % (1 << counter.signal.length)
        self._last_counter = count

    def _triad(
        self, axes: tuple[BoundSignal | None, ...], fresh: dict[int, bytes]
    ) -> Triple | None:
        """Return three counts, 0 for an axis that the sensor lacks; None where one is no value."""
        counts: list[int] = []
        for part in axes:
            count = 0 if part is None else self._count(part, fresh, _INT32)
            if count is None:
                return None
            counts.append(count)
        return counts[0], counts[1], counts[2]

    def _count(self, part: BoundSignal, fresh: dict[int, bytes], limit: int) -> int | None:
        data = fresh.get(part.key)
        if data is None:
            return None
        signal = part.signal
        raw = signal.raw(data)
        if self._map.check_range and signal.maximum > signal.minimum:
            value = raw * signal.factor + signal.offset
            slack = abs(signal.factor) / 2
            if not signal.minimum - slack <= value <= signal.maximum + slack:
                return None
        count = raw * part.factor + part.offset
        return round(count) if math.isfinite(count) and abs(count) <= limit else None

    def _message(self, key: int) -> int | None:
        """Return the map's key of a frame's: J1939 names a group and a sender."""
        source = self._map.source_address
        if source is None:
            return key if key in self._keys else None
        if not key & _EXTENDED or key & 0xFF != source:
            return None
        return self._groups.get(key & _J1939_GROUP)

    def _fault(self, cause: FaultCause, frame: CanFrame) -> list[BoardEvent]:
        self.faults[cause] += 1
        return [FrameFault(cause, frame.stamp_ns, 0, frame.data)]
