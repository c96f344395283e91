"""Uncertainty of the factors S, T and M and of other parameters, from that of the gain.

In a direction that the data do not determine, the prior is used: a board can differ from nominal by
a tenth. A derivative is not sufficient for such a range. `scale.x` is the length of row x of G. Its
derivative by the entry xy vanishes at the nominal gain, but an entry of 0.06 changes it by 0.06^2/2
= 1.8e-3. Therefore directions with a standard deviation above `LINEAR_STD` are propagated through
the factorisation, by Gauss-Hermite quadrature with three points in each direction. This is exact
for a quadratic function and its square.

What to use when: `propagate_to_factors` for any covariance of derived numbers;
`is_observable_number` for the rule that decides which of them are null.
"""

from dataclasses import dataclass
from itertools import product
from typing import Self

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.model import FACTOR_NAMES, GainFactors, factor_jacobian, factorise
from gyrorig_solver.model.gain_matrix import factorise_near

FACTOR_COUNT = len(FACTOR_NAMES)
# Gauss-Hermite quadrature, order 3, of a standard normal variable (Abramowitz, Stegun 25.4.46).
NODES = (-float(np.sqrt(3.0)), 0.0, float(np.sqrt(3.0)))
WEIGHTS = (1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0)
# A direction with a narrower prior of the gain is propagated to first order. The error of the
# derivative, 0.005^2/2, is 1.5 % of the variance of the best scale factors (std 1e-4).
LINEAR_STD = 0.005
NEGLIGIBLE_SHARE = 1e-9  # of a typical value, in its standard deviation


@dataclass(frozen=True, slots=True, eq=False)
class FactorCovariance:
    """The nine factors and the other numbers, with both parts of their uncertainty.

    Attributes:
        values: of the factors, then of the other numbers, shape (n,). NaN if the gain is singular.
        jacobian: of those numbers by the gain and the other parameters, shape (n, n).
        data: covariance from the data, shape (n, n).
        prior: second moment of the change of each number, from its stated value, if the parameters
            vary along the unobservable directions with the prior; variance and squared mean shift,
            shape (n, n). Infinite on the diagonal of factors that are not defined everywhere in the
            prior's range.
    """

    values: FloatArray
    jacobian: FloatArray
    data: FloatArray
    prior: FloatArray

    @property
    def total(self) -> FloatArray:
        """The data's covariance plus the prior's second moment, shape (n, n)."""
        return self.data + self.prior

    def is_observable(self, typical_std: FloatArray) -> BoolArray:
        """Return which numbers the data determine, shape (n,).

        Args:
            typical_std: prior standard deviation of each number, shape (n,).
        """
        return is_observable_number(np.diag(self.data), np.diag(self.prior), typical_std)


def is_observable_number(
    data_variance: FloatArray, prior_variance: FloatArray, typical_std: FloatArray
) -> BoolArray:
    """Return which numbers get no more variance from the prior than from the data."""
    negligible = (NEGLIGIBLE_SHARE * typical_std) ** 2
    return np.asarray(
        (prior_variance <= np.maximum(data_variance, negligible))
        & (data_variance > 0.0)
        & np.isfinite(data_variance),
        dtype=np.bool_,
    )


def propagate_to_factors(
    estimate: FloatArray, covariance: FloatArray, unobservable_covariance: FloatArray
) -> FactorCovariance:
    """Propagate the uncertainty of a gain and of other parameters to S, T, M and those others.

    Args:
        estimate: the gain, row by row, then other parameters, shape (n,).
        covariance: of the same, from the data, shape (n, n), as in `ObservabilityAnalysis`.
        unobservable_covariance: of the same, from the prior, shape (n, n).
    """
    gain = estimate[:FACTOR_COUNT].reshape(3, 3)
    try:
        factors = factorise(gain)
    except ValueError:
        return _undefined_factors(estimate, covariance, unobservable_covariance)
    jacobian = np.eye(estimate.size)
    jacobian[:FACTOR_COUNT, :FACTOR_COUNT] = factor_jacobian(factors)
    data = jacobian @ covariance @ jacobian.T
    prior = jacobian @ unobservable_covariance @ jacobian.T
    wide = _WideDirections.of(gain, unobservable_covariance)
    if wide.std.size:
        prior = prior + wide.excess(jacobian, unobservable_covariance)
        prior = prior + wide.mixed_moment(covariance)
    values = np.concatenate([factors.as_vector(), estimate[FACTOR_COUNT:]])
    return FactorCovariance(values, jacobian, data, prior)


@dataclass(frozen=True, slots=True, eq=False)
class _WideDirections:
    """The unobservable directions in which the gain's prior is wider than `LINEAR_STD`.

    Attributes:
        factors: of the estimate.
        vectors: unit vectors, shape (9, k).
        std: standard deviation along each, shape (k,).
        nodes: quadrature nodes in standard deviations, shape (m, k).
        weights: of the nodes, shape (m,).
        change: of the factors at each node, shape (m, 9); NaN if they are not defined.
    """

    factors: GainFactors
    vectors: FloatArray
    std: FloatArray
    nodes: FloatArray
    weights: FloatArray
    change: FloatArray

    @classmethod
    def of(cls, gain: FloatArray, covariance: FloatArray) -> Self:
        """Return the directions of the prior's covariance, whose first nine rows are the gain's."""
        variances, vectors = np.linalg.eigh(covariance[:FACTOR_COUNT, :FACTOR_COUNT])
        wide = variances > LINEAR_STD**2
        std, vectors = np.sqrt(variances[wide]), vectors[:, wide]
        nodes = np.array(list(product(NODES, repeat=std.size)))
        weights = np.prod(np.array(list(product(WEIGHTS, repeat=std.size))), axis=1)
        factors = factorise(gain)
        gains = gain + (nodes @ (vectors * std).T).reshape(-1, 3, 3)
        change = factorise_near(gains, factors) - factors.as_vector()
        return cls(factors, vectors, std, nodes, weights, change)

    def excess(self, jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return the prior's second moment minus its first-order part, shape (n, n).

        Args:
            jacobian: of all numbers at the estimate, shape (n, n).
            covariance: of the prior, shape (n, n).
        """
        excess = np.zeros_like(covariance)
        of_factors, of_others = slice(0, FACTOR_COUNT), slice(FACTOR_COUNT, None)
        if not np.isfinite(self.change).all():
            excess[of_factors, of_factors] = np.diag(np.full(FACTOR_COUNT, np.inf))
            return excess
        slopes = jacobian[of_factors, of_factors] @ (self.vectors * self.std)
        weighted = (self.weights[:, None] * self.change).T
        excess[of_factors, of_factors] = weighted @ self.change - slopes @ slopes.T
        # The other parameters are linear in the gain's directions.
        other_slopes = covariance[of_others, of_factors] @ (self.vectors / self.std)
        cross = (weighted @ self.nodes - slopes) @ other_slopes.T
        excess[of_factors, of_others], excess[of_others, of_factors] = cross, cross.T
        return excess

    def mixed_moment(self, covariance: FloatArray) -> FloatArray:
        """Return the second moment of products of these directions with the data's errors, (n, n).

        A number can depend on the product of an observable and an unobservable entry.

        Args:
            covariance: of the gain and the other parameters, from the data, shape (n, n).
        """
        moment = np.zeros_like(covariance)
        if not np.isfinite(self.change).all():
            return moment
        of_factors = slice(0, FACTOR_COUNT)
        for k in range(self.std.size):
            along = self.nodes[:, k] * (np.count_nonzero(self.nodes, axis=1) == 1)
            ends = [
                factor_jacobian(GainFactors.from_vector(self.factors.as_vector() + change))
                for change in (self.change[np.argmax(along)], self.change[np.argmin(along)])
            ]
            slope = (ends[0] - ends[1]) / (2.0 * NODES[-1])
            moment[of_factors, of_factors] += slope @ covariance[of_factors, of_factors] @ slope.T
        return moment


def _undefined_factors(
    estimate: FloatArray, covariance: FloatArray, unobservable_covariance: FloatArray
) -> FactorCovariance:
    """Return null factors: with nominal values in unobservable places, the gain is singular."""
    values, data, prior = estimate.copy(), covariance.copy(), unobservable_covariance.copy()
    jacobian = np.eye(estimate.size)
    values[:FACTOR_COUNT] = jacobian[:FACTOR_COUNT, :FACTOR_COUNT] = np.nan
    for part in (data, prior):
        part[:FACTOR_COUNT] = part[:, :FACTOR_COUNT] = 0.0
    prior[:FACTOR_COUNT, :FACTOR_COUNT] = np.diag(np.full(FACTOR_COUNT, np.inf))
    return FactorCovariance(values, jacobian, data, prior)
