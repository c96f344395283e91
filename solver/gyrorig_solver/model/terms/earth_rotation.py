"""The gyro feels the Earth turn.

On a level base whose y axis points `heading` clockwise from true north, at latitude phi:

    Omega_base = Omega (-cos phi sin heading, cos phi cos heading, sin phi)
    y += G R^T Omega_base,  R = Rz(pan) Rx(tilt), stage to base

Heading: the contract gives `heading_deg` of the rig's base and its y axis as pointing
forward; it is read as a compass heading of that axis: 0 north, 90 east. With east, north
and up as axes, y is (sin h, cos h, 0) and x, to the right of it, (cos h, -sin h, 0).
Omega = 7.292115e-5 rad/s (WGS 84, NIMA TR8350.2, table 3.2): 4.2 mdps, known where the site
is; left free, its size has to come out as that.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Kind, Link, Part, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene, Site
from gyrorig_solver.model.terms.wording import DEG

EARTH_RATE_RAD_S = 7.292115e-5


class EarthRotation(LinearTerm):
    """One size, the Earth's rate, known: its start is its value."""

    cause = "earth_rotation"
    part: Part = "environment"
    link: Link = "axes"
    kind: Kind = "known"
    scope: Scope = "recording"
    parameters = (
        TermParameter(
            name="rate",
            unit="rad/s",
            typical=EARTH_RATE_RAD_S,
            lower=0.0,
            upper=EARTH_RATE_RAD_S,
            prior_std=0.0,
            start=EARTH_RATE_RAD_S,
        ),
    )
    confused_with = ("g_sensitivity", "thermal_bias")
    excitation = "rests of minutes at pan headings all around, for 20 minutes or more"
    harm = "the bias is off by up to 0.004 deg/s, otherwise at every heading"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the Earth's direction in the stage frame as seen, (1, blocks, 3)."""
        axis = earth_in_base(scene.setting.site)
        if axis is None:
            return np.zeros((1, scene.blocks, 3))
        return scene.seen_at_stage(in_stage(axis, scene.pan_rad, scene.tilt_rad))[None]

    def missing(self, scene: Scene) -> str | None:
        """Say that the site is not known."""
        if not scene.has_angles:
            return "the reference has no pan and tilt; use a pan-tilt unit"
        if earth_in_base(scene.setting.site) is None:
            return "latitude or heading are not recorded; give latitude_deg and heading_deg"
        return None

    def sentence(self, values: FloatArray) -> str:
        """Say what is taken out."""
        return f"the Earth's rotation of {values[0] / DEG * 3600.0:.1f} deg/h shows in the rates"


def earth_in_base(site: Site) -> FloatArray | None:
    """Return the unit vector of the Earth's rotation in the base frame, None if unknown."""
    if site.latitude_deg is None or site.heading_deg is None:
        return None
    latitude, heading = site.latitude_deg * DEG, site.heading_deg * DEG
    level = np.cos(latitude)
    return np.array([-level * np.sin(heading), level * np.cos(heading), np.sin(latitude)])


def in_stage(vector: FloatArray, pan_rad: FloatArray, tilt_rad: FloatArray) -> FloatArray:
    """Return Rx(tilt)^T Rz(pan)^T of a vector of the base frame, shape (n, 3)."""
    cosine, sine = np.cos(pan_rad), np.sin(pan_rad)
    right = cosine * vector[0] + sine * vector[1]
    ahead = -sine * vector[0] + cosine * vector[1]
    up = np.full_like(right, vector[2])
    lean, rise = np.cos(tilt_rad), np.sin(tilt_rad)
    return np.column_stack([right, lean * ahead + rise * up, -rise * ahead + lean * up])


TERM = EarthRotation()
