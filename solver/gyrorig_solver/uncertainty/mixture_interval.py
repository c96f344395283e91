"""Intervals of parameters whose error comes from causes that are present or absent.

A cause is present with a probability p; then its sizes are N(0, 1). A configuration is the set of
the causes that are present. With F, s and A the information, score and influence of its sizes
(see `marginal_covariance`), a configuration has

    probability  ~ prod p / (1 - p) |F + 1|^-1/2 exp(s' C s / 2),  C = (F + 1)^-1
    error        N(A' C s, A' C A), without the noise

so the error is a mixture of normal distributions. The interval is symmetric about the stated value.
If every cause is certain, p = 1, the mixture is one normal distribution.

The sum over configurations starts without causes. It adds and removes one cause at a time, the most
probable configuration first. Causes without information in the data stay independent.

What to use when: `error_mixture` for the distribution; `ErrorMixture.expanded_uncertainty` for an
interval.

Sources: JCGM 101:2008, 5.3 and 7.7 (interval of a distribution that is not normal); Madigan and
Raftery, J. Am. Stat. Assoc. 89 (1994) 1535 (sum over the most probable models).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import ndtr

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.numerics import positive_part, posterior_covariance

# Relative to the most probable configuration: less probable ones are not followed, or not counted.
FOLLOWED_SHARE, COUNTED_SHARE = 1e-2, 1e-5
MAX_FOLLOWED = 32  # configurations
UNSEEN_INFORMATION = 0.01  # of a cause's sizes; the data leave 99 % of the prior variance
MAX_UNSEEN = 8  # causes with a separate component of the mixture; the others add their variance
NEGLIGIBLE_SHARE = 1e-6  # of a variance, and of the probability
BISECTIONS = 40  # to 1e-11 of the first bracket
BRACKET_STD = 9.0


@dataclass(frozen=True, slots=True, eq=False)
class UncertainSizes:
    """Information of the data on the sizes of causes, and the effect of the sizes on q parameters.

    The sizes of a cause that may be absent are in units of their standard deviation if present.
    """

    information: FloatArray  # (k, k), all fitted parameters eliminated
    score: FloatArray  # (k,)
    influence: FloatArray  # (k, q), error of each parameter by one unit of a size
    cause: IntArray  # (k,), the cause of each size
    probability: FloatArray  # (causes,), that it is present
    prior_covariance: FloatArray  # (k, k), of the sizes of certain causes
    prior_mean: FloatArray  # (k,), of the same sizes


@dataclass(frozen=True, slots=True, eq=False)
class ErrorMixture:
    """The distribution of the errors of q parameters that causes make, without the noise."""

    weight: FloatArray  # (m,), sum 1
    mean: FloatArray  # (m, q)
    variance: FloatArray  # (m, q)

    @classmethod
    def normal(cls, mean: FloatArray, variance: FloatArray) -> Self:
        """Return one normal distribution; mean and variance (q,)."""
        return cls(np.ones(1), mean[None, :], variance[None, :])

    def expanded_uncertainty(self, noise_std: FloatArray, probability: float) -> FloatArray:
        """Return U of each parameter, (q,): the error is in the interval 0 ± U.

        Args:
            noise_std: standard uncertainty from noise, (q,); NaN gives NaN.
            probability: of the interval.
        """
        # The normal distribution of a correction can have a little less variance than the noise.
        variance = np.maximum(self.variance + noise_std**2, NEGLIGIBLE_SHARE * noise_std**2)
        std = np.sqrt(np.maximum(variance, np.finfo(float).tiny))
        low = np.zeros(noise_std.size)
        high = (np.abs(self.mean) + BRACKET_STD * std).max(axis=0)
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            inside = ndtr((middle - self.mean) / std) - ndtr((-middle - self.mean) / std)
            is_narrow = self.weight @ inside < probability
            low, high = np.where(is_narrow, middle, low), np.where(is_narrow, high, middle)
        return np.asarray(0.5 * (low + high), dtype=np.float64)

    def with_independent(self, probability: float, mean: FloatArray, variance: FloatArray) -> Self:
        """Return the mixture with one more, independent cause; mean and variance (q,)."""
        weight = np.concatenate([self.weight * (1.0 - probability), self.weight * probability])
        counted = weight >= NEGLIGIBLE_SHARE * weight.max()
        return type(self)(
            weight[counted] / weight[counted].sum(),
            np.vstack([self.mean, self.mean + mean])[counted],
            np.vstack([self.variance, self.variance + variance])[counted],
        )


def error_mixture(sizes: UncertainSizes) -> ErrorMixture:
    """Return the distribution of the errors given the data and the priors."""
    is_certain = sizes.probability[sizes.cause] >= 1.0
    certain, rest = _split_certain(sizes, is_certain)
    causes = [np.flatnonzero(rest.cause == k) for k in np.unique(rest.cause)]
    probability = rest.probability[np.unique(rest.cause)]
    is_seen = np.array([np.trace(rest.information[np.ix_(g, g)]) for g in causes])
    is_seen = is_seen >= UNSEEN_INFORMATION
    seen = [group for group, known in zip(causes, is_seen, strict=True) if known]
    mixture = certain
    if seen:
        added = _Configurations(rest, seen, probability[is_seen]).mixture()
        mixture = ErrorMixture(
            added.weight, added.mean + certain.mean, added.variance + certain.variance
        )
    unseen = [group for group, known in zip(causes, is_seen, strict=True) if not known]
    return _with_unseen(mixture, rest, unseen, probability[~is_seen])


def _split_certain(
    sizes: UncertainSizes, is_certain: BoolArray
) -> tuple[ErrorMixture, UncertainSizes]:
    """Return the error from the certain causes, and the other sizes with these marginalised."""
    certain, rest = np.flatnonzero(is_certain), np.flatnonzero(~is_certain)
    prior = sizes.prior_covariance[np.ix_(certain, certain)]
    information = positive_part(sizes.information)
    among = information[np.ix_(certain, certain)]
    cross = information[np.ix_(rest, certain)]
    covariance = posterior_covariance(among, prior)
    prior_mean = sizes.prior_mean[certain]
    mean = prior_mean + covariance @ (sizes.score[certain] - among @ prior_mean)
    influence = sizes.influence[certain]
    moved = covariance @ influence
    error = ErrorMixture.normal(mean @ influence, np.sum(influence * moved, axis=0))
    return error, UncertainSizes(
        information=positive_part(information[np.ix_(rest, rest)] - cross @ covariance @ cross.T),
        score=sizes.score[rest] - cross @ mean,
        influence=sizes.influence[rest] - cross @ moved,
        cause=sizes.cause[rest],
        probability=sizes.probability,
        prior_covariance=np.eye(rest.size),
        prior_mean=np.zeros(rest.size),
    )


def _with_unseen(
    mixture: ErrorMixture,
    sizes: UncertainSizes,
    causes: list[IntArray],
    probability: FloatArray,
) -> ErrorMixture:
    """Return the mixture with the causes about which the data contain no information.

    The causes with the largest shares of a variance get a separate component. The others add their
    variance, because a sum of many causes is nearly normal.
    """
    if not causes:
        return mixture
    added = np.stack([np.sum(sizes.influence[group] ** 2, axis=0) for group in causes])
    mean_square = probability[:, None] * added
    whole = mixture.weight @ (mixture.variance + mixture.mean**2) + mean_square.sum(axis=0)
    share = np.max(mean_square / np.where(whole > 0.0, whole, 1.0), axis=1)
    order = np.argsort(-share, kind="stable")
    for k in order[:MAX_UNSEEN]:
        if share[k] > NEGLIGIBLE_SHARE:
            mixture = mixture.with_independent(
                float(probability[k]), np.zeros(added.shape[1]), added[k]
            )
    others = mean_square[order[MAX_UNSEEN:]].sum(axis=0)
    return ErrorMixture(mixture.weight, mixture.mean, mixture.variance + others)


@dataclass(frozen=True, slots=True, eq=False)
class _ConfigurationError:
    """The error if a configuration is present."""

    log_weight: float  # of its probability, relative to that of no cause
    mean: FloatArray  # (q,)
    variance: FloatArray  # (q,)


class _Configurations:
    """The probable configurations of the causes about which the data contain information."""

    def __init__(
        self, sizes: UncertainSizes, causes: list[IntArray], probability: FloatArray
    ) -> None:
        """Start without causes.

        Args:
            sizes: of causes that may be absent.
            causes: the sizes of each, at least one cause.
            probability: of each.
        """
        count, parameters = sizes.influence.shape
        self._causes = causes
        self._log_odds = np.log(probability) - np.log1p(-probability)
        # A dummy size, without information and influence, pads the causes that have fewer sizes.
        self._index = np.full((len(causes), max(group.size for group in causes)), count)
        for row, group in zip(self._index, causes, strict=True):
            row[: group.size] = group
        self._information = np.zeros((count + 1, count + 1))
        self._information[:count, :count] = sizes.information
        # Score and influence are columns of one array, because both are reduced in the same way.
        self._targets = np.zeros((count + 1, 1 + parameters))
        self._targets[:count, 0], self._targets[:count, 1:] = sizes.score, sizes.influence
        self._errors: dict[frozenset[int], _ConfigurationError] = {}
        self._best = 0.0
        self._add(frozenset(), 0.0, np.zeros(parameters), np.zeros(parameters))

    def mixture(self) -> ErrorMixture:
        """Return the errors, weighted with the probabilities of the configurations."""
        followed: set[frozenset[int]] = set()
        while len(followed) < MAX_FOLLOWED:
            limit = self._best + np.log(FOLLOWED_SHARE)
            waiting = {
                key: error.log_weight
                for key, error in self._errors.items()
                if error.log_weight > limit and key not in followed
            }
            if not waiting:
                break
            key = max(waiting, key=lambda other: waiting[other])
            followed.add(key)
            self._remove_each(key)
            self._add_each(key)
        limit = self._best + np.log(COUNTED_SHARE)
        counted = [error for error in self._errors.values() if error.log_weight > limit]
        weight = np.exp(np.array([error.log_weight for error in counted]) - self._best)
        return ErrorMixture(
            weight / weight.sum(),
            np.stack([error.mean for error in counted]),
            np.stack([error.variance for error in counted]),
        )

    def _add(
        self, key: frozenset[int], log_weight: float, mean: FloatArray, variance: FloatArray
    ) -> None:
        self._errors[key] = _ConfigurationError(log_weight, mean, variance)
        self._best = max(self._best, log_weight)

    def _remove_each(self, key: frozenset[int]) -> None:
        """Evaluate the configurations with one cause less."""
        for cause in key:
            fewer = key - {cause}
            if fewer in self._errors:
                continue
            sizes = self._sizes_of(fewer)
            block = self._information[np.ix_(sizes, sizes)][None]
            log_factor, mean, variance = _gains(block, self._targets[sizes][None])
            log_weight = float(log_factor[0]) + sum(self._log_odds[k] for k in fewer)
            self._add(fewer, log_weight, mean[0], variance[0])

    def _add_each(self, key: frozenset[int]) -> None:
        """Evaluate the configurations with one cause more, all at once."""
        others = [k for k in range(len(self._causes)) if k not in key]
        if not others:
            return
        index = self._index[others]
        block = self._information[index[:, :, None], index[:, None, :]]
        targets = self._targets[index]
        if key:
            sizes = self._sizes_of(key)
            root = np.linalg.cholesky(np.eye(sizes.size) + self._information[np.ix_(sizes, sizes)])
            known = np.linalg.solve(
                root, np.hstack([self._information[sizes], self._targets[sizes]])
            )
            count = len(self._information)
            reduction = known[:, index].transpose(1, 2, 0)  # (others, sizes of one, sizes)
            block = block - reduction @ reduction.transpose(0, 2, 1)
            targets = targets - reduction @ known[:, count:]
        log_factor, mean, variance = _gains(block, targets)
        before = self._errors[key]
        limit = self._best + np.log(COUNTED_SHARE)
        for k, cause in enumerate(others):
            more = key | {cause}
            log_weight = before.log_weight + float(log_factor[k] + self._log_odds[cause])
            if log_weight > limit and more not in self._errors:
                self._add(more, log_weight, before.mean + mean[k], before.variance + variance[k])

    def _sizes_of(self, key: frozenset[int]) -> IntArray:
        groups = [self._causes[k] for k in sorted(key)]
        return np.concatenate([np.zeros(0, dtype=np.int64), *groups])


def _gains(block: FloatArray, targets: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what causes add to a configuration: log Bayes factor, mean and variance of errors.

    Args:
        block: information on the sizes of each cause, (n, w, w).
        targets: their score and influence, (n, w, 1 + q).
    """
    values, vectors = np.linalg.eigh(block)
    scale = 1.0 / np.sqrt(1.0 + np.clip(values, 0.0, None))  # rounding can give less than zero
    whitened = scale[:, :, None] * (vectors.transpose(0, 2, 1) @ targets)
    score, influence = whitened[:, :, 0], whitened[:, :, 1:]
    log_factor = np.sum(np.log(scale) + 0.5 * score**2, axis=1)
    mean = np.einsum("nw,nwq->nq", score, influence)
    return log_factor, mean, np.sum(influence**2, axis=1)
