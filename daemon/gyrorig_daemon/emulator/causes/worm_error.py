"""Periodic worm error: an angle error with one period per turn of the worm.

The worm of a PTU-E46-17.5 makes 17.5 turns per turn of the axis.
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
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        turns = 2.0 * math.pi / stated.number("period", 2.0 * math.pi / WORM_TURNS)
        return tuple(
            CarriedCause(
                {
                    "amplitude": Quantity(amplitude, "rad"),
                    "phase": Quantity(phase, "rad"),
                    "turns": Quantity(turns, "1"),
                },
                axis,
            )
            for axis, amplitude, phase in stated.harmonics()
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        turns = injected.number_or("turns", WORM_TURNS)
        harmonic = Harmonic(injected.number("amplitude"), turns, injected.number("phase"))
        for axis in injected.axis_hooks(hooks):
            axis.angle_effects.append(harmonic)
