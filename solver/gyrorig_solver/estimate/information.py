"""Fisher information of a motion about gain, bias and time offset.

The information does not depend on the counts. The same functions therefore serve the fit, the check
of a recording before a fit, and a motion program that was never executed.

What to use when: `marginalise` for a fit's normal equations; `motion_information` for a motion and
a noise without counts; `white_noise_information` for an approximation in white noise.
"""

from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.sparse import diags_array

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.executed_motion import (
    NO_LAW_COLUMNS,
    LawColumns,
    follow_replies,
)
from gyrorig_solver.estimate.linear.normal_equations import NormalEquations, NormalEquationsSum
from gyrorig_solver.estimate.linear.whitening import BASE_PARAMETERS, PartModel, WhitenedPart
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.estimate.observability import BIAS_NAMES
from gyrorig_solver.estimate.reference_prediction import predict_derivatives, predict_rate
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.model import GAIN_NAMES
from gyrorig_solver.numerics import ArrowheadMatrix, eliminate_local
from gyrorig_solver.reference import ReferenceMotion

PARAMETER_NAMES = (*GAIN_NAMES, *BIAS_NAMES, "time_offset")


@dataclass(frozen=True, slots=True, eq=False)
class MarginalEquations:
    """Information and score of the board's parameters, with the reference's unknowns eliminated."""

    information: FloatArray  # (p, p)
    score: FloatArray  # (p,)
    _shared: FloatArray  # (g, p + 1), back substitution of the shared unknowns
    _local: FloatArray  # (m, p + g + 1), back substitution of the local unknowns

    def nuisance_step(self, step: FloatArray) -> FloatArray:
        """Return the step of the reference's unknowns (local, shared) for a step of the board's."""
        shared = self._shared[:, -1] - self._shared[:, :-1] @ step
        all_shared = np.concatenate([step, shared])
        local = self._local[:, -1] - self._local[:, :-1] @ all_shared
        return np.concatenate([local, shared])


def marginalise(
    equations: NormalEquations,
    reference: ReferenceMotion,
    board_parameters: int = BASE_PARAMETERS,
    columns: LawColumns = NO_LAW_COLUMNS,
) -> MarginalEquations:
    """Add the prior of the reference's unknowns, and eliminate these unknowns (Schur complement).

    Args:
        equations: over (local | board, shared unknowns that act on the rate).
        reference: has the prior, local unknowns first.
        board_parameters: number of the board's parameters.
        columns: the parameters that belong to the motion law.
    """
    return RecordingEquations.of(equations, reference, board_parameters, columns).marginalise()


@dataclass(frozen=True, slots=True, eq=False)
class RecordingEquations:
    """One recording's equations over (local | board, shared), with the reference's prior."""

    matrix: ArrowheadMatrix
    score: FloatArray  # local unknowns first
    board_parameters: int

    @classmethod
    def of(
        cls,
        equations: NormalEquations,
        reference: ReferenceMotion,
        board_parameters: int,
        columns: LawColumns = NO_LAW_COLUMNS,
    ) -> "RecordingEquations":
        """Add the prior of the reference's unknowns; arguments as in `marginalise`."""
        profile = columns.profile(reference)
        if profile is not None:
            equations = follow_replies(equations, board_parameters, columns.parameters, profile)
        prior = reference.information
        local, shared = prior.size
        acting_shared = equations.matrix.size[1] - board_parameters
        pull = prior.multiply(reference.prior_offset)
        size = board_parameters + shared
        matrix = ArrowheadMatrix.zero(local, size)
        matrix.cross[:, : board_parameters + acting_shared] = equations.matrix.cross
        matrix.cross[:, board_parameters:] += prior.cross
        matrix.shared[: board_parameters + acting_shared, : board_parameters + acting_shared] = (
            equations.matrix.shared
        )
        matrix.shared[board_parameters:, board_parameters:] += prior.shared
        score = np.zeros(local + size)
        score[: local + board_parameters + acting_shared] = equations.score
        score[:local] += pull[:local]
        score[local + board_parameters :] += pull[local:]
        local_information = (equations.matrix.local + prior.local).tocsc()
        return cls(
            ArrowheadMatrix(local_information, matrix.cross, matrix.shared),
            score,
            board_parameters,
        )

    def marginalise(self, damping: float = 0.0) -> MarginalEquations:
        """Eliminate the reference's unknowns.

        `damping`: share of the diagonal that is added to it (Levenberg-Marquardt).
        """
        matrix = self._damped(damping) if damping else self.matrix
        complement = eliminate_local(matrix, self.score)
        board, nuisance = slice(0, self.board_parameters), slice(self.board_parameters, None)
        coupling = np.column_stack(
            [complement.information[nuisance, board], complement.score[nuisance]]
        )
        back_substitution = np.asarray(
            np.linalg.solve(complement.information[nuisance, nuisance], coupling), dtype=np.float64
        )
        reduced = np.column_stack([complement.information[board, board], complement.score[board]])
        reduced = reduced - complement.information[board, nuisance] @ back_substitution
        return MarginalEquations(
            reduced[:, :-1], reduced[:, -1], back_substitution, complement.back_substitution
        )

    def predicted_decrease(self, step: FloatArray, nuisance_step: FloatArray) -> float:
        """Return the decrease of the quadratic model after a step, nats.

        Args:
            step: of the board's parameters.
            nuisance_step: of the reference's unknowns, local unknowns first.
        """
        local = self.matrix.size[0]
        full = np.concatenate([nuisance_step[:local], step, nuisance_step[local:]])
        return float(self.score @ full - 0.5 * full @ self.matrix.multiply(full))

    def _damped(self, damping: float) -> ArrowheadMatrix:
        local, shared = self.matrix.local, self.matrix.shared
        return ArrowheadMatrix(
            (local + diags_array(damping * local.diagonal())).tocsc(),
            self.matrix.cross,
            shared + np.diag(damping * np.diag(shared)),
        )


def add_parameter_noise(information: FloatArray, index: int, std: float) -> FloatArray:
    """Return the information after independent noise of `std` is added to one parameter."""
    if std <= 0.0:
        return information
    column = information[:, index]
    # Woodbury: (C + s^2 e e')^-1 = I - I e e' I / (1/s^2 + e' I e).
    loss = np.outer(column, column) / (std**-2 + information[index, index])
    return np.asarray(information - loss, dtype=np.float64)


def motion_information(
    series: Series, reference: ReferenceMotion, noise: NoiseModel, gain: FloatArray
) -> FloatArray:
    """Return the information of samples of a motion, with the reference's unknowns marginalised.

    Args:
        series: times of the samples; their rates are not used.
        reference: the stage's motion, on the same time axis.
        noise: of the samples' block means.
        gain: G at which derivatives are taken, shape (3, 3).

    Returns:
        Information over `PARAMETER_NAMES`, shape (13, 13).
    """
    local, _ = reference.information.size
    parts = series.part_slices()
    models = (_part_model(series, blocks, reference) for blocks in parts)
    whitened_parts = (WhitenedPart.of(model, gain, noise) for model in models)
    first = next(whitened_parts)
    total = NormalEquationsSum(noise, local, first.size)
    for part in chain([first], whitened_parts):
        total.add(part, np.zeros_like(part.std), is_whole_series=len(parts) == 1)
    return marginalise(total.total(), reference).information


def _part_model(series: Series, blocks: slice, reference: ReferenceMotion) -> PartModel:
    sampled = predict_rate(series, blocks, reference, 0.0)
    used = series.good[series.samples_of_blocks(blocks)] & sampled.known
    return PartModel(
        rate=series.block_means(sampled.rate, used),
        used=series.used_blocks(used),
        cause_derivatives=np.zeros((0, blocks.stop - blocks.start, 3)),
        columns=predict_derivatives(series, blocks, reference, 0.0),
    )


def white_noise_information(
    rate_rad_s: FloatArray,
    step_s: float,
    density: FloatArray,
    motion_derivatives: FloatArray | None = None,
) -> FloatArray:
    """Return the information of a nearly known motion in white noise.

    Args:
        rate_rad_s: stage rate on a uniform grid, shape (n, 3).
        step_s: of the grid.
        density: one-sided noise density of each sensor axis, (rad/s)^2/Hz, shape (3,).
        motion_derivatives: of the stage rate by each of the motion's unknowns, in units of its
            standard deviation, shape (k, n, 3). They are marginalised.

    Returns:
        Information over `PARAMETER_NAMES` at nominal gain, shape (13, 13).
    """
    rate_slope = np.gradient(rate_rad_s, step_s, axis=0)
    design = np.column_stack([rate_rad_s, np.ones(len(rate_rad_s)), -rate_slope])
    gram = design.T @ design * (2.0 * step_s)
    information = np.zeros((13, 13))
    count = 0 if motion_derivatives is None else motion_derivatives.shape[0]
    cross, prior_information = np.zeros((13, count)), np.eye(count)
    for axis in range(3):
        parameters = [3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis, 12]
        # A late sample shows an earlier rate: the offset's column is minus the rate's derivative.
        columns = [0, 1, 2, 3, 4 + axis]
        information[np.ix_(parameters, parameters)] += (
            gram[np.ix_(columns, columns)] / density[axis]
        )
        if motion_derivatives is not None:
            weighted = motion_derivatives[:, :, axis] * (2.0 * step_s / density[axis])
            cross[parameters] += (weighted @ design[:, columns]).T
            prior_information += weighted @ motion_derivatives[:, :, axis].T
    return np.asarray(
        information - cross @ np.linalg.solve(prior_information, cross.T), dtype=np.float64
    )
