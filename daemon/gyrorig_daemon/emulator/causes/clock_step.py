"""Clock step: a delay that jumps once, because samples were skipped or repeated in a queue."""

from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    InjectedCause,
    ParameterSampling,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


@dataclass(frozen=True, slots=True)
class ClockStep(Cause):
    """A delay that jumps once, with the first sample after an instant."""

    name = "clock_step"
    size_meaning = "single jump of the delay of the samples"
    part = "clock"
    unit = "s"
    typical = 10e-3
    sampled_min, sampled_max = 1e-3, 30e-3
    max_size = 0.2

    step_s: float
    at_s: float

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        return {"step": Quantity(sampling.size, "s"), "at": Quantity(sampling.event_s(), "s")}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        step_s = stated.number("step")
        return (
            CarriedCause(
                {"step": Quantity(step_s, "s"), "at": stated.event_s()},
                delay_s=max(-step_s, 0.0),  # here the samples are never early
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        lag = cls(injected.number("step"), injected.number("at"))
        injected.board_hooks(hooks).lags.append(lag)

    def at(self, time_s: float) -> tuple[float, float]:
        """See `board_effects.LagEffect`."""
        before_s = max(-self.step_s, 0.0)
        return before_s + (self.step_s if time_s >= self.at_s else 0.0), 0.0
