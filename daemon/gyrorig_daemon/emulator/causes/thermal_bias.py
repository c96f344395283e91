"""Temperature coefficient of the bias: k (T_die - T0), with T0 the temperature at power-up.

The die follows the board with a first-order lag. Size: 0.03 deg/s per kelvin is typical (I3G4250D
data sheet, zero-rate level change with temperature).
"""

from dataclasses import dataclass, field

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    FloatArray,
    InjectedCause,
    ParameterSampling,
    Quantity,
    SensorCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature


@dataclass(frozen=True, slots=True, eq=False)
class ThermalBias(SensorCause):
    """The bias follows the temperature of the die."""

    name = "thermal_bias"
    size_meaning = "largest slope of the bias with the die temperature"
    unit = "rad/s/K"
    typical = 5e-4
    sampled_min, sampled_max = 1e-4, 2e-3
    max_size = 0.1

    slope_rad_s_k: FloatArray  # (3,)
    lag_s: float  # negative: the die is ahead of the thermometer
    square_rad_s_k2: FloatArray = field(default_factory=lambda: np.zeros(3))
    cube_rad_s_k3: FloatArray = field(default_factory=lambda: np.zeros(3))
    zero_k: float = 0.0  # rise since power-up at which the effect is 0

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        lag_s = float(sampling.rng.uniform(10.0, 40.0))
        return {"slope": sampling.by_axis("rad/s/K"), "lag": Quantity(lag_s, "s")}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; a negative lag of findings is a late die, here it is a positive one."""
        return (
            CarriedCause(
                {
                    "slope": stated.by_sensor_axis("slope", "rad/s/K"),
                    "square": stated.by_sensor_axis("square", "rad/s/K^2"),
                    "cube": stated.by_sensor_axis("cube", "rad/s/K^3"),
                    "lag": Quantity(-stated.number("lag", 0.0), "s"),
                    "zero_at": Quantity(stated.on_board.reference_rise_k, "K"),
                }
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        effect = cls(
            injected.array("slope"),
            injected.number("lag"),
            injected.array_or_zeros("square"),
            injected.array_or_zeros("cube"),
            injected.number_or("zero_at", 0.0),
        )
        injected.board_hooks(hooks).bias_effects.append(effect)

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """See `board_effects.BiasEffect`."""
        rise_k = (temperature.rise_k(time_s, self.lag_s) - self.zero_k)[:, None]
        polynomial = self.square_rad_s_k2 + rise_k * self.cube_rad_s_k3
        return rise_k * (self.slope_rad_s_k + rise_k * polynomial)
