"""What a board says of itself, and how it is configured: the frames that carry JSON.

    HELLO  {"proto":1,"fw":"1.0.0","board":"uno","uid":"9f2c...","boot":12,"config":"1a2b3c4d",
            "sensors":[{"who":211,"fs":250,"odr":100,"bw":25,"lsb":0.00875,"unit":"dps"}]}
    SET    {"odr":200,"fs":500}
    ACK    {"config":"5e6f7a8b","odr":200,"bw":50,"fs":500,"batch":1,"accel":true}

A JSON text has at most 247 bytes, what fits into a frame. The decoder checks every type
and range; keys that it does not know are skipped, so that a newer board still says hello.
"""

from typing import Annotated, ClassVar, Literal

import msgspec

from gyrorig_protocol.board.wire import Frame

MAX_JSON_BYTES = 247
PROTOCOL = 1

Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64, pattern=r"^[ -~]*$")]
Text = Annotated[str, msgspec.Meta(max_length=64, pattern=r"^[ -~]*$")]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e12)]
Count = Annotated[int, msgspec.Meta(ge=0, le=2**32 - 1)]
Unit = Literal["dps", "rad/s", "g", "m/s2", "degC"]

_SENSOR_KEYS = {
    "full_scale": "fs",
    "rate_hz": "odr",
    "bandwidth_hz": "bw",
    "per_count": "lsb",
}


class Sensor(msgspec.Struct, frozen=True, rename=_SENSOR_KEYS, omit_defaults=True):
    """One sensor of a board, in the order of its values in SAMPLE: gyro, then accel.

    `who` is the value of its identity register (L3G4200D: 211) or the part's name.
    """

    who: Count | Name
    full_scale: Positive  # in `unit`
    per_count: Positive  # in `unit`, nominal
    rate_hz: Positive | None = None
    bandwidth_hz: Positive | None = None
    unit: Unit = "dps"


class Hello(Frame, frozen=True, gc=False, omit_defaults=True, rename={"protocol": "proto"}):
    """Who a board is. `uid` is the controller's unique number, not its port or name.

    `boot` counts starts; `config` is a hash of the configuration in force, and a change
    of it shows as a flag in the samples; `protocol` other than 1 is not this protocol.
    """

    protocol: Annotated[int, msgspec.Meta(ge=1, le=255)]
    fw: Text
    board: Text
    uid: Text  # "" where the board has none
    boot: Count
    sensors: Annotated[tuple[Sensor, ...], msgspec.Meta(min_length=1, max_length=4)]
    tick_hz: Positive = 1e6
    reset: Text = ""
    config: Text = ""

    TYPE: ClassVar[int] = 0x10

    def payload(self) -> bytes:
        """Return the payload without its check."""
        return bytes([self.TYPE]) + msgspec.json.encode(self)


_CONFIG_KEYS = {"rate_hz": "odr", "bandwidth_hz": "bw", "full_scale_dps": "fs"}


class Set(Frame, frozen=True, gc=False, omit_defaults=True, rename=_CONFIG_KEYS):
    """Ask a board for a configuration; what is None stays as it is."""

    rate_hz: Positive | None = None
    bandwidth_hz: Positive | None = None
    full_scale_dps: Positive | None = None
    batch: Annotated[int, msgspec.Meta(ge=1, le=39)] | None = None  # samples in a frame
    accel: bool | None = None

    TYPE: ClassVar[int] = 0x30

    def payload(self) -> bytes:
        """Return the payload without its check."""
        return bytes([self.TYPE]) + msgspec.json.encode(self)


class Ack(Frame, frozen=True, gc=False, omit_defaults=True, rename=_CONFIG_KEYS):
    """The configuration in force after a SET, whatever was asked for."""

    config: Text  # the hash, as in HELLO and from now on
    rate_hz: Positive | None = None
    bandwidth_hz: Positive | None = None
    full_scale_dps: Positive | None = None
    batch: Annotated[int, msgspec.Meta(ge=1, le=39)] | None = None
    accel: bool | None = None

    TYPE: ClassVar[int] = 0x31

    def payload(self) -> bytes:
        """Return the payload without its check."""
        return bytes([self.TYPE]) + msgspec.json.encode(self)
