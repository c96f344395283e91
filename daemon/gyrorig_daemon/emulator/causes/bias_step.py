"""Bias step: the bias jumps once.

Bias steps in operation were reported in github.com/ArduPilot/ardupilot, issue 12477, and
github.com/rosflight/rosflight, issue 166.
"""

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
class BiasStep(SensorCause):
    """The bias jumps once, at an instant."""

    name = "bias_step"
    size_meaning = "largest jump of the bias, which occurs once"
    unit = "rad/s"
    typical = 1e-3
    sampled_min, sampled_max = 3e-4, 3e-3
    max_size = 0.5

    step_rad_s: FloatArray  # (3,)
    at_s: float

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        return {"step": sampling.by_axis("rad/s"), "at": Quantity(sampling.event_s(), "s")}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        return (
            CarriedCause({"step": stated.by_sensor_axis("step", "rad/s"), "at": stated.event_s()}),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        effect = cls(injected.array("step"), injected.number("at"))
        injected.board_hooks(hooks).bias_effects.append(effect)

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """See `board_effects.BiasEffect`."""
        return np.outer(time_s >= self.at_s, self.step_rad_s)
