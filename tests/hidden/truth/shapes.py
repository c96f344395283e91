"""Add a shape outside the catalogue to a rig, with the same random draws each time."""

from collections.abc import Callable

import numpy as np
from tests.hidden.truth.outside.shape import Shape, Site

from gyrorig_daemon.emulator.emulator_settings import RigSettings
from gyrorig_daemon.emulator.injection import Quantity
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

_STREAM = 0x4F555453


def make_shape_adder(
    shape: Shape, size: float, settings: RigSettings
) -> Callable[[RigHooks], None]:
    """Return the function that adds a shape to the hooks of a rig at power-up."""

    def add(hooks: RigHooks) -> None:
        _add_shape(shape, size, settings, hooks)

    return add


def list_parameters(shape: Shape, size: float, settings: RigSettings) -> dict[str, Quantity]:
    """Return the parameters of a shape in a rig."""
    return _add_shape(shape, size, settings, RigHooks())


def _add_shape(
    shape: Shape, size: float, settings: RigSettings, hooks: RigHooks
) -> dict[str, Quantity]:
    rng = np.random.default_rng([settings.seed, _STREAM])
    return shape.add(Site(size, rng, hooks, settings))
