"""Parser of other IMUs' CAN frames, by a resolved signal map.

A sample is complete when all messages with its rates have arrived. Accelerations, temperature, time
and counter are the newest that arrived since the previous sample; those that are sent after the
rates therefore belong to the previous sample. If a message arrives twice before the others, one of
them was lost: the incomplete sample is dropped and its number is skipped, so that the loss shows as
a gap.

Contract: received bytes never raise an error. An invalid value gives a `FrameFault` event and is
counted by cause.
"""

import math

from gyrorig_protocol.board.board_events import BoardEvent, FaultCause, FrameEvent, FrameFault
from gyrorig_protocol.board.board_frames import Sample, Triple
from gyrorig_protocol.can.can_frame import CanFrame
from gyrorig_protocol.can.signal_map import ResolvedSignal, ResolvedSignalMap

_INT32, _INT16 = 2**31 - 1, 2**15 - 1
_NUMBER_MASK = 0xFFFF_FFFF
_EXTENDED_BIT = 1 << 31
_J1939_GROUP_MASK = 0x03FF_FF00  # without priority and source address


class CanSignalParser:
    """Parse the frames of one IMU into events."""

    def __init__(self, signal_map: ResolvedSignalMap) -> None:
        self._map = signal_map
        self._rate_keys = {signal.key for signal in signal_map.gyro if signal is not None}
        self._keys = dict.fromkeys(signal_map.needed_bytes)
        self._groups = {
            key & _J1939_GROUP_MASK: key for key in signal_map.needed_bytes if key & _EXTENDED_BIT
        }
        self._messages_since_sample: dict[int, bytes] = {}  # messages since the last sample
        self._sample_number = -1
        self._last_counter: int | None = None
        self._counted_number = 0  # of the sample with the last counter
        self.frames = 0
        self.faults = dict.fromkeys(FaultCause, 0)

    def wants(self, key: int) -> bool:
        """Return whether frames of this key (`CanFrame.key`) are this IMU's."""
        return self._message_key(key) is not None

    def reset(self) -> None:
        """Drop an unfinished sample, for example after the bus was disconnected."""
        self._messages_since_sample.clear()

    def feed(self, frame: CanFrame) -> list[BoardEvent]:
        """Return the events that a frame completes."""
        key = self._message_key(frame.key)
        if key is None or not frame.is_data_frame:
            return self._report_fault(FaultCause.UNKNOWN_TYPE, frame)
        if len(frame.data) < self._map.needed_bytes[key]:
            return self._report_fault(FaultCause.LENGTH, frame)
        self.frames += 1
        if key in self._rate_keys and key in self._messages_since_sample:
            self._sample_number += 1
            self._messages_since_sample = {}
        self._messages_since_sample[key] = frame.data
        if not self._rate_keys <= self._messages_since_sample.keys():
            return []
        messages, self._messages_since_sample = self._messages_since_sample, {}
        return [self._make_sample(messages, frame)]

    def _make_sample(self, messages: dict[int, bytes], frame: CanFrame) -> BoardEvent:
        signal_map = self._map
        self._advance_sample_number(messages)
        gyro = self._read_triad(signal_map.gyro, messages)
        if gyro is None:
            return self._report_fault(FaultCause.CONTENT, frame)[0]
        accel = temperature = time_ticks = None
        if signal_map.accel is not None:
            accel = self._read_triad(signal_map.accel, messages)
        if signal_map.temperature is not None:
            temperature = self._read_count(signal_map.temperature, messages, _INT16)
        if signal_map.time is not None:
            if signal_map.time.key not in messages:  # a sample without a time has no use
                return self._report_fault(FaultCause.CONTENT, frame)[0]
            time_ticks = int(signal_map.time.signal.raw_value(messages[signal_map.time.key]))
        sample = Sample(0, self._sample_number & _NUMBER_MASK, time_ticks, gyro, accel, temperature)
        return FrameEvent(sample, frame.timestamp_ns, 0, frame.data)

    def _advance_sample_number(self, messages: dict[int, bytes]) -> None:
        """Advance the sample number, by the board's counter if it has one."""
        counter = self._map.counter
        if counter is None or counter.key not in messages:
            self._sample_number += 1
            return
        count = int(counter.signal.raw_value(messages[counter.key]))
        if self._last_counter is None:
            self._sample_number = count
        else:
            # Samples without a counter since then have advanced the number by themselves.
            step = (count - self._last_counter) % (1 << counter.signal.bit_length)
            self._sample_number = self._counted_number + step
        self._last_counter, self._counted_number = count, self._sample_number

    def _read_triad(
        self, axes: tuple[ResolvedSignal | None, ...], messages: dict[int, bytes]
    ) -> Triple | None:
        """Return three counts, 0 for an axis that the sensor lacks; None if one is invalid."""
        counts: list[int] = []
        for signal in axes:
            count = 0 if signal is None else self._read_count(signal, messages, _INT32)
            if count is None:
                return None
            counts.append(count)
        return counts[0], counts[1], counts[2]

    def _read_count(
        self, resolved: ResolvedSignal, messages: dict[int, bytes], limit: int
    ) -> int | None:
        data = messages.get(resolved.key)
        if data is None:
            return None
        signal = resolved.signal
        raw = signal.raw_value(data)
        if self._map.check_range and signal.maximum > signal.minimum:
            value = raw * signal.factor + signal.offset
            tolerance = abs(signal.factor) / 2
            if not signal.minimum - tolerance <= value <= signal.maximum + tolerance:
                return None
        count = raw * resolved.factor + resolved.offset
        return round(count) if math.isfinite(count) and abs(count) <= limit else None

    def _message_key(self, key: int) -> int | None:
        """Return the key of the message in the map; a J1939 key has a group and a sender."""
        source_address = self._map.source_address
        if source_address is None:
            return key if key in self._keys else None
        if not key & _EXTENDED_BIT or key & 0xFF != source_address:
            return None
        return self._groups.get(key & _J1939_GROUP_MASK)

    def _report_fault(self, cause: FaultCause, frame: CanFrame) -> list[BoardEvent]:
        self.faults[cause] += 1
        return [FrameFault(cause, frame.timestamp_ns, 0, frame.data)]
