"""Causes outside unit and board: how the board sits, and the planet under the rig.

Sizes: rig discovery survey, section 2; Earth's rate: IERS conventions.
"""

import math

import numpy as np

from gyrorig_daemon.emulator.causes.cause import Cause, Draw, Hidden, Quantity, board_of
from gyrorig_daemon.emulator.physics.effects.earth import EARTH_RATE_RAD_S, earth_rate_base_rad_s
from gyrorig_daemon.emulator.physics.effects.hooks import RigHooks
from gyrorig_daemon.emulator.physics.effects.mount import BoardSlip
from gyrorig_daemon.emulator.physics.rotation import rotation_matrix


def _slip(draw: Draw) -> dict[str, Quantity]:
    axis = draw.rng.standard_normal(3)
    turn = draw.size * axis / np.linalg.norm(axis)
    return {"turn": Quantity(tuple(turn.tolist()), "rad"), "at": Quantity(draw.event_s(), "s")}


def _hang_slip(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    slip = BoardSlip(rotation_matrix(hidden.array("turn")), hidden.number("at"))
    board_of(hidden, hooks).mounts.append(slip)


def _earth(draw: Draw) -> dict[str, Quantity]:
    """Where the site is not told, anywhere that people live."""
    latitude_deg, heading_deg = draw.rng.uniform(-60.0, 60.0), draw.rng.uniform(-180.0, 180.0)
    told = draw.rig.latitude_deg, draw.rig.heading_deg
    latitude_deg = latitude_deg if told[0] is None else told[0]
    heading_deg = heading_deg if told[1] is None else told[1]
    return {
        "rate": Quantity(draw.size, "rad/s"),
        "latitude": Quantity(math.radians(float(latitude_deg)), "rad"),
        "heading": Quantity(math.radians(float(heading_deg)), "rad"),
    }


def _hang_earth(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    told = (hidden.number(name) for name in ("rate", "latitude", "heading"))
    hooks.ground_rate_rad_s = earth_rate_base_rad_s(*told)


CAUSES = (
    Cause(
        "board_slip", "angle by which the board turns on the stage, once",
        "mount", "rad", 5e-3, 1.7e-3, 1.7e-2, 0.5, _slip, _hang_slip, signed=False,
    ),
    Cause(
        "earth_rotation", "rate of the Earth",
        "environment", "rad/s", EARTH_RATE_RAD_S, EARTH_RATE_RAD_S,
        EARTH_RATE_RAD_S, 0.01, _earth, _hang_earth, signed=False, sizes=(EARTH_RATE_RAD_S,),
    ),
)  # fmt: skip
