"""Dead band: rates below a threshold give no output."""

from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    SENSOR_AXES,
    CarriedCause,
    FloatArray,
    InjectedCause,
    ParameterSampling,
    Quantity,
    SensorCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


@dataclass(frozen=True, slots=True, eq=False)
class DeadZone(SensorCause):
    """The output is zero while the rate is below a width."""

    name = "dead_zone"
    size_meaning = "rate below which the output is zero"
    unit = "rad/s"
    typical = 8e-3
    sampled_min, sampled_max = 2e-3, 3e-2
    max_size = 0.5
    is_signed = False

    width_rad_s: FloatArray  # (3,)

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        return {"width": Quantity(sampling.size, "rad/s")}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        return tuple(
            CarriedCause({"width": Quantity(width_rad_s, "rad/s")}, axis)
            for axis in SENSOR_AXES
            if (width_rad_s := stated.number(f"threshold.{axis}", 0.0)) > 0.0
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        on_axis = np.array([float(axis in injected.components) for axis in SENSOR_AXES])
        width_rad_s = on_axis * injected.number("width")
        injected.board_hooks(hooks).rate_effects.append(cls(width_rad_s))

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        u = samples.sensor_rad_s
        return np.where(np.abs(u) < self.width_rad_s, -u, 0.0)
