"""Gear eccentricity: an angle error with one period per turn of the axis, and one with two.

An eccentric gear gives the first order, an oval one the second.
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


class Eccentricity(UnitCause):
    """The angle has an error of the first and second order in the angle."""

    name = "eccentricity"
    size_meaning = (
        "amplitude of the first harmonic; the second harmonic has at most half of this amplitude"
    )
    unit = "rad"
    typical = 9e-4
    sampled_min, sampled_max = 3.5e-4, 1.7e-3
    max_size = 0.05
    is_signed = False

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        second = sampling.size * float(sampling.rng.uniform(0.0, 0.5))
        return {
            "first": Quantity(sampling.size, "rad"),
            "first_phase": Quantity(sampling.phase_rad(), "rad"),
            "second": Quantity(second, "rad"),
            "second_phase": Quantity(sampling.phase_rad(), "rad"),
        }

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        for axis in injected.axis_hooks(hooks):
            for order, name in ((1.0, "first"), (2.0, "second")):
                phase_rad = injected.number(f"{name}_phase")
                axis.angle_effects.append(Harmonic(injected.number(name), order, phase_rad))
