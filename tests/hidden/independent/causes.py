"""Causes of the catalogue in this simulator: from one size to all parameters.

What to use when: `HIDEABLE` for the names; `draw_hiding` for a cause; `Hiding.make_values` for its
parameters at a size; `Hiding.describe_parameters` for the same parameters in the answer.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from tests.bench.rigs.prior_sizes import AXES, PRIOR_SIZES, XYZ, Detail

from gyrorig_daemon.emulator.injection import CAUSES

ALONG = (
    "scale_quadratic", "scale_cubic", "scale_asymmetry", "vibration_rectification",
    "motor_coupling", "thermal_bias", "thermal_scale", "warm_up", "bias_ramp", "bias_step",
    "supply_hum",
)  # fmt: skip
ALL_AXES = ("dead_zone",)
UNIT_BOTH = ("acceleration_error", "base_speed_jump", "s_curve")
UNIT_ONE = (
    "backlash", "lost_steps", "eccentricity", "worm_error", "step_resolution", "ringing",
    "base_compliance",
)  # fmt: skip
COUNTED = ("lost_samples", "repeated_samples", "corrupt_samples")
IN_VARIANCE = ("sample_jitter",)
# No session shows the first two. Every part has a bias random walk, so no level of it is a cause.
NOT_HIDDEN = ("earth_rotation", "tilt_zero", "bias_random_walk")
HIDEABLE = tuple(
    prior.cause for prior in PRIOR_SIZES if prior.cause in CAUSES and prior.cause not in NOT_HIDDEN
)
_DETAILS: Mapping[str, tuple[Detail, ...]] = {prior.cause: prior.details for prior in PRIOR_SIZES}
EVENT = (0.35, 0.65)  # time of an event, as a share of the recording

# The name of each size in the answer.
STATED_NAMES: Mapping[str, str] = {
    "acceleration_error": "relative_error", "axis_nonorthogonality": "angle", "backlash": "gap",
    "base_compliance": "compliance", "base_speed_jump": "added", "bias_ramp": "slope",
    "bias_step": "step", "clock_skew": "lag_growth", "clock_step": "step", "dead_zone": "width",
    "eccentricity": "first", "low_pass_lag": "cutoff_change", "lost_steps": "steps",
    "motor_coupling": "bias", "ringing": "share", "s_curve": "window", "sample_jitter": "rms",
    "saturation": "limit", "scale_asymmetry": "share", "scale_cubic": "coefficient",
    "scale_quadratic": "coefficient", "step_resolution": "relative_error",
    "supply_hum": "amplitude", "thermal_bias": "slope", "thermal_scale": "share_per_k",
    "tilt_sag": "amplitude", "vibration_rectification": "coefficient", "warm_up": "at_power_up",
    "worm_error": "amplitude",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Hiding:
    """One cause of a rig: its place and all parameters except its size.

    Attributes:
        pattern: the sizes at each place for a size of 1.
        details: the drawn parameters other than the size.
    """

    cause: str
    place: str
    sign: float
    pattern: Mapping[str, float]
    details: Mapping[str, float]

    def make_values(self, size: float, full_scale_rad_s: float) -> dict[str, float]:
        """Return the parameters of the cause for `HiddenCauses`."""
        if self.cause == "saturation":
            amount = 1.0 - size / full_scale_rad_s
        elif self.cause == "low_pass_lag":
            amount = float(np.log1p(self.sign * size))
        elif self.cause == "axis_nonorthogonality":
            amount = -self.sign * size  # the answer has the other sign
        else:
            amount = self.sign * size
        return {**{name: share * amount for name, share in self.pattern.items()}, **self.details}

    def describe_parameters(self, size: float) -> dict[str, dict[str, object]]:
        """Return the parameters for the answer."""
        unit, amount = CAUSES[self.cause].unit, self.sign * size
        if self.cause == "g_sensitivity":
            return {
                name: _make_quantity(share * amount, unit) for name, share in self.pattern.items()
            }
        parameters: dict[str, dict[str, object]] = {}
        name = STATED_NAMES.get(self.cause)
        if name is not None:
            vector = [self.pattern.get(axis, 0.0) * amount for axis in XYZ]
            parameters[name] = _make_quantity(vector if self.cause in ALONG else amount, unit)
        for detail, value in self.details.items():
            parameters[detail] = _make_quantity(value, "")
        phase = self.details.get(f"{self.place}_phase", self.details.get("phase"))
        if phase is not None:
            parameters["first_phase" if self.cause == "eccentricity" else "phase"] = _make_quantity(
                phase, "rad"
            )
        return parameters


def draw_hiding(cause: str, rng: np.random.Generator) -> Hiding:
    """Return a cause with a random place, sign, pattern and details."""
    details = {detail.name: detail.draw(rng) for detail in _DETAILS[cause]}
    if "at" in details:
        details["at"] = float(rng.uniform(*EVENT))
    if cause == "tilt_sag":
        details["phase"] = float(rng.uniform(-0.25, 0.25) * np.pi)
    sign = float(rng.choice((-1.0, 1.0))) if CAUSES[cause].is_signed else 1.0
    if cause == "supply_hum":
        sign = 1.0
    place, pattern = _draw_pattern(cause, rng)
    return Hiding(cause, place, sign, pattern, details)


def _draw_pattern(cause: str, rng: np.random.Generator) -> tuple[str, dict[str, float]]:
    """Return the place of a cause and its sizes there for a size of 1."""
    place = "tilt" if cause in ("tilt_sag", "axis_nonorthogonality") else "all"
    sizes = {"size": 1.0}
    if cause in ALONG or cause == "board_slip":
        drawn = rng.standard_normal(3)
        drawn /= np.linalg.norm(drawn) if cause == "board_slip" else np.abs(drawn).max()
        sizes = {axis: float(value) for axis, value in zip(XYZ, drawn, strict=True)}
    elif cause == "g_sensitivity":
        rows = rng.standard_normal((3, 3))
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        names = [f"{row}{column}" for row in XYZ for column in XYZ]
        sizes = {name: float(value) for name, value in zip(names, rows.ravel(), strict=True)}
    elif cause in ALL_AXES:
        place, sizes = "x, y, z", dict.fromkeys(XYZ, 1.0)
    elif cause in UNIT_BOTH:
        place, sizes = "pan, tilt", dict.fromkeys(AXES, 1.0)
    elif cause in UNIT_ONE:
        place = str(rng.choice(CAUSES[cause].components))
        sizes = {place: 1.0}
    return place, sizes


def _make_quantity(value: float | list[float], unit: str) -> dict[str, object]:
    return {"value": value, "unit": unit}
