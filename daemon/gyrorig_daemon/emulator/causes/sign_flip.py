"""Sign flip: a sensor axis counts with the wrong sign."""

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

_INT16_MIN, _INT16_MAX = -(2**15), 2**15 - 1


@dataclass(frozen=True, slots=True)
class SignFlip(Cause):
    """One axis has the wrong sign."""

    name = "sign_flip"
    size_meaning = "wrong sign of one axis; the only size is 1"
    part = "link"
    unit = "1"
    typical = 1.0
    sampled_min, sampled_max = 1.0, 1.0
    max_size = 1.0
    parameter = "present"
    components = SENSOR_AXES
    is_signed = False
    allowed_sizes = (1.0,)
    is_integer = True

    axis: int  # index

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the gain and the bias of a fit contain the effect."""
        return ()

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        if injected.size.number != 0.0:
            axis = SENSOR_AXES.index(injected.component)
            injected.board_hooks(hooks).count_effects.append(cls(axis))

    def draw(self, count: int) -> None:
        """See `board_effects.CountEffect`; nothing is random."""

    def changed(self, counts: IntArray) -> IntArray:
        """See `board_effects.CountEffect`."""
        read = counts.copy()
        read[:, self.axis] = np.clip(-read[:, self.axis], _INT16_MIN, _INT16_MAX)
        return read
