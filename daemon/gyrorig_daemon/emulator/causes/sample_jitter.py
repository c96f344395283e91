"""Sample jitter: the instant of a sample is earlier than its timestamp by a random time.

It occurs when a register is polled by a timer that is not synchronised with the sensor.
"""

import math

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    FloatArray,
    InjectedCause,
    ParameterSampling,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


class SampleJitter(Cause):
    """Each sample is too old by a separate time, uniform from 0 to sqrt(12) times the rms."""

    name = "sample_jitter"
    size_meaning = "scatter of the sampling times (rms)"
    part = "clock"
    unit = "s"
    typical = 1e-3
    sampled_min, sampled_max = 3e-4, 2.5e-3
    max_size = 1e-2
    is_signed = False

    def __init__(self, rms_s: float, rng: np.random.Generator) -> None:
        """Scatter the instants by `rms_s`."""
        self.longest_s = math.sqrt(12.0) * rms_s
        self._rng = rng

    @classmethod
    def max_size_on(cls, board: BoardSettings) -> float:
        """A sample cannot be as old as the one before; sensors run up to 5 % fast."""
        return 0.95 / board.odr_hz / math.sqrt(12.0)

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        mean_lag_s = 0.5 * math.sqrt(12.0) * sampling.size
        return {"rms": Quantity(sampling.size, "s"), "mean_lag": Quantity(mean_lag_s, "s")}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; here the samples are never early, so that they are late on average."""
        rms_s = stated.number("deviation")
        mean_lag_s = 0.5 * math.sqrt(12.0) * rms_s
        return (
            CarriedCause(
                {"rms": Quantity(rms_s, "s"), "mean_lag": Quantity(mean_lag_s, "s")},
                delay_s=mean_lag_s,
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        injected.board_hooks(hooks).jitter = cls(injected.number("rms"), rng)

    def draw_s(self, count: int) -> FloatArray:
        """See `board_effects.JitterEffect`."""
        return self.longest_s * self._rng.random(count)
