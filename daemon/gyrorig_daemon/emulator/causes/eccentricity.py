"""Gear eccentricity: an angle error with one period per turn of the axis, and one with two.

An eccentric gear gives the first order, an oval one the second.
"""

import math

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    InjectedCause,
    ParameterSampling,
    Quantity,
    StatedCause,
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
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; findings state the second harmonic relative to the first one."""
        oval, across = stated.number("oval", 0.0), stated.number("oval_across", 0.0)
        carried = []
        for axis, first, first_phase in stated.harmonics():
            c, s = first * math.sin(first_phase), first * math.cos(first_phase)
            cosine, sine = c * oval - s * across, c * across + s * oval
            parameters = {
                "first": Quantity(first, "rad"),
                "first_phase": Quantity(first_phase, "rad"),
                "second": Quantity(math.hypot(cosine, sine), "rad"),
                "second_phase": Quantity(math.atan2(cosine, sine), "rad"),
            }
            carried.append(CarriedCause(parameters, axis))
        return tuple(carried)

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        for axis in injected.axis_hooks(hooks):
            for order, name in ((1.0, "first"), (2.0, "second")):
                phase_rad = injected.number(f"{name}_phase")
                axis.angle_effects.append(Harmonic(injected.number(name), order, phase_rad))
