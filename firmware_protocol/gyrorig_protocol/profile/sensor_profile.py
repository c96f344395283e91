"""The sensor profile document, `gyrorig/sensor/1`: data-sheet values with their source."""

from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.documents import convert_document, parse_yaml

SCHEMA = "gyrorig/sensor/1"

Positive = Annotated[float, msgspec.Meta(gt=0.0)]


class LowPassChoices(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The low-pass bandwidths that can be set at one output data rate (ODR)."""

    odr_hz: Positive
    bandwidth_hz: tuple[Positive, ...]


class FullScaleRange(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One full-scale range with its nominal sensitivity and its zero-rate limit."""

    full_scale_dps: Positive
    sensitivity_mdps: Positive
    zero_rate_dps: Positive | None = None


class SensorProfile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One gyroscope part; every value is from the data sheet named in `source`.

    Values that the data sheet does not give are left out. Tolerances are of both signs. Ratios
    refer to the nominal value, or to full scale (`nonlinearity`).
    """

    sensor: str
    source: str
    ranges: tuple[FullScaleRange, ...]
    schema: Literal["gyrorig/sensor/1"] = "gyrorig/sensor/1"
    low_pass: tuple[LowPassChoices, ...] = ()
    noise_density_dps_rthz: Positive | None = None
    zero_rate_dps: Positive | None = None
    zero_rate_per_kelvin_dps: Positive | None = None
    bias_instability_dps_h: Positive | None = None
    scale_tolerance: Positive | None = None
    scale_per_kelvin: Positive | None = None
    scale_over_temperature: Positive | None = None  # over the whole temperature range
    nonlinearity: Positive | None = None
    g_sensitivity_dps_g: Positive | None = None
    odr_tolerance: Positive | None = None  # of the output data rate, relative to the nominal one
    cross_axis: Positive | None = None
    temperature_scale_c: float | None = None
    temperature_offset_c: float | None = None

    def zero_rate_limit_dps(self, full_scale_dps: float | None) -> float | None:
        """Return the zero-rate limit in deg/s of a full-scale range, else that of the part.

        Args:
            full_scale_dps: the board's setting, None if unknown.
        """
        for full_scale_range in self.ranges:
            if (
                full_scale_range.full_scale_dps == full_scale_dps
                and full_scale_range.zero_rate_dps is not None
            ):
                return full_scale_range.zero_rate_dps
        return self.zero_rate_dps


def parse_profile(text: str | bytes, name: str) -> SensorProfile:
    """Parse the YAML document of a sensor profile.

    Raises:
        UsageError: the document is not a profile; the text gives the place and the reason.
    """
    return convert_document(parse_yaml(text, name, schema=SCHEMA), SensorProfile, name)
