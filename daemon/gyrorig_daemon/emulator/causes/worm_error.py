"""Periodic worm error: an angle error with one period per turn of the worm.

The worm of a PTU-E46-17.5 makes 17.5 turns per turn of the axis.
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    InjectedCause,
    ParameterSampling,
    Quantity,
    UnitCause,
)
from gyrorig_daemon.emulator.physics.effects.harmonic import Harmonic
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

WORM_TURNS = 17.5  # turns of the worm per turn of the axis


class WormError(UnitCause):
    """The angle has an error with the period of the worm."""

    name = "worm_error"
    size_meaning = "amplitude at one period per turn of the worm"
    unit = "rad"
    typical = 2e-4
    sampled_min, sampled_max = 9e-5, 5e-4
    max_size = 0.02
    is_signed = False

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        return {
            "amplitude": Quantity(sampling.size, "rad"),
            "phase": Quantity(sampling.phase_rad(), "rad"),
        }

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        harmonic = Harmonic(injected.number("amplitude"), WORM_TURNS, injected.number("phase"))
        for axis in injected.axis_hooks(hooks):
            axis.angle_effects.append(harmonic)
