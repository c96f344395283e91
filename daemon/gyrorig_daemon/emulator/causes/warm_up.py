"""Warm-up transient: a exp(-t / w), with t the time since power-up."""

from dataclasses import dataclass

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
class WarmUp(SensorCause):
    """The bias decays exponentially after power-up."""

    name = "warm_up"
    size_meaning = "largest bias at power-up, which then decays"
    unit = "rad/s"
    typical = 1.7e-3
    sampled_min, sampled_max = 8e-4, 5e-3
    max_size = 0.5

    start_rad_s: FloatArray  # (3,)
    time_constant_s: float
    begin_s: float = 0.0  # since power-up; the bias is constant before

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        time_constant_s = float(sampling.rng.uniform(30.0, 120.0))
        start = sampling.by_axis("rad/s")
        return {"at_power_up": start, "time_constant": Quantity(time_constant_s, "s")}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; findings state the bias at the begin of the recording."""
        return (
            CarriedCause(
                {
                    "at_power_up": stated.by_sensor_axis("begin", "rad/s"),
                    "time_constant": Quantity(stated.number("time_constant"), "s"),
                    "begin": Quantity(stated.begin_s, "s"),
                }
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        effect = cls(
            injected.array("at_power_up"),
            injected.number("time_constant"),
            injected.number_or("begin", 0.0),
        )
        injected.board_hooks(hooks).bias_effects.append(effect)

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """See `board_effects.BiasEffect`."""
        elapsed_s = np.maximum(time_s - self.begin_s, 0.0) if self.begin_s else time_s
        return np.outer(np.exp(-elapsed_s / self.time_constant_s), self.start_rad_s)
