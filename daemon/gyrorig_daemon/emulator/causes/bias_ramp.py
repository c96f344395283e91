"""Bias ramp: a bias that changes linearly with the time since power-up."""

from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.causes.cause import FloatArray, InjectedCause, SensorCause
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

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        injected.board_hooks(hooks).bias_effects.append(cls(injected.array("slope")))

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """See `board_effects.BiasEffect`."""
        return np.outer(time_s, self.slope_rad_s2)
