"""Prior sizes of the causes that a rig can have, each with its source.

The table is independent of the solver's: the sizes come from data sheets, manuals and published
measurements. Where no source states a figure, the entry says "judgement" and from what it follows.
A size is normal with zero mean, or half normal where the cause has one sign.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

DEG = float(np.radians(1.0))
G_M_S2 = 9.80665
XYZ = ("x", "y", "z")
AXES = ("pan", "tilt")
LOST_STEP_CYCLE = 8.0  # half steps: the rotor falls back by whole cycles of four full steps


@dataclass(frozen=True, slots=True)
class Detail:
    """A property of a cause besides its size, drawn uniformly."""

    name: str
    low: float
    high: float
    is_log: bool = False

    def draw(self, rng: np.random.Generator) -> float:
        """Return a value."""
        if self.is_log:
            return float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))
        return float(rng.uniform(self.low, self.high))


@dataclass(frozen=True, slots=True)
class PriorSize:
    """How large a cause is: a normal or half normal size at each place.

    Attributes:
        places: names of the sizes. Of pan and tilt, one or both have the cause.
    """

    cause: str
    scale: float
    unit: str
    source: str
    places: tuple[str, ...] = ("size",)
    is_half: bool = False
    details: tuple[Detail, ...] = ()

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Return sizes and details by name."""
        places = list(self.places)
        if self.places == AXES:
            chosen = rng.choice(len(AXES), size=int(rng.integers(1, 3)), replace=False)
            places = [AXES[k] for k in sorted(int(k) for k in chosen)]
        sizes = {place: float(rng.normal(scale=self.scale)) for place in places}
        if self.is_half:
            sizes = {place: abs(size) for place, size in sizes.items()}
        return {**sizes, **{detail.name: detail.draw(rng) for detail in self.details}}


@dataclass(frozen=True, slots=True)
class HiddenCauses:
    """The causes of one rig: sizes and details by cause and name."""

    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def get(self, cause: str, name: str = "size") -> float:
        """Return a size or a detail; 0 where the rig does not have the cause."""
        return float(self.values.get(cause, {}).get(name, 0.0))

    def of_axes(self, cause: str) -> np.ndarray:
        """Return the sizes on x, y and z, shape (3,)."""
        return np.array([self.get(cause, axis) for axis in XYZ])


_EVENT = Detail("at", 0.15, 0.85)  # share of the recording
_PHASE = (Detail("pan_phase", 0.0, 2 * np.pi), Detail("tilt_phase", 0.0, 2 * np.pi))
_G_NAMES = tuple(f"{a}{b}" for a in XYZ for b in XYZ)

PRIOR_SIZES = (
    # Clocks and link
    PriorSize("clock_skew", 3e-5, "1", "quartz crystals, 20 to 50 ppm"),
    PriorSize(
        "clock_step", 5e-3, "s", "FTDI latency timer, 16 ms: a jump between 0 and 16 ms",
        details=(_EVENT,),
    ),
    PriorSize("lost_samples", 3e-3, "1", "judgement: receive buffers overrun", is_half=True),
    PriorSize("repeated_samples", 0.02, "1", "PX4/PX4-Autopilot issue 14860: 795 Hz", is_half=True),
    PriorSize("sample_jitter", 5e-4, "s", "judgement: a polling loop of 1 ms", is_half=True),
    PriorSize("corrupt_samples", 5e-4, "1", "judgement: bus without a checksum", is_half=True),
    # Sensor
    PriorSize("low_pass_lag", 0.15, "1", "judgement: analogue filters, 10 to 20 % between parts"),
    PriorSize(
        "scale_quadratic", 4.6e-4, "s/rad",
        "I3G4250D data sheet, 0.2 % of 250 deg/s at 250 deg/s", XYZ,
    ),
    PriorSize(
        "scale_cubic", 1.0e-4, "s^2/rad^2",
        "I3G4250D data sheet, 0.2 % of 250 deg/s at 250 deg/s", XYZ,
    ),
    PriorSize("scale_asymmetry", 1e-3, "1", "BMI270 user report, 2 deg in ten turns", XYZ),
    PriorSize(
        "saturation", 0.25, "1", "judgement: share of 250 deg/s that is missing", is_half=True,
    ),
    PriorSize("dead_zone", 0.05 * DEG, "rad/s", "judgement: five counts of 8.75 mdps", XYZ, True),
    PriorSize(
        "g_sensitivity", 0.1 * DEG / G_M_S2, "rad/s/(m/s^2)",
        "MPU-6050 data sheet, 0.1 deg/s/g", _G_NAMES,
    ),
    PriorSize(
        "vibration_rectification", 3e-4, "s/rad",
        "judgement: 5 mdps at a motor speed of 32 deg/s", XYZ,
    ),
    PriorSize("motor_coupling", 0.02 * DEG, "rad/s", "judgement: two counts of 8.75 mdps", XYZ),
    PriorSize(
        "thermal_bias", 0.03 * DEG, "rad/s/K", "I3G4250D data sheet, 0.03 deg/s/K", XYZ,
        details=(Detail("lag_s", 10.0, 60.0),),
    ),
    PriorSize("thermal_scale", 1.6e-4, "1/K", "I3G4250D data sheet, 2 % over 125 K", XYZ),
    PriorSize(
        "warm_up", 0.1 * DEG, "rad/s", "judgement: 3 K of self-heating at 0.03 deg/s/K", XYZ,
        details=(Detail("time_s", 30.0, 120.0, True),),
    ),
    PriorSize(
        "bias_ramp", 5e-6, "rad/s^2", "judgement: 3 K in 300 s at 0.03 deg/s/K", XYZ,
    ),
    PriorSize(
        "bias_step", 0.03 * DEG, "rad/s", "judgement: changes of the supply", XYZ,
        details=(_EVENT,),
    ),
    PriorSize(
        "bias_random_walk", 1e-3 * DEG, "rad/s/sqrt(s)",
        "judgement: published Allan deviations, 0.3 to 3 mdps/sqrt(s)", XYZ, True,
    ),
    PriorSize(
        "supply_hum", 0.03 * DEG, "rad/s", "judgement: three counts of 8.75 mdps", XYZ, True,
        (Detail("line_hz", 49.9, 50.1), Detail("phase", 0.0, 2 * np.pi)),
    ),
    # Unit
    PriorSize(
        "backlash", 0.05 * DEG, "rad", "FLIR support page: small when new, grows with wear", AXES,
        True, (Detail("face", -1.0, 1.0),),
    ),
    PriorSize(
        "lost_steps", 1.0, "cycles", "FLIR support page: four full steps", AXES, False, (_EVENT,),
    ),
    PriorSize(
        "eccentricity", 0.05 * DEG, "rad", "judgement: 30 um of runout at 35 mm", ("pan",), True,
        (*_PHASE, Detail("second", 0.0, 0.5), Detail("second_phase", 0.0, 2 * np.pi)),
    ),
    PriorSize("worm_error", 0.015 * DEG, "rad", "judgement: 9 um at 35 mm", AXES, True, _PHASE),
    PriorSize("axis_nonorthogonality", 0.15 * DEG, "rad", "judgement: machined housings"),
    PriorSize("tilt_zero", 0.3 * DEG, "rad", "judgement: a home vane without adjustment"),
    PriorSize(
        "step_resolution", 1e-3, "1", "judgement: 185.1428 arcsec rounded to 185 is 7.7e-4", AXES,
    ),
    PriorSize("acceleration_error", 5e-3, "1", "judgement: ramp tables of whole ticks", AXES),
    PriorSize("s_curve", 0.03, "s", "judgement: motion controllers, 10 to 100 ms", AXES, True),
    PriorSize("base_speed_jump", 2.9 * DEG, "rad/s", "D300 manual: 57 positions/s", AXES, True),
    PriorSize(
        "ringing", 0.05, "1", "judgement: tap tests of camera heads, Q of 5 to 20", AXES, True,
        (Detail("frequency_hz", 8.0, 40.0, True), Detail("damping", 0.025, 0.1)),
    ),
    PriorSize(
        "tilt_sag", 0.1 * DEG, "rad", "judgement: 1 kg at 50 mm on 300 N m/rad", is_half=True,
        details=(Detail("phase", 0.0, 2 * np.pi),),
    ),
    PriorSize(
        "base_compliance", 5e-5, "s^2",
        "judgement: 0.02 kg m^2 of head on a tripod of 400 N m/rad", ("pan",), True,
    ),
    # Mount and environment
    PriorSize("board_slip", 0.15 * DEG, "rad", "judgement: a loose screw", XYZ, False, (_EVENT,)),
    PriorSize(
        "earth_rotation", 0.0, "rad/s", "WGS 84, 7.292115e-5 rad/s; place and heading are random",
        details=(Detail("sine_latitude", -1.0, 1.0), Detail("heading", 0.0, 2 * np.pi)),
    ),
)  # fmt: skip

# Causes that a rig has at all times, as opposed to faults, events and wrong settings.
PERSISTENT = (
    "clock_skew", "low_pass_lag", "scale_quadratic", "scale_cubic", "scale_asymmetry",
    "g_sensitivity", "vibration_rectification", "motor_coupling", "thermal_bias", "thermal_scale",
    "warm_up", "backlash", "eccentricity", "worm_error", "axis_nonorthogonality", "tilt_zero",
    "step_resolution", "acceleration_error", "ringing", "tilt_sag", "base_compliance",
    "earth_rotation",
)  # fmt: skip

NOT_SIMULATED = {
    "clock_offset": "each rig has a random lag; it is a parameter of the base model",
    "clock_sawtooth": "the clocks of the simulated rigs are set only once",
    "axis_swap": "an exact exchange of two axes; the sensor matrix contains it",
    "sign_flip": "an exact change of sign; no mount of the simulated rigs has it",
    "wrong_full_scale": "an exact factor of two; the scale factor contains it",
}


def draw_causes(count: int, rng: np.random.Generator) -> HiddenCauses:
    """Return so many different causes with their sizes."""
    chosen = rng.choice(len(PRIOR_SIZES), size=count, replace=False)
    priors = [PRIOR_SIZES[k] for k in sorted(int(k) for k in chosen)]
    return HiddenCauses({prior.cause: _draw(prior, rng) for prior in priors})


def draw_persistent_causes(rng: np.random.Generator) -> HiddenCauses:
    """Return every cause that a rig has at all times, each with its size."""
    priors = [prior for prior in PRIOR_SIZES if prior.cause in PERSISTENT]
    return HiddenCauses({prior.cause: _draw(prior, rng) for prior in priors})


def _draw(prior: PriorSize, rng: np.random.Generator) -> dict[str, float]:
    drawn = prior.draw(rng)
    if prior.cause == "lost_steps":  # whole cycles, at least one
        for axis in AXES:
            if axis in drawn:
                cycles = np.sign(drawn[axis]) * max(1.0, np.rint(abs(drawn[axis])))
                drawn[axis] = float(cycles * LOST_STEP_CYCLE)
    return drawn
