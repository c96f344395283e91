"""Swapped axes: the words are read in the wrong order, or the driver is for another part.

y' = P y, where P exchanges two axes. The gain and the bias absorb it completely: the gain is then
far from any rotation that a mount can have. The nearest signed permutation identifies the swap.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.link_remedies import WRONG_AXES
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm

PAIRS = ((0, 1), (1, 2), (2, 0))


class AxisSwap(LinearTerm):
    """1 for a swapped pair, 0 for any other pair."""

    cause = "axis_swap"
    title = "Two axes are swapped"
    equation = "y = P y, where P exchanges the axes of `exchanged`"
    part = "link"
    stage = "readout"
    kind = "gauge"
    parameters = (
        size_parameter(
            "exchanged", "1", ("xy", "yz", "zx"), typical=1.0, lower=0.0, limit=1.0, prior_std=1.0
        ),
    )
    confused_with = ("sign_flip",)
    remedy = "correct the order of the axes in the driver or in the board's columns"
    file_remedy = WRONG_AXES.file
    covariates = None
    is_configuration_error = True
    picture = None
    excitation = "any motion, and a comparison of the gain's axes with the mount of the board"
    effect_if_ignored = (
        "none, because the calibration is valid for the axes in this order; only the mount angles "
        "differ"
    )

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the difference of each pair on both of its axes, (3, blocks, 3)."""
        rate = state.sample_output(state.filtered_rad_s) + state.bias_rad_s
        signals = np.zeros((3, state.block_count, 3))
        for k, (first_axis, second_axis) in enumerate(PAIRS):
            signals[k, :, first_axis] = rate[:, second_axis] - rate[:, first_axis]
            signals[k, :, second_axis] = rate[:, first_axis] - rate[:, second_axis]
        return signals

    def describe(self, values: FloatArray) -> str:
        swapped = [
            name
            for name, value in zip(("x and y", "y and z", "z and x"), values, strict=True)
            if value > 0.5
        ]
        return f"swapped axes: {'; '.join(swapped) or 'none'}"


TERM = AxisSwap()
