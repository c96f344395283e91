"""Earth rotation: the gyroscope measures the rotation of the Earth.

On a level base whose y axis points `heading` clockwise from true north, at latitude phi:

    Omega_base = Omega (-cos phi sin heading, cos phi cos heading, sin phi)
    y += G R^T Omega_base,  R = Rz(pan) Rx(tilt), stage to base

`heading_deg` is the compass heading of the base's y axis, which points forward: 0 is north, 90 is
east. With east, north and up as axes, y is (sin h, cos h, 0) and x, to the right of it, is (cos h,
-sin h, 0). Omega = 7.292115e-5 rad/s (WGS 84, NIMA TR8350.2, table 3.2): 4.2 mdps. The rate is
known if the site is known.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.recording_context import Site
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import NO_ANGLES, BinnedDependence, TermParameter
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.value_format import DEG

EARTH_RATE_RAD_S = 7.292115e-5


class EarthRotation(LinearTerm):
    """The known rate of the Earth; the start value is the value."""

    cause = "earth_rotation"
    title = "The gyroscope measures the Earth's rotation"
    equation = "omega = omega + rate x (direction of the Earth's axis in the stage)"
    part = "environment"
    stage = "axes"
    kind = "known"
    scope = "recording"
    parameters = (
        TermParameter(
            name="rate",
            unit="rad/s",
            typical_size=EARTH_RATE_RAD_S,
            lower=0.0,
            upper=EARTH_RATE_RAD_S,
            prior_std=0.0,
            start=EARTH_RATE_RAD_S,
        ),
    )
    confused_with = ("g_sensitivity", "thermal_bias")
    remedy = "write latitude_deg and heading_deg of the site into the rig file"
    covariates = None
    picture = BinnedDependence("mean", "pan")
    excitation = "rests of some minutes at pan angles over the whole range, for at least 20 minutes"
    unknown_site_remark = (
        "the solver did not remove the Earth's rotation, because the site has no heading; "
        "give heading_deg in the rig file"
    )
    effect_if_ignored = "the bias is wrong by up to 0.004 deg/s, differently at every heading"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the Earth's axis in the stage frame as measured, (1, blocks, 3)."""
        axis = earth_axis_in_base(state.context.site)
        if axis is None:
            return np.zeros((1, state.block_count, 3))
        return state.measure_stage_rate(base_vector_in_stage(axis, state.pan_rad, state.tilt_rad))[
            None
        ]

    def missing_data(self, state: SignalState) -> str | None:
        """Return why the site is unknown, or None."""
        if not state.has_angles:
            return NO_ANGLES
        if earth_axis_in_base(state.context.site) is None:
            return "the latitude or the heading is not recorded; give latitude_deg and heading_deg"
        return None

    def is_known_at(self, site: Site) -> bool:
        """Return whether latitude and heading are known."""
        return earth_axis_in_base(site) is not None

    def describe(self, values: FloatArray) -> str:
        return f"the Earth's rotation of {values[0] / DEG * 3600.0:.1f} deg/h is in the rates"


def earth_axis_in_base(site: Site) -> FloatArray | None:
    """Return the unit vector of the Earth's rotation in the base frame, or None if unknown."""
    if site.latitude_deg is None or site.heading_deg is None:
        return None
    latitude, heading = site.latitude_deg * DEG, site.heading_deg * DEG
    level = np.cos(latitude)
    return np.array([-level * np.sin(heading), level * np.cos(heading), np.sin(latitude)])


def base_vector_in_stage(
    vector: FloatArray, pan_rad: FloatArray, tilt_rad: FloatArray
) -> FloatArray:
    """Return Rx(tilt)^T Rz(pan)^T of a vector of the base frame, shape (n, 3)."""
    cosine, sine = np.cos(pan_rad), np.sin(pan_rad)
    right = cosine * vector[0] + sine * vector[1]
    ahead = -sine * vector[0] + cosine * vector[1]
    up = np.full_like(right, vector[2])
    lean, rise = np.cos(tilt_rad), np.sin(tilt_rad)
    return np.column_stack([right, lean * ahead + rise * up, -rise * ahead + lean * up])


TERM = EarthRotation()
