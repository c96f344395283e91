"""Tilt sag: the payload bends the tilt axis with the sine of the tilt angle.

The centre of mass of the payload is above the tilt axis, up to 45 deg fore or aft.
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    InjectedCause,
    ParameterSampling,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.harmonic import Harmonic
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

_QUARTER_TURN = 0.5 * np.pi


class TiltSag(Cause):
    """The tilt angle has an error of the first order in the tilt angle."""

    name = "tilt_sag"
    size_meaning = "amplitude of the sag, which is proportional to the sine of the tilt angle"
    part = "ptu"
    unit = "rad"
    typical = 2e-3
    sampled_min, sampled_max = 9e-4, 5e-3
    max_size = 0.1
    components = ("tilt",)

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        phase = float(sampling.rng.uniform(-0.5, 0.5)) * _QUARTER_TURN
        return {"amplitude": Quantity(sampling.size, "rad"), "phase": Quantity(phase, "rad")}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        return tuple(
            CarriedCause(
                {"amplitude": Quantity(amplitude, "rad"), "phase": Quantity(phase, "rad")}, axis
            )
            for axis, amplitude, phase in stated.harmonics()
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        harmonic = Harmonic(injected.number("amplitude"), 1.0, injected.number("phase"))
        hooks.tilt.angle_effects.append(harmonic)
