"""Bias ramp: a bias that changes linearly with the time since power-up."""

from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    FloatArray,
    InjectedCause,
    Quantity,
    SensorCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature


@dataclass(frozen=True, slots=True, eq=False)
class BiasRamp(SensorCause):
    """The bias drifts at a constant rate."""

    name = "bias_ramp"
    size_meaning = "largest slope of the bias with time"
    unit = "rad/s^2"
    typical = 1.5e-5
    sampled_min, sampled_max = 3e-6, 1e-4
    max_size = 1e-2
    parameter = "slope"

    slope_rad_s2: FloatArray  # (3,)
    zero_s: float = 0.0  # since power-up

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the ramp of findings is 0 at the middle of the recording."""
        slope = stated.by_sensor_axis("slope", cls.unit)
        return (CarriedCause({"slope": slope, "zero_at": Quantity(stated.middle_s, "s")}),)

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        ramp = cls(injected.array("slope"), injected.number_or("zero_at", 0.0))
        injected.board_hooks(hooks).bias_effects.append(ramp)

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """See `board_effects.BiasEffect`."""
        return np.outer(time_s - self.zero_s, self.slope_rad_s2)
