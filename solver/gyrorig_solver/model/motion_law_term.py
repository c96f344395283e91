"""The base class of causes that change how the unit executes its commanded moves.

What to use when: derive a cause from `MotionLawTerm` if its effect follows from the commands, not
from the measured angles.
"""

import numpy as np

from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import EDGE_COVARIATES, NO_ANGLES
from gyrorig_solver.model.term_kinds import AngleTerm


class MotionLawTerm(AngleTerm):
    """A cause that needs the commanded moves, and at least one of them."""

    covariates = (*EDGE_COVARIATES, "speed")
    picture = None

    def missing_data(self, state: SignalState) -> str | None:
        """Return why the commanded moves are unknown, or None; counts contain the error."""
        if state.lacks_angles:
            return NO_ANGLES
        has_commands = state.context.rad_per_step is not None and state.context.motion_profiles
        if _moves(state) and not has_commands:
            return "the recording has no commands to the unit; record the commands too"
        return None

    def missing_excitation(self, state: SignalState) -> str | None:
        """Return that the unit does not move, or None."""
        if not state.has_angles:
            return NO_ANGLES
        return None if _moves(state) else "the unit does not move; record a program that moves it"


def _moves(state: SignalState) -> bool:
    """Return whether an axis turns by more than a step."""
    rad_per_step = state.context.rad_per_step
    step_rad = 0.0 if rad_per_step is None else float(np.max(np.abs(rad_per_step)))
    return bool(np.any(np.ptp(state.angle_rad, axis=1) > step_rad))
