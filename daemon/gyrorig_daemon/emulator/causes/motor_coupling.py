"""Motor coupling: a bias that is present while a motor turns, through the supply or the field."""

from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    FloatArray,
    InjectedCause,
    RateCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

# Rounding of angle differences over a substep stays below this; a motor turns far faster.
_STILL_RAD_S = 1e-6


@dataclass(frozen=True, eq=False)
class MotorCoupling(RateCause):
    """A constant rate adds to the output while an axis turns."""

    name = "motor_coupling"
    size_meaning = "largest bias while a motor turns"
    unit = "rad/s"
    typical = 6e-4
    sampled_min, sampled_max = 2e-4, 2e-3
    max_size = 0.1
    parameter = "bias"

    tilt_coefficient: FloatArray | None = None  # of tilt, if it differs from that of pan, (3,)

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; findings have one bias per motor."""
        pan, tilt = (stated.by_sensor_axis(name, cls.unit) for name in ("pan", "tilt"))
        return (CarriedCause({"bias": pan, "tilt_bias": tilt}),)

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        tilt = injected.array("tilt_bias") if "tilt_bias" in injected.parameters else None
        injected.board_hooks(hooks).rate_effects.append(cls(injected.array("bias"), tilt))

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        if self.tilt_coefficient is not None:
            pan, tilt = (
                (np.abs(rate_rad_s) > _STILL_RAD_S)[:, None]
                for rate_rad_s in (samples.pan_rate_rad_s, samples.tilt_rate_rad_s)
            )
            return np.asarray(pan * self.coefficient + tilt * self.tilt_coefficient)
        speed_rad_s = np.abs(samples.pan_rate_rad_s) + np.abs(samples.tilt_rate_rad_s)
        is_turning = speed_rad_s > _STILL_RAD_S
        return np.asarray(is_turning[:, None] * self.coefficient)
