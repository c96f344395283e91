"""The base class of causes that change how the unit executes its commanded moves.

What to use when: derive a cause from `MotionLawTerm` if its effect follows from the commands, not
from the measured angles.
"""

import numpy as np

from gyrorig_solver.model.cause_categories import EDGE_COVARIATES
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term_kinds import AngleTerm


class MotionLawTerm(AngleTerm):
    """A cause that needs the commanded moves, and at least one of them."""

    covariates = (*EDGE_COVARIATES, "speed")
    picture = None

    def missing_data(self, state: SignalState) -> str | None:
        """Return why the commanded moves are unknown, or None; counts contain the error."""
        has_commands = state.context.rad_per_step is not None and state.context.motion_profiles
        if _moves(state) and not has_commands:
            return "the recording has no commands to the unit; record the commands too"
        return super().missing_data(state)

    def missing_excitation(self, state: SignalState) -> str | None:
        """Return that the unit does not move, or None."""
        missing = super().missing_excitation(state)
        if missing is None and not _moves(state):
            return "the unit does not move; record a program that moves it"
        return missing


def _moves(state: SignalState) -> bool:
    """Return whether an axis turns by more than a step."""
    rad_per_step = state.context.rad_per_step
    step_rad = 0.0 if rad_per_step is None else float(np.max(np.abs(rad_per_step)))
    return bool(np.any(np.ptp(state.angle_rad, axis=1) > step_rad))
