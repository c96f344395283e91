"""What the boards of one kind are like: mean, true spread, the odd ones, and shrunk values.

What to use when: `population` for one parameter of boards of one kind; `spread_of` for mean
and spread alone; `between` to ask whether lots, rigs or sites differ, `group_means` for how
far each is off; `constants` for what is off on every unit alike. Only raw values come in
here; shrunk ones go out and never come back.

Model: board i has theta_i ~ N(mu, tau^2), its calibration says y_i ~ N(theta_i, s_i^2).
mu and tau^2 by restricted maximum likelihood (Patterson and Thompson 1971; the scatter
minus the calibrations' own variance), the shrunk value is the mean of theta_i given y_i
(Efron and Morris 1973): w y_i + (1 - w) mu with w = tau^2 / (tau^2 + s_i^2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.chance import chi2_tail

IntArray = npt.NDArray[np.intp]

LEAST_BOARDS = 8  # fewer say next to nothing of a spread
ODD_SIGMA = 5.0  # 1 board in 1.7 million by chance, and it does not count for the spread
PRIOR_DOMINATED = 0.5  # less than half of a shrunk value is the board's own data
_ROUNDS = 60
_QUADRATURE = 48
_TOLERANCE = 1e-10


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and true spread of one parameter over some boards, in its unit."""

    boards: int
    mean: float
    mean_std: float
    spread: float  # tau: how much boards truly differ, one standard deviation
    spread_std: float


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """One parameter over the boards of one kind. Units are the parameter's."""

    parameter: str
    boards: int
    mean: float
    mean_std: float
    spread: float  # tau: how much boards truly differ, one standard deviation
    spread_std: float
    equal_p: float  # how likely boards without any spread would scatter so
    odd: BoolArray  # (n,): further from the mean than chance allows
    z: FloatArray  # (n,): how far, in deviations of spread and calibration together
    shrunk: FloatArray  # (n,)
    shrunk_std: FloatArray
    weight: FloatArray  # (n,): of the board's own data in its shrunk value

    @property
    def prior_dominated(self) -> BoolArray:
        """Boards whose shrunk value is more the fleet's than their own."""
        return self.weight < PRIOR_DOMINATED


@dataclass(frozen=True, slots=True, eq=False)
class GroupMeans:
    """How far groups of boards are from each other, by the spread within them."""

    names: list[str]  # of those with a sound board
    mean: FloatArray  # (groups,), in the parameter's unit
    z: FloatArray  # (groups,), of each mean against that of all other groups
    centre: float
    statistic: float  # Cochran's Q


@dataclass(frozen=True, slots=True)
class Between:
    """Whether groups of boards differ by more than boards do."""

    parameter: str
    groups: int
    statistic: float
    p_value: float
    most: str  # the group that is furthest off
    most_by: float  # in the parameter's unit
    most_z: float


def population(parameter: str, value: FloatArray, std: FloatArray) -> Population:
    """Return what boards of one kind are like.

    Args:
        parameter: its name.
        value: one of each board, shape (n,).
        std: their standard deviations, shape (n,), above zero.

    Raises:
        ValueError: fewer than `LEAST_BOARDS`, or a deviation that is none.
    """
    variance = _variance(value, std)
    kept, tau2 = _kept(value, variance)
    found = _spread_over(value, variance, kept, tau2)
    z = (value - found.mean) / np.sqrt(tau2 + variance)
    tau2_std = _information(variance[kept], tau2) ** -0.5
    shrunk, shrunk_std, own = _shrunk(value, variance, kept, tau2, tau2_std)
    return Population(
        parameter=parameter,
        boards=found.boards,
        mean=found.mean,
        mean_std=found.mean_std,
        spread=found.spread,
        spread_std=found.spread_std,
        equal_p=_equal_p(value[kept], variance[kept]),
        odd=np.abs(z) > ODD_SIGMA,
        z=z,
        shrunk=shrunk,
        shrunk_std=shrunk_std,
        weight=own,
    )


def spread_of(value: FloatArray, std: FloatArray) -> Spread:
    """Return mean and true spread of some boards, those beyond `ODD_SIGMA` left out.

    Args:
        value: one of each board, shape (n,).
        std: their standard deviations, shape (n,), above zero.

    Raises:
        ValueError: as `population`.
    """
    variance = _variance(value, std)
    return _spread_over(value, variance, *_kept(value, variance))


def group_means(
    value: FloatArray, std: FloatArray, group: Sequence[str], odd: BoolArray
) -> GroupMeans | None:
    """Return how far groups are from each other; None with fewer than two of them.

    Boards that are odd do not count: within their own group where that has `LEAST_BOARDS`,
    for a lot that is off as a whole is no heap of odd boards; else as `odd` has them.

    Args:
        value: one of each board, shape (n,).
        std: their standard deviations, shape (n,), above zero.
        group: which each belongs to.
        odd: those unlike all boards of their kind, shape (n,).
    """
    names, index = np.unique(np.asarray(group), return_inverse=True)
    if len(names) < 2:
        return None
    variance = std * std
    sound = _sound_within(value, variance, index, ~odd)
    # Within the groups: a bad lot widens the spread of all, and would hide in it.
    _, held_index = np.unique(index[sound], return_inverse=True)
    tau2 = _spread(value[sound], variance[sound], held_index)
    weight = np.where(sound, 1.0 / (tau2 + variance), 0.0)
    total = np.bincount(index, weight, len(names))
    held = total > 0.0
    if held.sum() < 2:
        return None
    means = np.bincount(index, weight * value, len(names))[held] / total[held]
    centre = float(np.average(means, weights=total[held]))
    # the variance of a difference from a mean of which it is a part
    own = 1.0 / total[held] - 1.0 / total[held].sum()
    return GroupMeans(
        names=[str(name) for name in names[held]],
        mean=means,
        z=(means - centre) / np.sqrt(own),
        centre=centre,
        statistic=float((total[held] * (means - centre) ** 2).sum()),
    )


def between(
    found: Population, value: FloatArray, std: FloatArray, group: Sequence[str]
) -> Between | None:
    """Ask whether groups (lots, rigs, sites) differ; None with fewer than two of them.

    The statistic is Cochran's Q over the groups' means with the spread within: chi-squared
    with one degree less than there are groups where they do not differ.
    """
    told = group_means(value, std, group, found.odd)
    if told is None:
        return None
    most = int(np.argmax(np.abs(told.z)))
    return Between(
        parameter=found.parameter,
        groups=len(told.names),
        statistic=told.statistic,
        p_value=chi2_tail(told.statistic, float(len(told.names) - 1)),
        most=told.names[most],
        most_by=float(told.mean[most] - told.centre),
        most_z=float(told.z[most]),
    )


def mahalanobis(z: FloatArray) -> FloatArray:
    """Return how odd each board is over all parameters, chi-squared over their number.

    Args:
        z: standardised deviations, shape (boards, parameters); NaN where there is none.

    Returns:
        Tail probabilities, shape (boards,): by the correlation that boards themselves show.
    """
    known = np.isfinite(z)
    filled = np.clip(np.where(known, z, 0.0), -ODD_SIGMA, ODD_SIGMA)
    pairs = np.maximum(known.T.astype(float) @ known.astype(float), 1.0)
    correlation = filled.T @ filled / pairs
    scale = np.sqrt(np.maximum(np.diag(correlation), 1e-12))
    correlation /= np.outer(scale, scale)
    # a little ridge: few boards make it singular
    ridge = z.shape[1] / max(len(z), 1)
    correlation = (correlation + ridge * np.eye(z.shape[1])) / (1.0 + ridge)
    statistic = np.einsum(
        "ij,ij->i",
        np.where(known, z, 0.0),
        np.linalg.solve(correlation, np.where(known, z, 0.0).T).T,
    )
    return np.array(
        [
            chi2_tail(float(s), float(max(n, 1)))
            for s, n in zip(statistic, known.sum(1), strict=True)
        ]
    )


def _variance(value: FloatArray, std: FloatArray) -> FloatArray:
    if len(value) < LEAST_BOARDS:
        raise ValueError(f"{len(value)} boards are too few for a spread")
    if not (np.all(np.isfinite(value)) and np.all(std > 0.0)):
        raise ValueError("values must be numbers and deviations above zero")
    return std * std


def _kept(value: FloatArray, variance: FloatArray) -> tuple[BoolArray, float]:
    """Return which boards count, and tau^2 of those."""
    kept = _sound(value, variance)
    return kept, _spread(value[kept], variance[kept])


def _spread_over(value: FloatArray, variance: FloatArray, kept: BoolArray, tau2: float) -> Spread:
    weight = 1.0 / (tau2 + variance[kept])
    spread = float(np.sqrt(tau2))
    tau2_std = _information(variance[kept], tau2) ** -0.5
    return Spread(
        boards=len(value),
        mean=float(np.average(value[kept], weights=weight)),
        mean_std=float(weight.sum() ** -0.5),
        spread=spread,
        spread_std=tau2_std / (2.0 * spread) if spread else np.inf,
    )


def _information(variance: FloatArray, tau2: float) -> float:
    """Return Fisher's information of tau^2."""
    return 0.5 * float((1.0 / (tau2 + variance) ** 2).sum())


def _equal_p(value: FloatArray, variance: FloatArray) -> float:
    """Return how likely boards that all are the same scatter so (Cochran 1954)."""
    weight = 1.0 / variance
    left = value - np.average(value, weights=weight)
    return chi2_tail(float((weight * left * left).sum()), float(len(value) - 1))


def _sound(value: FloatArray, variance: FloatArray) -> BoolArray:
    """Return which boards count for mean and spread: found from the middle of all."""
    centre = float(np.median(value))
    # the middle half of a normal distribution spans 1.349 deviations
    low, high = np.quantile(value, [0.25, 0.75])
    spread2 = max(((high - low) / 1.349) ** 2 - float(np.median(variance)), 0.0)
    far = np.abs(value - centre) > ODD_SIGMA * np.sqrt(spread2 + variance)
    if far.sum() > len(value) // 2:  # no middle to speak of
        far[:] = False
    kept: BoolArray = ~far
    return kept


def _sound_within(
    value: FloatArray, variance: FloatArray, index: IntArray, sound: BoolArray
) -> BoolArray:
    """Return which boards count beside others of their group, `sound` where those are few.

    From the middle of each group, by one spread for all: a group's own quartiles are too rough.
    """
    large = (np.bincount(index) >= LEAST_BOARDS)[index]
    if not large.any():
        return sound
    off = np.zeros_like(value)
    for at in np.unique(index[large]):
        here = index == at
        off[here] = value[here] - np.median(value[here])
    # half of a normal distribution lies within 0.6745 deviations
    spread2 = (float(np.median(np.abs(off[large]))) / 0.6745) ** 2
    spread2 = max(spread2 - float(np.median(variance[large])), 0.0)
    near = np.abs(off) <= ODD_SIGMA * np.sqrt(spread2 + variance)
    kept: BoolArray = np.where(large, near, sound)
    return kept


def _spread(value: FloatArray, variance: FloatArray, group: IntArray | None = None) -> float:
    """Return tau^2 that maximises the restricted likelihood, 0 where the scatter is too small.

    Each group, or all boards, has a mean of its own. Fisher scoring: the score is
    -tr(P)/2 + y'PPy/2 and the information tr(PP)/2, with P the projection of the weights
    off the means (Harville 1977, equations 3.2 and 4.1).
    """
    index = np.zeros(len(value), dtype=np.intp) if group is None else group
    groups = int(index.max()) + 1
    tau2 = max(float(np.var(value, ddof=1) - variance.mean()), 0.0)
    scale = float(np.var(value, ddof=1)) or 1.0
    for _ in range(_ROUNDS):
        weight = 1.0 / (tau2 + variance)
        total, squares, cubes, sums = (
            np.bincount(index, one, groups)
            for one in (weight, weight**2, weight**3, weight * value)
        )
        left = value - (sums / total)[index]
        trace = float((total - squares / total).sum())
        information = 0.5 * float((squares - 2.0 * cubes / total + (squares / total) ** 2).sum())
        score = 0.5 * (float((weight * weight * left * left).sum()) - trace)
        new = max(tau2 + score / information, 0.0) if information > 0.0 else tau2
        if abs(new - tau2) <= _TOLERANCE * scale:
            return new
        tau2 = new
    return tau2


def _shrunk(
    value: FloatArray, variance: FloatArray, kept: BoolArray, tau2: float, tau2_std: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return shrunk values, their deviations and the weights of the boards' own data.

    The spread is known only so well; taken for certain, the deviations come out too small
    (Morris 1983). So everything is averaged over the restricted likelihood of tau^2, flat in
    tau^2 as there, and what the averaging itself adds is counted.
    """
    top = np.sqrt(tau2 + 4.0 * tau2_std)
    tau = (np.arange(_QUADRATURE) + 0.5) / _QUADRATURE * top
    weight = 1.0 / (tau[:, None] ** 2 + variance[kept])  # (tau, boards)
    total = weight.sum(axis=1)
    mean = (weight * value[kept]).sum(axis=1) / total
    left = value[kept] - mean[:, None]
    cost = -np.log(weight).sum(axis=1) + np.log(total) + (weight * left * left).sum(axis=1)
    share = tau * np.exp(-0.5 * (cost - cost.min()))  # d(tau^2) = 2 tau d(tau)
    share /= share.sum()
    own = tau[:, None] ** 2 / (tau[:, None] ** 2 + variance)
    each = own * value + (1.0 - own) * mean[:, None]
    shrunk = share @ each
    spread2 = share @ (own * variance + (1.0 - own) ** 2 / total[:, None])
    spread2 = spread2 + share @ (each - shrunk) ** 2
    return shrunk, np.sqrt(spread2), share @ own
