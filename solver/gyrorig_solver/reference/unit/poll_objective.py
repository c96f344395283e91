"""Cost of the polled counts for any values of the moves' unknowns and of the motion law.

The weights are those of one fit, so that the costs of two sets of values can be compared. Counts
that the fit did not use are not used here either.

What to use when: `PollObjective.of` at a fit, then `cost` for other values.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.reference.unit.motion_law import MotionLaw
from gyrorig_solver.reference.unit.move_table import MotionParameters, MoveTable
from gyrorig_solver.reference.unit.poll_likelihood import (
    COUNT_PARAMETERS,
    AxisCounts,
    CountParameters,
    PollLikelihood,
)
from gyrorig_solver.reference.unit.rest_variance import DETENT_VARIANCE
from gyrorig_solver.reference.unit.rounded_trajectory import build_executed_trajectories


@dataclass(frozen=True, slots=True, eq=False)
class GaussianWeights:
    """Independent Gaussian priors of the unknowns."""

    weight: FloatArray  # (n,), one over the variance
    mean: FloatArray  # (n,)

    def cost(self, values: FloatArray) -> float:
        """Return the negative logarithm of the prior, nats, up to a constant."""
        return 0.5 * float(self.weight @ (values - self.mean) ** 2)


@dataclass(frozen=True, slots=True, eq=False)
class _WeightedCounts:
    """The used counts of one axis in motion."""

    axis: int
    counts: AxisCounts
    direction: FloatArray  # (n,), 1 or -1
    weight: FloatArray  # (n,)


@dataclass(frozen=True, slots=True, eq=False)
class PollObjective:
    """The cost of counts and priors as a function of the values; weights are constant."""

    pieces: tuple[_WeightedCounts, ...]
    prior: GaussianWeights  # of starts, rests of the count, then shared unknowns
    log_likelihood: float  # of the counts at the fit, nats, with the normalisation of the weights

    @classmethod
    def of(
        cls,
        likelihood: PollLikelihood,
        scatter_s: float,
        spacing_s: FloatArray,
        prior: GaussianWeights,
    ) -> Self:
        """Return the objective with the weights of an evaluated likelihood."""
        pieces = tuple(
            _WeightedCounts(
                int(likelihood.table.axis[piece.move[0]]),
                piece.counts,
                -piece.derivatives[:, 6],
                piece.weight(scatter_s, spacing_s),
            )
            for piece in likelihood.pieces
            if piece.move.size
        )
        return cls(pieces, prior, likelihood.log_likelihood(scatter_s, spacing_s))

    def cost(
        self, table: MoveTable, values: FloatArray, law: MotionLaw, prior: GaussianWeights
    ) -> float:
        """Return the negative log-likelihood of counts and priors, nats, up to a constant.

        Args:
            table: the moves with the recorded settings.
            values: in the order of `MoveFit.values`.
            law: motion law that the unit executes.
            prior: under this law. The delays of other moves give the prior of an unpolled start.
        """
        rest, counted = table.command_count, table.command_count + table.rest_count
        speed = counted + table.rest_count
        acceleration = speed + table.speed_class_count
        stage_rests, counted_rests = values[rest:counted], values[counted:speed]
        parameters = MotionParameters(
            values[:rest], counted_rests, values[speed:acceleration], values[acceleration:][:2]
        )
        count_parameters = CountParameters(*values[-COUNT_PARAMETERS:].tolist())
        trajectories = build_executed_trajectories(table.with_law(law), parameters, law)
        cost = prior.cost(np.concatenate([values[:rest], values[counted:]]))
        cost += 0.5 * float(np.sum((stage_rests - counted_rests) ** 2)) / DETENT_VARIANCE
        for piece in self.pieces:
            counts = piece.counts
            at_s = counts.base_s + count_parameters.delay_share * counts.extra_s
            residual = counts.steps - trajectories[piece.axis].sample(at_s).steps
            residual -= count_parameters.offset_steps - piece.direction * count_parameters.lag_steps
            cost += 0.5 * float(piece.weight @ residual**2)
        return cost
