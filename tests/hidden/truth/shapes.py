"""How a shape outside the catalogue gets into a rig: always with the same draws."""

from collections.abc import Callable

import numpy as np
from tests.hidden.truth.outside.shape import Shape, Site

from gyrorig_daemon.emulator.emulator_settings import RigSettings
from gyrorig_daemon.emulator.injection import Quantity
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

_STREAM = 0x4F555453


def hanger(shape: Shape, size: float, settings: RigSettings) -> Callable[[RigHooks], None]:
    """Return what hangs a shape on hooks as they are at power-up."""

    def hang(hooks: RigHooks) -> None:
        _hung(shape, size, settings, hooks)

    return hang


def parameters(shape: Shape, size: float, settings: RigSettings) -> dict[str, Quantity]:
    """Return the parameters that a shape is hung with."""
    return _hung(shape, size, settings, RigHooks())


def _hung(shape: Shape, size: float, settings: RigSettings, hooks: RigHooks) -> dict[str, Quantity]:
    rng = np.random.default_rng([settings.seed, _STREAM])
    return shape.hang(Site(size, rng, hooks, settings))
