"""Ringing: a structural resonance of the stage responds to each start and stop.

angle + A q, q'' + 2 z w q' + w^2 q = -angle'': a mode of the head, excited by the acceleration
of the stage behind the gear. A is its share in the rotation of the stage. 5 to 60 Hz, damping
0.025 to 0.1 (Q 5 to 20), shares of 3 to 12 % (from memory).
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import EDGE_COVARIATES
from gyrorig_solver.model.drive_effects import resonance_deflection
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import shape_parameter, size_parameter
from gyrorig_solver.model.term_kinds import LinearAngleTerm, scan_grid
from gyrorig_solver.model.value_format import PAN_TILT, format_list

LOWEST_HZ, HIGHEST_HZ = 3.0, 60.0  # of the mode of a head on its mount


class Ringing(LinearAngleTerm):
    """The share A of pan and tilt, then frequency and damping of the mode."""

    cause = "ringing"
    title = "The structure rings after each move"
    equation = (
        "angle = angle + share q, q'' + 2 damping w q' + w^2 q = -angle'', w = 2 pi frequency"
    )
    depends_on_upstream = True
    parameters = (
        size_parameter("share", "1", PAN_TILT, typical=0.05, lower=0.0, limit=2.0, prior_std=1.0),
        shape_parameter(
            "frequency", "Hz", typical=1.0, lower=1.0, upper=80.0, prior_std=20.0, start=10.0
        ),
        shape_parameter(
            "damping", "1", typical=0.03, lower=0.002, upper=0.35, prior_std=0.1, start=0.05
        ),
    )
    confused_with = ("base_compliance", "s_curve", "supply_hum")
    remedy = "lower the acceleration, stiffen the mount, or wait longer before each rest"
    covariates = EDGE_COVARIATES
    picture = None
    template_search = "full_grid"
    excitation = "hard stops, each followed by a rest of at least half a second"
    effect_if_ignored = "small, because the time offset absorbs part of the error"

    def angle_shapes(self, state: SignalState, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return the deflections of pan and tilt."""
        mode = float(values[2]), float(values[3])
        return list(
            enumerate(resonance_deflection(state.edges_s, state.angle_acceleration_rad_s2, *mode))
        )

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan the mode as finely as its damping requires."""
        grids = []
        for damping in (0.03, 0.1, 0.25):
            count = 1 + int(np.log(HIGHEST_HZ / LOWEST_HZ) / (2.0 * damping))
            modes = np.geomspace(LOWEST_HZ, HIGHEST_HZ, count)
            grids.append(scan_grid(self, frequency=modes, damping=np.array([damping])))
        return np.concatenate(grids)

    def describe(self, values: FloatArray) -> str:
        text = format_list(values[:2] * 100.0, PAN_TILT, "%")
        return f"the stage rings at {values[2]:.1f} Hz (damping {values[3]:.2g}): {text}"


TERM = Ringing()
