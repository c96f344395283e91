"""The board's serial frames, GCB1: what they hold, one frozen record each.

The first byte of a payload is its type; `wire` says how a payload goes over the wire.

    type  name           after the type byte (struct notation, little-endian)
    0x01  SAMPLE         B flags, H sequence, I t, 3h gyro, 3h accel, h temperature
    0x02  BATCH          B flags, H sequence of the first, I t of the last, B n,
                         n times 3h gyro (or 3h gyro, 3h accel), h temperature
    0x03  SLOW           Q t, H boot, I sequence, 4I counters (sensor overruns, frames
                         dropped, bus errors, saturations), h temperature, h air
                         temperature in 0.1 degC (-32768 absent), H supply in mV (0 absent)
    0x04  EDGE           Q t, B input, B polarity (1 rising, 0 falling)
    0x10  HELLO          JSON, see `hello`; from the host, without JSON: "say it"
    0x20  TIME request   I nonce, Q host stamp
    0x21  TIME reply     I nonce, Q host stamp as sent, Q received at, Q sent at
    0x30  SET            JSON, see `hello`
    0x31  ACK            JSON, see `hello`

t counts the board's ticks (HELLO's `tick_hz`, nominally microseconds): 32 bits wrap
after 71.6 min, the 64 bits of SLOW, EDGE and TIME do not. `sequence` counts the sensor's
samples, not frames. An unknown type is skipped and counted; new fields come only as new
types.

What to use when: build a record and write its `encode()`; `decode.decode_payload` is the
way back.
"""

import struct
from enum import IntFlag
from typing import ClassVar, TypeAlias

from gyrorig_protocol.board.wire import Frame
from gyrorig_protocol.errors import UsageError

Triple: TypeAlias = tuple[int, int, int]

SAMPLE_LAYOUT = struct.Struct("<BBHI7h")
BATCH_HEAD_LAYOUT = struct.Struct("<BBHIB")
SLOW_LAYOUT = struct.Struct("<BQHI4IhhH")
EDGE_LAYOUT = struct.Struct("<BQBB")
TIME_REQUEST_LAYOUT = struct.Struct("<BIQ")
TIME_REPLY_LAYOUT = struct.Struct("<BIQQQ")
NO_AIR_TEMPERATURE = -32768


class SampleFlag(IntFlag):
    """What a board says about a sample; the bits are those of a recording's status."""

    OVERRUN = 1
    SATURATED = 2
    STAMPED_AT_DATA_READY = 4
    REPEATED = 8
    STAMP_FROM_FIFO = 16
    CONFIGURATION_CHANGED = 32
    FRAMES_DROPPED = 64
    CLOCK_DISCIPLINED = 128


class Sample(Frame, frozen=True, gc=False):
    """One sample, raw counts in the sensor's own axes.

    `accel`, `temperature` and `device_time` are None where the source has none; a SAMPLE
    frame always has them, and carries zeros for None.
    """

    flags: int
    sequence: int
    device_time: int | None
    gyro: Triple
    accel: Triple | None = None
    temperature: int | None = None

    TYPE: ClassVar[int] = 0x01

    def payload(self) -> bytes:
        """Return the payload without its check."""
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
    """Several samples with one stamp, that of the last."""

    flags: int
    sequence: int  # of the first sample
    device_time: int  # of the last sample
    gyro: tuple[Triple, ...]
    accel: tuple[Triple, ...] | None  # None in the three-axis form
    temperature: int

    TYPE: ClassVar[int] = 0x02

    def payload(self) -> bytes:
        """Return the payload without its check."""
        count = len(self.gyro)
        if not count or (self.accel is not None and len(self.accel) != count):
            raise UsageError(f"a batch of {count} samples", "give as many of each, at least one")
        if self.accel is None:
            flat = [number for row in self.gyro for number in row]
        else:
            pairs = zip(self.gyro, self.accel, strict=True)
            flat = [number for gyro, accel in pairs for number in (*gyro, *accel)]
        head = BATCH_HEAD_LAYOUT.pack(self.TYPE, self.flags, self.sequence, self.device_time, count)
        return head + struct.pack(f"<{len(flat)}hh", *flat, self.temperature)

    def samples(self, period_ticks: float) -> list[Sample]:
        """Return the samples one by one, in order.

        The stamps of all but the last are computed from the period and say so by
        `STAMP_FROM_FIFO`; they wrap as the board's counter does.

        Args:
            period_ticks: ticks between two samples, from HELLO's rates.
        """
        last = len(self.gyro) - 1
        derived = self.flags | SampleFlag.STAMP_FROM_FIFO
        return [
            Sample(
                self.flags if at == last else int(derived),
                (self.sequence + at) & 0xFFFF,
                (self.device_time - round((last - at) * period_ticks)) & 0xFFFF_FFFF,
                gyro,
                None if self.accel is None else self.accel[at],
                self.temperature,
            )
            for at, gyro in enumerate(self.gyro)
        ]


class Slow(Frame, frozen=True, gc=False):
    """Once to ten times a second: the unwrapped clock, and what went wrong so far."""

    device_time: int
    boot: int
    sequence: int
    sensor_overruns: int
    frames_dropped: int
    bus_errors: int
    saturations: int
    temperature: int  # as the sensor gives it
    air_temperature_decidegc: int | None
    supply_mv: int | None

    TYPE: ClassVar[int] = 0x03

    def payload(self) -> bytes:
        """Return the payload without its check."""
        air = self.air_temperature_decidegc
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
            NO_AIR_TEMPERATURE if air is None else air,
            self.supply_mv or 0,
        )


class Edge(Frame, frozen=True, gc=False):
    """An edge at a pin: a synchronisation line, a second pulse, an index mark."""

    device_time: int
    input: int
    rising: bool

    TYPE: ClassVar[int] = 0x04

    def payload(self) -> bytes:
        """Return the payload without its check."""
        return EDGE_LAYOUT.pack(self.TYPE, self.device_time, self.input, self.rising)


class HelloRequest(Frame, frozen=True, gc=False):
    """Ask a board for its HELLO: after opening, and after 2 s of silence."""

    TYPE: ClassVar[int] = 0x10


class TimeRequest(Frame, frozen=True, gc=False):
    """Ask a board for its clock. The nonce tells a late reply from this one's."""

    nonce: int
    host_stamp: int

    TYPE: ClassVar[int] = 0x20

    def payload(self) -> bytes:
        """Return the payload without its check."""
        return TIME_REQUEST_LAYOUT.pack(self.TYPE, self.nonce, self.host_stamp)


class TimeReply(Frame, frozen=True, gc=False):
    """A board's clock when the request came and when this reply left, in ticks."""

    nonce: int
    host_stamp: int
    device_receive: int
    device_send: int

    TYPE: ClassVar[int] = 0x21

    def payload(self) -> bytes:
        """Return the payload without its check."""
        return TIME_REPLY_LAYOUT.pack(
            self.TYPE, self.nonce, self.host_stamp, self.device_receive, self.device_send
        )
