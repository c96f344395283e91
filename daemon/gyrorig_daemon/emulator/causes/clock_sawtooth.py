"""Clock saw-tooth: a delay that grows linearly, and is taken back at regular intervals.

A time daemon that sets a clock instead of slewing it, and a sample queue that is emptied whenever
it is too long, do this.
"""

import math
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

PERIODS_PER_SESSION = (1.5, 8.0)


@dataclass(frozen=True, slots=True)
class ClockSawtooth(Cause):
    """A delay that grows at a constant rate from one correction to the next."""

    name = "clock_sawtooth"
    size_meaning = "growth of the delay of the samples between corrections, in s per s"
    part = "clock"
    unit = "1"
    typical = 2e-4
    sampled_min, sampled_max = 5e-5, 5e-4
    max_size = 5e-3

    growth: float  # s of delay per s
    period_s: float
    correction_s: float  # time of one correction

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        length_s = sampling.rig.session_s[1] - sampling.rig.session_s[0]
        period_s = length_s / sampling.rng.uniform(*PERIODS_PER_SESSION)
        return {
            "lag_growth": Quantity(sampling.size, "1"),
            "period": Quantity(period_s, "s"),
            "at": Quantity(sampling.event_s(), "s"),
        }

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the mean delay of findings is 0."""
        growth, period_s = stated.number("rate"), stated.number("period")
        tooth_s = growth * period_s
        return (
            CarriedCause(
                {
                    "lag_growth": Quantity(growth, "1"),
                    "period": Quantity(period_s, "s"),
                    "at": Quantity(stated.event_s().number + stated.period_share * period_s, "s"),
                },
                delay_s=0.5 * tooth_s + max(-tooth_s, 0.0),
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        names = ("lag_growth", "period", "at")
        injected.board_hooks(hooks).lags.append(cls(*(injected.number(name) for name in names)))

    def at(self, time_s: float) -> tuple[float, float]:
        """See `board_effects.LagEffect`."""
        turns = (time_s - self.correction_s) / self.period_s
        tooth_s = self.growth * self.period_s
        # A sample never shows motion that has not happened yet.
        return tooth_s * (turns - math.floor(turns)) + max(-tooth_s, 0.0), self.growth
