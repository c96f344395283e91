"""The frames of the GCB1 serial protocol and their fields.

The first byte of a payload is its type; `frame_encoding` adds the checksum and the delimiters.

    type  name           after the type byte (struct notation, little-endian)
    0x01  SAMPLE         B flags, H sequence, I t, 3h gyro, 3h accel, h temperature
    0x02  BATCH          B flags, H sequence of the first, I t of the last, B n,
                         n times 3h gyro (or 3h gyro, 3h accel), h temperature
    0x03  SLOW           Q t, H boot, I sequence, 4I counters (sensor overruns, frames
                         dropped, bus errors, saturations), h temperature, h air
                         temperature in 0.1 degC (-32768 absent), H supply in mV (0 absent)
    0x04  EDGE           Q t, B input, B polarity (1 rising, 0 falling)
    0x10  HELLO          JSON, see `json_frames`; from the host, without JSON, a request
    0x20  TIME request   I nonce, Q host timestamp
    0x21  TIME reply     I nonce, Q host timestamp as sent, Q received at, Q sent at
    0x30  SET            JSON, see `json_frames`
    0x31  ACK            JSON, see `json_frames`

t counts the board's ticks (`tick_hz` of HELLO, nominally microseconds). 32 bits wrap after
71.6 min; the 64 bits of SLOW, EDGE and TIME do not wrap. `sequence` counts the sensor's samples,
not the frames. Unknown types are skipped and counted; new fields get new types.

What to use when: build a frame and send its `encode()`; `payload_decoder.decode_payload` is the
inverse.
"""

import struct
from enum import IntFlag
from typing import ClassVar, TypeAlias

from gyrorig_protocol.board.frame_encoding import Frame
from gyrorig_protocol.errors import UsageError

Triple: TypeAlias = tuple[int, int, int]

SAMPLE_LAYOUT = struct.Struct("<BBHI7h")
BATCH_HEAD_LAYOUT = struct.Struct("<BBHIB")
SLOW_LAYOUT = struct.Struct("<BQHI4IhhH")
EDGE_LAYOUT = struct.Struct("<BQBB")
TIME_REQUEST_LAYOUT = struct.Struct("<BIQ")
TIME_REPLY_LAYOUT = struct.Struct("<BIQQQ")
NO_AIR_TEMPERATURE_DECIDEGC = -32768


class SampleFlag(IntFlag):
    """Status bits of a sample; bits 0 to 7 of the status in a recording."""

    OVERRUN = 1
    SATURATED = 2
    STAMPED_AT_DATA_READY = 4
    REPEATED = 8
    STAMP_FROM_FIFO = 16
    CONFIGURATION_CHANGED = 32
    FRAMES_DROPPED = 64
    CLOCK_DISCIPLINED = 128


class Sample(Frame, frozen=True, gc=False):
    """One sample: raw counts in the sensor's axes.

    `accel`, `temperature` and `device_time` are None if the source has none. A SAMPLE frame
    always has these fields and contains zeros for None.
    """

    flags: int
    sequence: int
    device_time: int | None
    gyro: Triple
    accel: Triple | None = None
    temperature: int | None = None

    TYPE: ClassVar[int] = 0x01

    def encode_payload(self) -> bytes:
        """Return the payload without its checksum."""
        return SAMPLE_LAYOUT.pack(
            self.TYPE,
            self.flags,
            self.sequence,
            self.device_time or 0,
            *self.gyro,
            *(self.accel or (0, 0, 0)),
            self.temperature or 0,
        )


class Batch(Frame, frozen=True, gc=False):
    """Several samples with one timestamp, that of the last sample."""

    flags: int
    sequence: int  # of the first sample
    device_time: int  # of the last sample
    gyro: tuple[Triple, ...]
    accel: tuple[Triple, ...] | None  # None in the three-axis form
    temperature: int

    TYPE: ClassVar[int] = 0x02

    def encode_payload(self) -> bytes:
        """Return the payload without its checksum."""
        count = len(self.gyro)
        if not count or (self.accel is not None and len(self.accel) != count):
            raise UsageError(
                f"a batch frame of a board has {count} angular rates, but a different number "
                "of accelerations",
                "give at least one sample, and as many accelerations as angular rates",
            )
        if self.accel is None:
            values = [number for triple in self.gyro for number in triple]
        else:
            pairs = zip(self.gyro, self.accel, strict=True)
            values = [number for gyro, accel in pairs for number in (*gyro, *accel)]
        head = BATCH_HEAD_LAYOUT.pack(self.TYPE, self.flags, self.sequence, self.device_time, count)
        return head + struct.pack(f"<{len(values)}hh", *values, self.temperature)

    def to_samples(self, period_ticks: float) -> list[Sample]:
        """Return the single samples in order.

        All timestamps except the last are computed from the period and have the flag
        `STAMP_FROM_FIFO`; they wrap as the board's counter does.

        Args:
            period_ticks: ticks between two samples, from the rates in HELLO.
        """
        last_index = len(self.gyro) - 1
        fifo_flags = self.flags | SampleFlag.STAMP_FROM_FIFO
        return [
            Sample(
                self.flags if index == last_index else int(fifo_flags),
                (self.sequence + index) & 0xFFFF,
                (self.device_time - round((last_index - index) * period_ticks)) & 0xFFFF_FFFF,
                gyro,
                None if self.accel is None else self.accel[index],
                self.temperature,
            )
            for index, gyro in enumerate(self.gyro)
        ]


class Slow(Frame, frozen=True, gc=False):
    """The unwrapped clock and the error counters, sent 1 to 10 times per second."""

    device_time: int
    boot: int
    sequence: int
    sensor_overruns: int
    frames_dropped: int
    bus_errors: int
    saturations: int
    temperature: int  # raw
    air_temperature_decidegc: int | None
    supply_mv: int | None

    TYPE: ClassVar[int] = 0x03

    def encode_payload(self) -> bytes:
        """Return the payload without its checksum."""
        air_decidegc = self.air_temperature_decidegc
        return SLOW_LAYOUT.pack(
            self.TYPE,
            self.device_time,
            self.boot,
            self.sequence,
            self.sensor_overruns,
            self.frames_dropped,
            self.bus_errors,
            self.saturations,
            self.temperature,
            NO_AIR_TEMPERATURE_DECIDEGC if air_decidegc is None else air_decidegc,
            self.supply_mv or 0,
        )


class Edge(Frame, frozen=True, gc=False):
    """An edge at an input pin: a synchronisation line, a pulse per second, an index mark."""

    device_time: int
    input: int
    rising: bool

    TYPE: ClassVar[int] = 0x04

    def encode_payload(self) -> bytes:
        """Return the payload without its checksum."""
        return EDGE_LAYOUT.pack(self.TYPE, self.device_time, self.input, self.rising)


class HelloRequest(Frame, frozen=True, gc=False):
    """A request for a board's HELLO, sent after opening the port and after 2 s of silence."""

    TYPE: ClassVar[int] = 0x10


class TimeRequest(Frame, frozen=True, gc=False):
    """A request for a board's clock. The nonce identifies the reply to this request."""

    nonce: int
    host_stamp: int

    TYPE: ClassVar[int] = 0x20

    def encode_payload(self) -> bytes:
        """Return the payload without its checksum."""
        return TIME_REQUEST_LAYOUT.pack(self.TYPE, self.nonce, self.host_stamp)


class TimeReply(Frame, frozen=True, gc=False):
    """A board's clock when it received the request and when it sent this reply, in ticks."""

    nonce: int
    host_stamp: int
    device_receive: int
    device_send: int

    TYPE: ClassVar[int] = 0x21

    def encode_payload(self) -> bytes:
        """Return the payload without its checksum."""
        return TIME_REPLY_LAYOUT.pack(
            self.TYPE, self.nonce, self.host_stamp, self.device_receive, self.device_send
        )
