"""GCB1 frames that contain JSON: a board's identity and its configuration.

    HELLO  {"proto":1,"fw":"1.0.0","board":"uno","uid":"9f2c...","boot":12,"config":"1a2b3c4d",
            "sensors":[{"who":211,"fs":250,"odr":100,"bw":25,"lsb":0.00875,"unit":"dps"}]}
    SET    {"odr":200,"fs":500}
    ACK    {"config":"5e6f7a8b","odr":200,"bw":50,"fs":500,"batch":1,"accel":true}

A JSON text has at most 247 bytes, the space in a frame. The decoder checks every type and range.
It skips unknown keys, so that a newer board can still identify itself.
"""

from typing import Annotated, ClassVar, Literal

import msgspec

from gyrorig_protocol.board.frame_encoding import Frame

PROTOCOL_VERSION = 1

Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64, pattern=r"^[ -~]*$")]
Text = Annotated[str, msgspec.Meta(max_length=64, pattern=r"^[ -~]*$")]
Positive = Annotated[float, msgspec.Meta(ge=1e-12, le=1e12)]  # quotients of two are finite
Count = Annotated[int, msgspec.Meta(ge=0, le=2**32 - 1)]
Unit = Literal["dps", "rad/s", "g", "m/s2", "degC"]

_SENSOR_KEYS = {
    "full_scale": "fs",
    "rate_hz": "odr",
    "bandwidth_hz": "bw",
    "per_count": "lsb",
}


class Sensor(msgspec.Struct, frozen=True, rename=_SENSOR_KEYS, omit_defaults=True):
    """One sensor of a board. The order is that of the values in SAMPLE: gyro, then accel.

    `who` is the value of its identity register (211 for an L3G4200D) or the part's name.
    """

    who: Count | Name
    full_scale: Positive  # in `unit`
    per_count: Positive  # in `unit`, nominal
    rate_hz: Positive | None = None
    bandwidth_hz: Positive | None = None
    unit: Unit = "dps"


class Hello(Frame, frozen=True, gc=False, omit_defaults=True, rename={"protocol": "proto"}):
    """The identity of a board. `uid` is the controller's unique number, not its port or name.

    `boot` counts starts. `config` is a hash of the current configuration; a flag in the samples
    shows a change. A `protocol` other than 1 is another protocol.
    """

    protocol: Annotated[int, msgspec.Meta(ge=1, le=255)]
    fw: Text
    board: Text
    uid: Text  # "" if the board has none
    boot: Count
    sensors: Annotated[tuple[Sensor, ...], msgspec.Meta(min_length=1, max_length=4)]
    tick_hz: Positive = 1e6
    reset: Text = ""
    config: Text = ""

    TYPE: ClassVar[int] = 0x10

    def encode_payload(self) -> bytes:
        """Return the payload without its check."""
        return bytes([self.TYPE]) + msgspec.json.encode(self)


_CONFIG_KEYS = {"rate_hz": "odr", "bandwidth_hz": "bw", "full_scale_dps": "fs"}


class Set(Frame, frozen=True, gc=False, omit_defaults=True, rename=_CONFIG_KEYS):
    """A request to change the configuration; fields that are None keep their value."""

    rate_hz: Positive | None = None
    bandwidth_hz: Positive | None = None
    full_scale_dps: Positive | None = None
    batch: Annotated[int, msgspec.Meta(ge=1, le=39)] | None = None  # samples per frame
    accel: bool | None = None

    TYPE: ClassVar[int] = 0x30

    def encode_payload(self) -> bytes:
        """Return the payload without its check."""
        return bytes([self.TYPE]) + msgspec.json.encode(self)


class Ack(Frame, frozen=True, gc=False, omit_defaults=True, rename=_CONFIG_KEYS):
    """The configuration after a SET, which can differ from the requested one."""

    config: Text  # the new hash, as in HELLO
    rate_hz: Positive | None = None
    bandwidth_hz: Positive | None = None
    full_scale_dps: Positive | None = None
    batch: Annotated[int, msgspec.Meta(ge=1, le=39)] | None = None
    accel: bool | None = None

    TYPE: ClassVar[int] = 0x31

    def encode_payload(self) -> bytes:
        """Return the payload without its check."""
        return bytes([self.TYPE]) + msgspec.json.encode(self)
