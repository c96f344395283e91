"""Clock skew: a delay that grows linearly.

A firmware that empties a sample queue by its own timer timestamps well and sends old samples:
the delay grows or shrinks because the sensor's oscillator runs fast or slow against that timer.
A sample never shows motion that has not happened yet, so that a shrinking delay starts large.

Sizes: -640 ppm was reported for the ceramic resonator of an Arduino Uno R3
(github.com/PaulStoffregen/Time, issue 69); the output data rate of MEMS sensors is off by up to 5 %
(I3G4250D data sheet).
"""

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
class ClockSkew(Cause):
    """A delay that grows at a constant rate."""

    name = "clock_skew"
    size_meaning = "growth of the delay of the samples, in s per s"
    part = "clock"
    unit = "1"
    typical = 2e-4
    sampled_min, sampled_max = 2e-5, 1e-3
    max_size = 5e-3

    growth: float  # s of delay per s
    start_s: float  # delay at power-up

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        # A delay that shrinks must last longer than the session.
        start_s = max(-sampling.size, 0.0) * (1.3 * sampling.rig.session_s[1] + 10.0)
        return {
            "lag_growth": Quantity(sampling.size, "1"),
            "lag_at_power_up": Quantity(start_s, "s"),
        }

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the delay of findings is 0 at the middle of the recording."""
        growth = stated.number("rate")
        start_s = max(-growth, 0.0) * stated.latest_s
        return (
            CarriedCause(
                {"lag_growth": Quantity(growth, "1"), "lag_at_power_up": Quantity(start_s, "s")},
                delay_s=start_s + growth * stated.middle_s,
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        lag = cls(injected.number("lag_growth"), injected.number("lag_at_power_up"))
        injected.board_hooks(hooks).lags.append(lag)

    def at(self, time_s: float) -> tuple[float, float]:
        """See `board_effects.LagEffect`."""
        lag_s = self.start_s + self.growth * time_s
        return (lag_s, self.growth) if lag_s > 0.0 else (0.0, 0.0)
