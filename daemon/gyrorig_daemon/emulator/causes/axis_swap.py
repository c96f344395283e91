"""Axis swap: two sensor axes are exchanged, by wiring or by the order of registers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.causes.cause import (
    SENSOR_AXES,
    CarriedCause,
    Cause,
    InjectedCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class AxisSwap(Cause):
    """Two axes are exchanged."""

    name = "axis_swap"
    size_meaning = "exchange of two axes; the only size is 1"
    part = "link"
    unit = "1"
    typical = 1.0
    sampled_min, sampled_max = 1.0, 1.0
    max_size = 1.0
    parameter = "present"
    components = ("xy", "xz", "yz")
    is_signed = False
    allowed_sizes = (1.0,)
    is_integer = True

    first: int  # index of an axis
    second: int

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the gain and the bias of a fit contain the effect."""
        return ()

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        if injected.size.number == 0.0:
            return
        first, second = (SENSOR_AXES.index(axis) for axis in injected.component)
        injected.board_hooks(hooks).count_effects.append(cls(first, second))

    def draw(self, count: int) -> None:
        """See `board_effects.CountEffect`; nothing is random."""

    def changed(self, counts: IntArray) -> IntArray:
        """See `board_effects.CountEffect`."""
        order = [0, 1, 2]
        order[self.first], order[self.second] = self.second, self.first
        return counts[:, order]
