"""Covariance of parameters that are fitted together with causes of a prior size.

The model is y = J p + B c + noise, with p the fitted parameters and c the sizes of causes in units
of their prior standard deviations, c ~ N(0, 1). The fit left c out. With F the information on c and
s its score, both orthogonal to J, and A the change of p per unit of c that the fit makes:

    covariance of c given the data  C = (F + 1)^-1,  mean  m = C s
    covariance of p                 C_p + A' C A

This is the covariance of p in a ridge fit of [J, B] with the prior on c. A cause that the data
exclude has a large F and adds almost nothing. A cause that the data cannot show has F = 0 and adds
its prior. The fit that left c out is wrong by A' m on average. Its mean squared error given the
data is therefore C_p + A' C A + (A' m)(A' m)': a known correction that is not applied adds its
square.

Sources: JCGM 100:2008, 4.3 and F.2.4.5; Schmidt, Advances in Control Systems 3 (1966) 293.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class MarginalCauses:
    """The posterior of the sizes of k causes, and their contribution to q parameters."""

    covariance: FloatArray  # (k, k), of the sizes in units of their prior
    mean: FloatArray  # (k,), in the same units
    influence: FloatArray  # (k, q), change of each parameter that one unit of a size makes

    @classmethod
    def of(cls, information: FloatArray, score: FloatArray, influence: FloatArray) -> Self:
        """Combine the information of the data with the priors.

        Args:
            information: on the sizes, with all fitted parameters eliminated, (k, k).
            score: of the residual, with all fitted parameters eliminated, (k,).
            influence: see the class.
        """
        values, vectors = np.linalg.eigh(0.5 * (information + information.T))
        # Rounding makes an eigenvalue slightly negative if the fit absorbs an effect completely.
        covariance = (vectors / (1.0 + np.clip(values, 0.0, None))) @ vectors.T
        return cls(covariance, covariance @ score, influence)

    @property
    def parameter_covariance(self) -> FloatArray:
        """Contribution of the sizes, which the data leave uncertain, to the covariance, (q, q)."""
        return np.asarray(self.influence.T @ self.covariance @ self.influence, dtype=np.float64)

    @property
    def expected_error(self) -> FloatArray:
        """Expected error, given the data, of a fit without the causes, (q,)."""
        return np.asarray(self.mean @ self.influence, dtype=np.float64)

    def mean_square_without(self, group: IntArray) -> FloatArray:
        """Return the part of the mean squared error that vanishes with a group of causes, (q,).

        The group's sizes count as known to be zero; the others keep their information. Groups that
        resemble each other can have a part in common, so the sum may exceed the whole. A group
        alone never exceeds it. The part is zero if the group only cancels the error of others.
        """
        moved = self.covariance[group] @ self.influence
        weight = np.linalg.solve(
            self.covariance[np.ix_(group, group)], np.column_stack([moved, self.mean[group]])
        )
        variance = np.sum(moved * weight[:, :-1], axis=0)
        error_without = self.expected_error - weight[:, -1] @ moved
        saved = variance + self.expected_error**2 - error_without**2
        return np.asarray(np.clip(saved, 0.0, None), dtype=np.float64)
