"""Temperature coefficient of the scale factor: k (T - T0) u, with T0 the temperature at power-up.

Size: the I3G4250D data sheet gives 2 % from -40 to 85 degC, which is 1.6e-4 per kelvin.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    FloatArray,
    InjectedCause,
    Quantity,
    RateCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


@dataclass(frozen=True, eq=False)
class ThermalScale(RateCause):
    """The gain changes with the temperature of the board."""

    name = "thermal_scale"
    size_meaning = "largest relative change of the gain with the temperature"
    unit = "1/K"
    typical = 3e-4
    sampled_min, sampled_max = 1e-4, 2e-3
    max_size = 0.05
    parameter = "share_per_k"

    zero_k: float = 0.0  # rise since power-up at which the effect is 0

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        return (
            CarriedCause(
                {
                    cls.parameter: stated.by_sensor_axis("slope", cls.unit),
                    "zero_at": Quantity(stated.on_board.reference_rise_k, "K"),
                }
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        effect = cls(injected.array(cls.parameter), injected.number_or("zero_at", 0.0))
        injected.board_hooks(hooks).rate_effects.append(effect)

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        rise_k = samples.temperature.rise_k(samples.time_s) - self.zero_k
        return np.asarray(rise_k[:, None] * self.coefficient * samples.sensor_rad_s)
