"""Low-pass lag: the cut-off frequency of the sensor's filter differs from the nominal one."""

import math

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    InjectedCause,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_daemon.emulator.physics.lowpass import butterworth_delay_s


class LowPassLag(Cause):
    """A relative error of the cut-off frequency. It changes the group delay."""

    name = "low_pass_lag"
    size_meaning = "relative error of the low-pass cut-off frequency"
    part = "sensor"
    unit = "1"
    typical = 0.3
    sampled_min, sampled_max = 0.1, 0.5
    max_size = 0.9
    parameter = "cutoff_change"

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; findings leave the additional delay to the time offset.

        Findings have the period 1/f_c instead of the logarithm of a ratio if the recording had no
        bandwidth.
        """
        bandwidth_hz = stated.on_board.bandwidth_hz
        change = (
            1.0 / (stated.number("period") * bandwidth_hz) - 1.0
            if stated.has("period")
            else math.expm1(stated.number("log_cutoff"))
        )
        return (
            CarriedCause(
                {cls.parameter: Quantity(change, "1")},
                delay_s=butterworth_delay_s(bandwidth_hz * (1.0 + change))
                - butterworth_delay_s(bandwidth_hz),
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        injected.board_hooks(hooks).bandwidth_factor *= 1.0 + injected.number("cutoff_change")
