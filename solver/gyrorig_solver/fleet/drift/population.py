"""Population statistics of one parameter: mean, spread between boards, outliers and shrinkage.

What to use when: `fit_population` for one parameter of the boards of one sensor; `fit_spread` for
mean and spread alone; `cochran_q_test` to test whether lots, rigs or sites differ; `group_means`
for the deviation of each group. Only values from calibrations are inputs; shrinkage estimates are
outputs and are never used as inputs.

Model: board i has theta_i ~ N(mu, tau^2), its calibration gives y_i ~ N(theta_i, s_i^2). mu and
tau^2 are estimated by restricted maximum likelihood (Patterson and Thompson 1971). The shrinkage
estimate is the mean of theta_i given y_i (Efron and Morris 1973): w y_i + (1 - w) mu with
w = tau^2 / (tau^2 + s_i^2).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt
from scipy import special

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.numerics import chi2_upper_tail, f_upper_tail, normal_score

IntArray = npt.NDArray[np.intp]

MIN_BOARDS = 8  # fewer do not determine a spread
OUTLIER_SIGMA = 5.0  # 1 board in 1.7 million by chance; outliers do not count for the spread
# Of a healthy board that quartiles or medians of few boards, which are uncertain, exclude.
_OUTLIER_TAIL_PROBABILITY = 1e-4
_MEDIAN_EFFICIENCY = 0.37  # of these, relative to the standard deviation: Huber 1981, section 5.1
PRIOR_DOMINATED_BELOW_WEIGHT = 0.5  # the estimate is mostly the fleet's mean
_MAX_ITERATIONS = 60
_QUADRATURE_POINTS = 48
_TOLERANCE = 1e-10


@dataclass(frozen=True, slots=True)
class SpreadEstimate:
    """Mean and spread of one parameter over boards, in its unit."""

    boards: int
    mean: float
    mean_std: float
    spread: float  # tau: standard deviation between boards
    spread_std: float


@dataclass(frozen=True, slots=True, eq=False)
class Population(SpreadEstimate):
    """One parameter over the boards of one sensor. Units are the parameter's."""

    parameter: str
    homogeneity_p_value: float  # of Cochran's test that all boards are equal
    is_outlier: BoolArray  # (n,): beyond `OUTLIER_SIGMA`
    z: FloatArray  # (n,): deviation over that of spread and calibration together
    shrunk: FloatArray  # (n,)
    shrunk_std: FloatArray
    own_data_weight: FloatArray  # (n,): weight of the board's calibration in its estimate

    @property
    def prior_dominated(self) -> BoolArray:
        """Boards whose shrinkage estimate is mostly the fleet's mean."""
        return self.own_data_weight < PRIOR_DOMINATED_BELOW_WEIGHT


@dataclass(frozen=True, slots=True, eq=False)
class GroupMeans:
    """Means of groups of boards, compared by the spread within groups."""

    names: list[str]  # of groups with an inlier
    mean: FloatArray  # (groups,), in the parameter's unit
    z: FloatArray  # (groups,), normal scores of each mean minus that of all other groups
    centre: float
    statistic: float  # Cochran's Q
    degrees_of_freedom: int  # of the spread within groups: inliers minus groups


@dataclass(frozen=True, slots=True)
class GroupDifference:
    """Result of Cochran's test that groups of boards have the same mean."""

    parameter: str
    group_count: int
    statistic: float
    p_value: float
    extreme_group: str  # the group with the largest deviation
    extreme_offset: float  # in the parameter's unit
    extreme_z: float


def fit_population(parameter: str, value: FloatArray, std: FloatArray) -> Population:
    """Estimate mean, spread, outliers and shrinkage estimates of the boards of one sensor.

    Args:
        parameter: its name.
        value: one per board, shape (n,).
        std: their standard deviations, shape (n,), above zero.

    Raises:
        ValueError: fewer than `MIN_BOARDS` boards, or an invalid standard deviation.
    """
    variance = _checked_variance(value, std)
    is_inlier, tau2 = _inliers_and_variance(value, variance)
    estimate = _spread_estimate(value, variance, is_inlier, tau2)
    z = (value - estimate.mean) / np.sqrt(tau2 + variance)
    tau2_std = _fisher_information(variance[is_inlier], tau2) ** -0.5
    shrunk, shrunk_std, own_weight = _shrinkage_estimates(
        value, variance, is_inlier, tau2, tau2_std
    )
    return Population(
        **asdict(estimate),
        parameter=parameter,
        homogeneity_p_value=_homogeneity_p_value(value[is_inlier], variance[is_inlier]),
        is_outlier=np.abs(z) > OUTLIER_SIGMA,
        z=z,
        shrunk=shrunk,
        shrunk_std=shrunk_std,
        own_data_weight=own_weight,
    )


def fit_spread(value: FloatArray, std: FloatArray) -> SpreadEstimate:
    """Return mean and spread of boards, without outliers beyond `OUTLIER_SIGMA`.

    Args:
        value: one per board, shape (n,).
        std: their standard deviations, shape (n,), above zero.

    Raises:
        ValueError: as `fit_population`.
    """
    variance = _checked_variance(value, std)
    return _spread_estimate(value, variance, *_inliers_and_variance(value, variance))


def group_means(
    value: FloatArray, std: FloatArray, group: Sequence[str], is_outlier: BoolArray
) -> GroupMeans | None:
    """Return the means of groups and their differences; None if they cannot be compared.

    At least two groups are needed, and a group of two boards: the spread within groups is not
    known otherwise. This spread is estimated; therefore the normal scores are those of Student's t.

    Outliers do not count. In a group of `MIN_BOARDS` they are found within the group, because a
    lot that is off as a whole does not consist of outliers; else they are those of `is_outlier`.

    Args:
        value: one per board, shape (n,).
        std: their standard deviations, shape (n,), above zero.
        group: name of each board's group.
        is_outlier: outliers among all boards of the sensor, shape (n,).
    """
    names, index = np.unique(np.asarray(group), return_inverse=True)
    if len(names) < 2:
        return None
    variance = std * std
    is_inlier = _inliers_within_groups(value, variance, index, ~is_outlier)
    has_inliers = np.bincount(index, is_inlier, len(names)) > 0.0
    degrees_of_freedom = int(is_inlier.sum() - has_inliers.sum())
    if has_inliers.sum() < 2 or degrees_of_freedom < 1:
        return None
    # The spread within groups: a bad lot would increase a spread over all boards and hide in it.
    _, inlier_group_index = np.unique(index[is_inlier], return_inverse=True)
    tau2 = _reml_variance(value[is_inlier], variance[is_inlier], inlier_group_index)
    weight = np.where(is_inlier, 1.0 / (tau2 + variance), 0.0)
    total_weight = np.bincount(index, weight, len(names))[has_inliers]
    means = np.bincount(index, weight * value, len(names))[has_inliers] / total_weight
    centre = float(np.average(means, weights=total_weight))
    # variance of the difference to a mean that includes the group itself
    difference_variance = 1.0 / total_weight - 1.0 / total_weight.sum()
    return GroupMeans(
        names=[str(name) for name in names[has_inliers]],
        mean=means,
        z=normal_score((means - centre) / np.sqrt(difference_variance), degrees_of_freedom),
        centre=centre,
        statistic=float((total_weight * (means - centre) ** 2).sum()),
        degrees_of_freedom=degrees_of_freedom,
    )


def cochran_q_test(
    fitted: Population, value: FloatArray, std: FloatArray, group: Sequence[str]
) -> GroupDifference | None:
    """Test whether groups (lots, rigs, sites) differ; None if they cannot be compared.

    The statistic is Cochran's Q of the groups' means, with the spread within groups. If the
    groups do not differ, Q over its degrees of freedom, one less than groups, has an F
    distribution, because the spread is estimated. This is the F test of the analysis of variance
    (Fisher 1925) if all calibrations have the same uncertainty.
    """
    means = group_means(value, std, group, fitted.is_outlier)
    if means is None:
        return None
    extreme = int(np.argmax(np.abs(means.z)))
    between_degrees = len(means.names) - 1
    return GroupDifference(
        parameter=fitted.parameter,
        group_count=len(means.names),
        statistic=means.statistic,
        p_value=f_upper_tail(
            means.statistic / between_degrees, between_degrees, means.degrees_of_freedom
        ),
        extreme_group=means.names[extreme],
        extreme_offset=float(means.mean[extreme] - means.centre),
        extreme_z=float(means.z[extreme]),
    )


def _checked_variance(value: FloatArray, std: FloatArray) -> FloatArray:
    if len(value) < MIN_BOARDS:
        raise ValueError(f"{len(value)} boards are too few for a spread")
    if not (np.all(np.isfinite(value)) and np.all(std > 0.0)):
        raise ValueError("values must be finite and standard deviations above zero")
    return std * std


def _inliers_and_variance(value: FloatArray, variance: FloatArray) -> tuple[BoolArray, float]:
    """Return which boards are inliers, and their tau^2."""
    is_inlier = _inliers(value, variance)
    return is_inlier, _reml_variance(value[is_inlier], variance[is_inlier])


def _spread_estimate(
    value: FloatArray, variance: FloatArray, is_inlier: BoolArray, tau2: float
) -> SpreadEstimate:
    weight = 1.0 / (tau2 + variance[is_inlier])
    spread = float(np.sqrt(tau2))
    tau2_std = _fisher_information(variance[is_inlier], tau2) ** -0.5
    return SpreadEstimate(
        boards=len(value),
        mean=float(np.average(value[is_inlier], weights=weight)),
        mean_std=float(weight.sum() ** -0.5),
        spread=spread,
        spread_std=tau2_std / (2.0 * spread) if spread else np.inf,
    )


def _fisher_information(variance: FloatArray, tau2: float) -> float:
    """Return the Fisher information of tau^2."""
    return 0.5 * float((1.0 / (tau2 + variance) ** 2).sum())


def _homogeneity_p_value(value: FloatArray, variance: FloatArray) -> float:
    """Return the p value of the test that all boards are equal (Cochran 1954)."""
    weight = 1.0 / variance
    residual = value - np.average(value, weights=weight)
    return chi2_upper_tail(float((weight * residual * residual).sum()), float(len(value) - 1))


def _inliers(value: FloatArray, variance: FloatArray) -> BoolArray:
    """Return the inliers, found with median and quartiles."""
    centre = float(np.median(value))
    # the interquartile range of a normal distribution is 1.349 standard deviations
    low, high = np.quantile(value, [0.25, 0.75])
    spread2 = max(((high - low) / 1.349) ** 2 - float(np.median(variance)), 0.0)
    is_far = np.abs(value - centre) > _outlier_limit(len(value) - 1) * np.sqrt(spread2 + variance)
    if is_far.sum() > len(value) // 2:  # the quartiles mean nothing here
        is_far[:] = False
    is_inlier: BoolArray = ~is_far
    return is_inlier


def _outlier_limit(degrees_of_freedom: int) -> float:
    """Return the limit of inliers in robust standard deviations, wider for few boards."""
    effective_degrees = _MEDIAN_EFFICIENCY * degrees_of_freedom
    quantile = -float(special.stdtrit(effective_degrees, 0.5 * _OUTLIER_TAIL_PROBABILITY))
    return max(OUTLIER_SIGMA, quantile)


def _inliers_within_groups(
    value: FloatArray, variance: FloatArray, index: IntArray, fallback: BoolArray
) -> BoolArray:
    """Return the inliers within each group, `fallback` in small groups.

    They are found from the median of each group, with one spread for all groups, because the
    quartiles of one group are too uncertain.
    """
    in_large_group = (np.bincount(index) >= MIN_BOARDS)[index]
    if not in_large_group.any():
        return fallback
    deviation = np.zeros_like(value)
    for group_number in np.unique(index[in_large_group]):
        in_group = index == group_number
        deviation[in_group] = value[in_group] - np.median(value[in_group])
    # half of a normal distribution is within 0.6745 standard deviations
    spread2 = (float(np.median(np.abs(deviation[in_large_group]))) / 0.6745) ** 2
    spread2 = max(spread2 - float(np.median(variance[in_large_group])), 0.0)
    limit = _outlier_limit(int(in_large_group.sum()) - len(np.unique(index[in_large_group])))
    is_near = np.abs(deviation) <= limit * np.sqrt(spread2 + variance)
    is_inlier: BoolArray = np.where(in_large_group, is_near, fallback)
    return is_inlier


def _reml_variance(value: FloatArray, variance: FloatArray, group: IntArray | None = None) -> float:
    """Return the REML estimate of tau^2, 0 if the scatter is smaller than the uncertainties.

    Each group has its own mean; without groups, all boards share one. Fisher scoring: the score
    is -tr(P)/2 + y'PPy/2 and the information tr(PP)/2, where P projects the weights orthogonally
    to the means (Harville 1977, equations 3.2 and 4.1).
    """
    index = np.zeros(len(value), dtype=np.intp) if group is None else group
    groups = int(index.max()) + 1
    tau2 = max(float(np.var(value, ddof=1) - variance.mean()), 0.0)
    scale = float(np.var(value, ddof=1)) or 1.0
    for _ in range(_MAX_ITERATIONS):
        weight = 1.0 / (tau2 + variance)
        weight_sum, weight2_sum, weight3_sum, value_sum = (
            np.bincount(index, power, groups)
            for power in (weight, weight**2, weight**3, weight * value)
        )
        residual = value - (value_sum / weight_sum)[index]
        trace = float((weight_sum - weight2_sum / weight_sum).sum())
        information = 0.5 * float(
            (weight2_sum - 2.0 * weight3_sum / weight_sum + (weight2_sum / weight_sum) ** 2).sum()
        )
        score = 0.5 * (float((weight * weight * residual * residual).sum()) - trace)
        next_tau2 = max(tau2 + score / information, 0.0) if information > 0.0 else tau2
        if abs(next_tau2 - tau2) <= _TOLERANCE * scale:
            return next_tau2
        tau2 = next_tau2
    return tau2


def _shrinkage_estimates(
    value: FloatArray, variance: FloatArray, is_inlier: BoolArray, tau2: float, tau2_std: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return shrinkage estimates, standard deviations and the weights of the boards' own data.

    Treating the estimated spread as exact makes the standard deviations too small (Morris 1983).
    Therefore all results are averaged over the restricted likelihood of tau^2, with a flat prior
    in tau^2 as there, and the variance between the averaged values is added.
    """
    tau_limit = np.sqrt(tau2 + 4.0 * tau2_std)
    tau = (np.arange(_QUADRATURE_POINTS) + 0.5) / _QUADRATURE_POINTS * tau_limit
    weight = 1.0 / (tau[:, None] ** 2 + variance[is_inlier])  # (tau, boards)
    total_weight = weight.sum(axis=1)
    mean = (weight * value[is_inlier]).sum(axis=1) / total_weight
    residual = value[is_inlier] - mean[:, None]
    minus_two_log_likelihood = (
        -np.log(weight).sum(axis=1)
        + np.log(total_weight)
        + (weight * residual * residual).sum(axis=1)
    )
    posterior = tau * np.exp(
        -0.5 * (minus_two_log_likelihood - minus_two_log_likelihood.min())
    )  # d(tau^2) = 2 tau d(tau)
    posterior /= posterior.sum()
    own_weight = tau[:, None] ** 2 / (tau[:, None] ** 2 + variance)
    conditional_mean = own_weight * value + (1.0 - own_weight) * mean[:, None]
    shrunk = posterior @ conditional_mean
    spread2 = posterior @ (own_weight * variance + (1.0 - own_weight) ** 2 / total_weight[:, None])
    spread2 = spread2 + posterior @ (conditional_mean - shrunk) ** 2
    return shrunk, np.sqrt(spread2), posterior @ own_weight
