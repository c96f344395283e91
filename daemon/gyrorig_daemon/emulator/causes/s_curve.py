"""S-curve: the controller averages the planned motion over a window.

This is the common way to limit jerk in a step generator. The average is computed in
`physics.step_train`.
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    InjectedCause,
    Quantity,
    StatedCause,
    UnitCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


class SCurve(UnitCause):
    """The planned motion is averaged over a window."""

    name = "s_curve"
    size_meaning = "length of the averaging window"
    unit = "s"
    typical = 0.03
    sampled_min, sampled_max = 0.01, 0.1
    max_size = 1.0
    parameter = "window"
    acts_on_all = True
    is_signed = False

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the window begins with the command, findings have it about each instant."""
        return tuple(
            CarriedCause(
                {cls.parameter: Quantity(window_s, cls.unit)},
                axis,
                start_delay_s=0.25 * window_s,  # half of the window, on one axis of two
            )
            for axis, window_s in stated.by_unit_axis("length")
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        for axis in injected.axis_hooks(hooks):
            axis.s_curve_s += injected.number("window")
