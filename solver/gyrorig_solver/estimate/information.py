"""What a motion tells about gain, bias and time offset: the information of a fit.

The information does not depend on the counts, so the same functions serve the fit itself,
the check of a recording before any fit, and a program that was never run.

What to use when: `marginalise` for a fit's normal equations; `motion_information` for a
motion and a noise without counts; `white_information` for a quick look in white noise.
"""

from dataclasses import dataclass
from itertools import chain

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.arrow import Arrow, eliminate
from gyrorig_solver.estimate.noise import NoiseModel
from gyrorig_solver.estimate.normal import Normal, NormalSum
from gyrorig_solver.estimate.observability import BIAS_NAMES
from gyrorig_solver.estimate.predict import predict_columns, predict_rate
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.estimate.whitening import OWN, PartModel, WhitePart
from gyrorig_solver.model.gain import GAIN_NAMES
from gyrorig_solver.reference.motion import ReferenceMotion

NAMES = (*GAIN_NAMES, *BIAS_NAMES, "time_offset")


@dataclass(frozen=True, slots=True, eq=False)
class Marginal:
    """Information and score of the board's own parameters, the reference's taken out."""

    information: FloatArray  # (p, p)
    score: FloatArray  # (p,)
    _shared: FloatArray  # (g, p + 1), how the reference's shared unknowns follow
    _local: FloatArray  # (m, p + g + 1), how its local ones do

    def nuisance(self, step: FloatArray) -> FloatArray:
        """Return the step of the reference's unknowns (local, shared) that goes with one."""
        shared = self._shared[:, -1] - self._shared[:, :-1] @ step
        both = np.concatenate([step, shared])
        local = self._local[:, -1] - self._local[:, :-1] @ both
        return np.concatenate([local, shared])


def marginalise(total: Normal, reference: ReferenceMotion, own: int = OWN) -> Marginal:
    """Put in what the reference knows of its unknowns, and take those out.

    Args:
        total: normal equations over (local | own, shared unknowns that act on the rate).
        reference: holds the knowledge, local unknowns first.
        own: how many parameters are the board's.
    """
    known = reference.information
    local, shared = known.size
    acting = total.matrix.size[1] - own
    pull = known.times(reference.pull)
    size = own + shared
    matrix = Arrow.zero(local, size)
    matrix.cross[:, : own + acting] = total.matrix.cross
    matrix.cross[:, own:] += known.cross
    matrix.shared[: own + acting, : own + acting] = total.matrix.shared
    matrix.shared[own:, own:] += known.shared
    score = np.zeros(local + size)
    score[: local + own + acting] = total.score
    score[:local] += pull[:local]
    score[local + own :] += pull[local:]
    left = eliminate(
        Arrow((total.matrix.local + known.local).tocsc(), matrix.cross, matrix.shared), score
    )
    mine, rest = slice(0, own), slice(own, None)
    bound = np.column_stack([left.information[rest, mine], left.score[rest]])
    carry = np.asarray(np.linalg.solve(left.information[rest, rest], bound), dtype=np.float64)
    both = np.column_stack([left.information[mine, mine], left.score[mine]])
    both = both - left.information[mine, rest] @ carry
    return Marginal(both[:, :-1], both[:, -1], carry, left.carry)


def loosened(information: FloatArray, index: int, std: float) -> FloatArray:
    """Return the information after independent noise of `std` enters one parameter."""
    if std <= 0.0:
        return information
    column = information[:, index]
    # Woodbury: (C + s^2 e e')^-1 = I - I e e' I / (1/s^2 + e' I e).
    lost = np.outer(column, column) / (std**-2 + information[index, index])
    return np.asarray(information - lost, dtype=np.float64)


def motion_information(
    series: Series, reference: ReferenceMotion, noise: NoiseModel, gain: FloatArray
) -> FloatArray:
    """Return what samples of a motion would tell, the reference's unknowns marginalised.

    Args:
        series: when the samples are; their rates are not looked at.
        reference: the stage's motion, on the same time axis.
        noise: of the samples' block means.
        gain: G at which derivatives are taken, shape (3, 3).

    Returns:
        Information over `NAMES`, shape (13, 13).
    """
    local, _ = reference.information.size
    parts = series.parts()
    models = (_part(series, blocks, reference) for blocks in parts)
    white = (WhitePart.of(model, gain, noise) for model in models)
    first = next(white)
    total = NormalSum(noise, local, first.size)
    for part in chain([first], white):
        total.add(part, np.zeros_like(part.deviation), whole=len(parts) == 1)
    return marginalise(total.total(), reference).information


def _part(series: Series, blocks: slice, reference: ReferenceMotion) -> PartModel:
    sampled = predict_rate(series, blocks, reference, 0.0)
    use = series.good[series.samples_of(blocks)] & sampled.known
    return PartModel(
        rate=series.means(sampled.rate, use),
        used=series.used(use),
        terms=np.zeros((0, blocks.stop - blocks.start, 3)),
        columns=predict_columns(series, blocks, reference, 0.0),
    )


def white_information(
    rate_rad_s: FloatArray, step_s: float, density: FloatArray, loose: FloatArray | None = None
) -> FloatArray:
    """Return what a motion that is nearly known tells in white noise.

    Args:
        rate_rad_s: stage rate on a uniform grid, shape (n, 3).
        step_s: of the grid.
        density: one-sided noise density of each sensor axis, (rad/s)^2/Hz, shape (3,).
        loose: how the stage rate changes with each of the motion's unknowns, taken in
            units of what is not known of it, shape (k, n, 3). They are marginalised.

    Returns:
        Information over `NAMES` at nominal gain, shape (13, 13).
    """
    turning = np.gradient(rate_rad_s, step_s, axis=0)
    design = np.column_stack([rate_rad_s, np.ones(len(rate_rad_s)), -turning])
    gram = design.T @ design * (2.0 * step_s)
    information = np.zeros((13, 13))
    count = 0 if loose is None else loose.shape[0]
    cross, inner = np.zeros((13, count)), np.eye(count)
    for axis in range(3):
        at = [3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis, 12]
        # A later sample tells of an earlier rate: the offset's column is the turning, negated.
        of = [0, 1, 2, 3, 4 + axis]
        information[np.ix_(at, at)] += gram[np.ix_(of, of)] / density[axis]
        if loose is not None:
            weighed = loose[:, :, axis] * (2.0 * step_s / density[axis])
            cross[at] += (weighed @ design[:, of]).T
            inner += weighed @ loose[:, :, axis].T
    return np.asarray(information - cross @ np.linalg.solve(inner, cross.T), dtype=np.float64)
