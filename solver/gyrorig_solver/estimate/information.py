"""What a motion tells about gain, bias and time offset: the information of a fit.

The information does not depend on the counts, so the same functions serve the fit itself,
the check of a recording before any fit, and a program that was never run.

What to use when: `marginalise` for a fit's normal equations; `motion_information` for a
motion and a noise without counts; `white_information` for a quick look in white noise.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.noise import NoiseModel
from gyrorig_solver.estimate.normal import Normal, block_model, normal_equations
from gyrorig_solver.estimate.observability import BIAS_NAMES
from gyrorig_solver.estimate.series import Series, predict
from gyrorig_solver.model.gain import GAIN_NAMES
from gyrorig_solver.reference.motion import ReferenceMotion

NAMES = (*GAIN_NAMES, *BIAS_NAMES, "time_offset")


@dataclass(frozen=True, slots=True, eq=False)
class Marginal:
    """Information and score of the board's 13 parameters, the reference's taken out."""

    information: FloatArray  # (13, 13)
    score: FloatArray  # (13,)
    carry: FloatArray  # (k, 14), how the reference's unknowns follow the board's

    def nuisance(self, step: FloatArray) -> FloatArray:
        """Return the step of the reference's unknowns (shared, local) that goes with one."""
        return np.asarray(self.carry[:, -1] - self.carry[:, :-1] @ step, dtype=np.float64)


def marginalise(total: Normal, reference: ReferenceMotion, shared: int) -> Marginal:
    """Put in what the reference knows of its unknowns, and take those out.

    Args:
        total: normal equations over (G, b, tau, shared, local).
        reference: holds the knowledge, local unknowns first.
        shared: how many of its unknowns act everywhere.
    """
    known, pull = reference.information.to_dense(), reference.information.times(reference.pull)
    local = known.shape[0] - shared
    order = np.concatenate([local + np.arange(shared), np.arange(local)]).astype(np.int64)
    information, score = total.information.copy(), total.score.copy()
    information[13:, 13:] += known[np.ix_(order, order)]
    score[13:] += pull[order]
    own, rest = slice(0, 13), slice(13, None)
    bound = np.column_stack([information[rest, own], score[rest]])
    carry = np.asarray(np.linalg.solve(information[rest, rest], bound), dtype=np.float64)
    both = np.column_stack([information[own, own], score[own]])
    left = np.asarray(both - information[own, rest] @ carry, dtype=np.float64)
    return Marginal(left[:, :-1], left[:, -1], carry)


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
    predicted = predict(series, reference, 0.0)
    model = block_model(series, predicted, series.good & predicted.known)
    total = normal_equations(model, gain, np.zeros_like(model.measured), noise)
    return marginalise(total, reference, int(model.shared.shape[0])).information


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
