"""Causes between the sensor's registers and the frame. Sizes: boards survey, section 1.1."""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    SENSOR_AXES,
    Cause,
    Draw,
    Hidden,
    Quantity,
    board_of,
)
from gyrorig_daemon.emulator.physics.effects.hooks import RigHooks
from gyrorig_daemon.emulator.physics.effects.words import Corrupt, Rewired

_FLIPS = 0.5  # share of the corrupt words that have a wrong bit; the others are torn


def _corrupt(draw: Draw) -> dict[str, Quantity]:
    return {"share": Quantity(draw.size, "1"), "bit_flips": Quantity(_FLIPS, "1")}


def _hang_corrupt(hidden: Hidden, hooks: RigHooks, rng: np.random.Generator) -> None:
    words = Corrupt(hidden.number("share"), hidden.number("bit_flips"), rng)
    board_of(hidden, hooks).words.append(words)


def _present(draw: Draw) -> dict[str, Quantity]:
    return {"present": Quantity(draw.size, "1")}


def _hang_swap(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    if hidden.size.number == 0.0:
        return
    first, second = (SENSOR_AXES.index(axis) for axis in hidden.where)
    order = [0, 1, 2]
    order[first], order[second] = second, first
    rewired = Rewired((order[0], order[1], order[2]), (1, 1, 1))
    board_of(hidden, hooks).words.append(rewired)


def _hang_flip(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    if hidden.size.number == 0.0:
        return
    signs = [-1 if axis == hidden.where else 1 for axis in SENSOR_AXES]
    rewired = Rewired((0, 1, 2), (signs[0], signs[1], signs[2]))
    board_of(hidden, hooks).words.append(rewired)


def _full_scale(draw: Draw) -> dict[str, Quantity]:
    return {"full_scale_ratio": Quantity(draw.size, "1")}


def _hang_full_scale(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    # A wider range makes fewer counts of the same rate.
    board_of(hidden, hooks).count_factor /= hidden.number("full_scale_ratio")


CAUSES = (
    Cause(
        "corrupt_samples", "share of the samples with a flipped bit or a torn word",
        "link", "1", 1e-3, 3e-4, 1e-2, 0.1, _corrupt, _hang_corrupt,
        signed=False,
    ),
    Cause(
        "axis_swap", "two axes taken for one another; 1 is all there is",
        "link", "1", 1.0, 1.0, 1.0, 1.0, _present, _hang_swap,
        places=("xy", "xz", "yz"), signed=False, sizes=(1.0,), whole=True,
    ),
    Cause(
        "sign_flip", "an axis with the wrong sign; 1 is all there is",
        "link", "1", 1.0, 1.0, 1.0, 1.0, _present, _hang_flip,
        places=SENSOR_AXES, signed=False, sizes=(1.0,), whole=True,
    ),
    # true full scale over the told one: 250, 500 and 2000 dps are what there is
    Cause(
        "wrong_full_scale", "true full scale over the told one",
        "link", "1", 2.0, 0.5, 8.0, 16.0, _full_scale, _hang_full_scale,
        signed=False, least=1.0 / 16.0, sizes=(0.5, 2.0), neutral=1.0,
    ),
)  # fmt: skip
