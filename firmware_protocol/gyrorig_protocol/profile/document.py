"""The sensor profile's document, `gyrorig/sensor/1`: figures with their source."""

from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.documents import parse_yaml, read_as

Positive = Annotated[float, msgspec.Meta(gt=0.0)]


class Bandwidth(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The low-pass choices at one output data rate."""

    odr_hz: Positive
    bandwidth_hz: tuple[Positive, ...]


class Range(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One full-scale setting, its nominal sensitivity, and its own limit of the zero rate."""

    full_scale_dps: Positive
    sensitivity_mdps: Positive
    zero_rate_dps: Positive | None = None


class SensorProfile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One gyroscope part: every figure from the data sheet named in `source`.

    What the data sheet does not say is left out. Tolerances are of both signs; shares are
    of the nominal value, or of full scale (`nonlinearity`).
    """

    sensor: str
    source: str
    ranges: tuple[Range, ...]
    schema: Literal["gyrorig/sensor/1"] = "gyrorig/sensor/1"
    low_pass: tuple[Bandwidth, ...] = ()
    noise_density_dps_rthz: Positive | None = None
    zero_rate_dps: Positive | None = None
    zero_rate_per_kelvin_dps: Positive | None = None
    bias_instability_dps_h: Positive | None = None
    scale_tolerance: Positive | None = None
    scale_per_kelvin: Positive | None = None
    scale_over_temperature: Positive | None = None  # over the part's whole range
    nonlinearity: Positive | None = None
    g_sensitivity_dps_g: Positive | None = None
    odr_tolerance: Positive | None = None  # of the output rate beside its nominal one
    cross_axis: Positive | None = None
    temperature_scale_c: float | None = None
    temperature_offset_c: float | None = None

    def zero_rate_at(self, full_scale_dps: float | None) -> float | None:
        """Return the zero-rate limit in deg/s at a full scale; the part's where none is stated.

        Args:
            full_scale_dps: what the board is set to, None where it does not say.
        """
        for entry in self.ranges:
            if entry.full_scale_dps == full_scale_dps and entry.zero_rate_dps is not None:
                return entry.zero_rate_dps
        return self.zero_rate_dps


def parse_profile(text: str | bytes, name: str) -> SensorProfile:
    """Return the sensor profile that a YAML document describes.

    Raises:
        UsageError: the document is not a profile; the text says where and why.
    """
    return read_as(parse_yaml(text, name), SensorProfile, name)
