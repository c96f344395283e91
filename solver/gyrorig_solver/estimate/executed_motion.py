"""The motion law of a model, and the position replies under it.

Some causes change the motion law of the unit: its acceleration, its base speed, its rounded
corners. The replies follow the executed motion, so the likelihood of a model contains the replies
under the law of that model. Therefore they have information about the values of these causes.

What to use when: `follow_law` after the causes of a fit have changed; `law_columns` and
`follow_replies` for the parameters that the replies determine; `executed_motion` for derivatives;
`reference_cost` and `reference_decrease` for the reference's part of the objective.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.linear.normal_equations import NormalEquations
from gyrorig_solver.numerics import ArrowheadMatrix
from gyrorig_solver.reference import (
    LAW_QUANTITIES,
    LAW_VALUES,
    LawProfile,
    MotionLaw,
    PanTiltReference,
    ReferenceMotion,
)
from gyrorig_solver.reference.unit.motion_law import RECORDED_LAW


@dataclass(frozen=True, slots=True, eq=False)
class LawColumns:
    """The fitted values of a law: their positions among a board's parameters, and in the law."""

    parameters: IntArray  # (k,)
    law_values: IntArray  # (k,), in the order of `MotionLaw.of_values`

    def profile(self, reference: ReferenceMotion) -> LawProfile | None:
        """Return the information of the replies on these values; None without values or replies."""
        if not self.parameters.size or not isinstance(reference, PanTiltReference):
            return None
        return reference.law_profile(self.law_values)


NO_LAW_COLUMNS = LawColumns(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))


def law_columns(fitted_terms: Sequence[FittedTerm], first: int) -> LawColumns:
    """Return the columns of the fitted values that belong to the motion law.

    Args:
        fitted_terms: of a fit.
        first: position of their first value among the parameters.
    """
    parameters: list[int] = []
    law_values: list[int] = []
    for fitted_term in fitted_terms:
        law_first = _first_law_value(fitted_term)
        if law_first is not None:
            parameters += range(first, first + fitted_term.free_indices.size)
            law_values += (law_first + fitted_term.free_indices).tolist()
        first += fitted_term.free_indices.size
    return LawColumns(np.array(parameters, dtype=np.int64), np.array(law_values, dtype=np.int64))


def follow_law(reference: ReferenceMotion, fitted_terms: Sequence[FittedTerm]) -> ReferenceMotion:
    """Return the reference under the motion law of some causes."""
    if not isinstance(reference, PanTiltReference):
        return reference
    law_terms = [term for term in fitted_terms if _first_law_value(term) is not None]
    if not law_terms:
        return reference.with_law(RECORDED_LAW)
    values, is_fitted = np.zeros(LAW_VALUES), np.zeros(LAW_VALUES, dtype=np.bool_)
    for fitted_term in law_terms:
        first = _first_law_value(fitted_term) or 0
        values[first : first + 2] += fitted_term.values
        is_fitted[first + fitted_term.free_indices] = True
    # The acceleration is one unknown: the value of the cause replaces that of the moves.
    pan, tilt = (is_fitted[:2] | (values[:2] != 0.0)).tolist()
    law = MotionLaw.of_values(values, (pan, tilt), reference.rad_per_step)
    return reference.with_law(law)


def executed_motion(reference: ReferenceMotion) -> ReferenceMotion:
    """Return the motion under the law of the model, for derivatives."""
    return reference.executed if isinstance(reference, PanTiltReference) else reference


def reference_cost(reference: ReferenceMotion) -> float:
    """Return the negative logarithm of the prior of the reference's unknowns, nats.

    For a unit it is the likelihood of the replies under the law of the model, relative to the
    likelihood under the recorded settings.
    """
    if isinstance(reference, PanTiltReference):
        return reference.cost
    offset = reference.prior_offset
    return 0.5 * float(offset @ reference.information.multiply(offset)) if offset.size else 0.0


def reference_decrease(before: ReferenceMotion, after: ReferenceMotion) -> float:
    """Return the decrease of the reference's cost by a step, at constant weights, nats."""
    if isinstance(before, PanTiltReference) and isinstance(after, PanTiltReference):
        return before.cost_decrease(after)
    return reference_cost(before) - reference_cost(after)


def replace_law_derivatives(
    cause_derivatives: FloatArray,
    fitted_terms: Sequence[FittedTerm],
    law: FloatArray,
    gain: FloatArray,
    pass_through: FloatArray | None,
) -> None:
    """Take the derivatives by the values of the law from the executed motion, in place.

    They nearly cancel with the shift of the starts, so both must have the same grid.

    Args:
        cause_derivatives: by all fitted values, (k, n, 3), sensor frame.
        fitted_terms: the causes of the fit.
        law: derivatives of the stage rate, (6, 3, n); empty without a law.
        gain: G, shape (3, 3).
        pass_through: share of a change that passes the clipping, (n, 3); None: everything passes.
    """
    columns = law_columns(fitted_terms, 0)
    if not law.size:
        return
    for parameter, value in zip(columns.parameters, columns.law_values, strict=True):
        derivative = (gain @ law[value]).T
        cause_derivatives[parameter] = (
            derivative if pass_through is None else derivative * pass_through
        )


def follow_replies(
    equations: NormalEquations, board_parameters: int, positions: IntArray, profile: LawProfile
) -> NormalEquations:
    """Return a recording's equations if the moves follow the replies under each value of the law.

    The unknowns of the moves become relative to the fit of the replies, and the information of the
    replies about the law is added.

    Args:
        equations: over (local | board, shared unknowns that act on the rate).
        board_parameters: number of the board's parameters.
        positions: of the law's values among these, (k,).
        profile: of these values.
    """
    matrix, score = equations.matrix, equations.score
    local, width = matrix.size
    # The new columns are the old ones times this unit matrix with the shift of the moves.
    local_shift = profile.shift[:local]
    shared_shift = profile.shift[local : local + width - board_parameters]
    change = np.eye(width)
    change[board_parameters:, positions] = shared_shift
    along_shift = np.zeros((local, width))
    along_shift[:, positions] = matrix.local @ local_shift
    cross_shift = np.zeros((width, width))
    cross_shift[:, positions] = change.T @ matrix.cross.T @ local_shift
    shared = change.T @ matrix.shared @ change + cross_shift + cross_shift.T
    shared[np.ix_(positions, positions)] += local_shift.T @ along_shift[:, positions]
    shared[np.ix_(positions, positions)] += profile.information
    shared_score = change.T @ score[local:]
    shared_score[positions] += local_shift.T @ score[:local] + profile.score
    return NormalEquations(
        ArrowheadMatrix(matrix.local, matrix.cross @ change + along_shift, shared),
        np.concatenate([score[:local], shared_score]),
    )


def _first_law_value(fitted_term: FittedTerm) -> int | None:
    quantity = fitted_term.term.law_quantity
    return None if quantity is None else 2 * LAW_QUANTITIES.index(quantity)
