"""Earth rotation: a gyroscope measures the rotation of the Earth under the rig.

In the base frame (x right, y forward, z up) at latitude L, with y pointing to the compass
heading h (clockwise from north),

    w = W (-sin h cos L, cos h cos L, sin L),    W = 7.292115e-5 rad/s (IERS conventions)

and the stage turns with R^T w, where R is its attitude in the base.
"""

import math

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    FloatArray,
    InjectedCause,
    ParameterSampling,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

EARTH_RATE_RAD_S = 7.292115e-5


def earth_rate_base_rad_s(rate_rad_s: float, latitude_rad: float, heading_rad: float) -> FloatArray:
    """Return the rotation of the ground in the base frame, (3,)."""
    level = rate_rad_s * math.cos(latitude_rad)
    return np.array(
        [
            -level * math.sin(heading_rad),
            level * math.cos(heading_rad),
            rate_rad_s * math.sin(latitude_rad),
        ]
    )


class EarthRotation(Cause):
    """The rotation of the ground adds to the rate of the stage."""

    name = "earth_rotation"
    size_meaning = "rate of the Earth"
    part = "environment"
    unit = "rad/s"
    typical = EARTH_RATE_RAD_S
    sampled_min, sampled_max = EARTH_RATE_RAD_S, EARTH_RATE_RAD_S
    max_size = 0.01
    is_signed = False
    allowed_sizes = (EARTH_RATE_RAD_S,)

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        # If the site is unknown: any inhabited latitude. The draws do not depend on what is known.
        latitude_deg = sampling.rng.uniform(-60.0, 60.0)
        heading_deg = sampling.rng.uniform(-180.0, 180.0)
        if sampling.rig.latitude_deg is not None:
            latitude_deg = sampling.rig.latitude_deg
        if sampling.rig.heading_deg is not None:
            heading_deg = sampling.rig.heading_deg
        return {
            "rate": Quantity(sampling.size, "rad/s"),
            "latitude": Quantity(math.radians(float(latitude_deg)), "rad"),
            "heading": Quantity(math.radians(float(heading_deg)), "rad"),
        }

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        if stated.latitude_deg is None or stated.heading_deg is None:
            raise stated.error(
                "the place of the rig is not known",
                "write latitude_deg and heading_deg under `site` in the rig file",
            )
        return (
            CarriedCause(
                {
                    "rate": Quantity(stated.number("rate"), "rad/s"),
                    "latitude": Quantity(math.radians(stated.latitude_deg), "rad"),
                    "heading": Quantity(math.radians(stated.heading_deg), "rad"),
                }
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        site = (injected.number(name) for name in ("rate", "latitude", "heading"))
        hooks.ground_rate_rad_s = earth_rate_base_rad_s(*site)
