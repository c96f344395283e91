"""Tilt zero error: the home switch of the tilt axis is not at the nominal zero."""

from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    FloatArray,
    InjectedCause,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.axis_effects import Motor
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


@dataclass(frozen=True, slots=True)
class TiltZero(Cause):
    """A constant angle adds to the tilt angle."""

    name = "tilt_zero"
    size_meaning = "error of the tilt zero"
    part = "ptu"
    unit = "rad"
    typical = 3e-3
    sampled_min, sampled_max = 9e-4, 1e-2
    max_size = 0.2
    parameter = "angle"
    components = ("tilt",)

    angle_rad: float

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; in the base model, a tilt zero is a rotation of the misalignment."""
        angle_rad = stated.number("angle")
        return (
            CarriedCause(
                {cls.parameter: Quantity(angle_rad, cls.unit)},
                "tilt",
                stage_turn_rad=np.array([-angle_rad, 0.0, 0.0]),
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        hooks.tilt.angle_effects.append(cls(injected.number("angle")))

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """See `axis_effects.AngleEffect`."""
        return np.full_like(angle_rad, self.angle_rad)

    def forget(self, time_s: float) -> None:
        """See `axis_effects.AngleEffect`; there is no state."""
