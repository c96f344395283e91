"""What the data can show: a rank test on the scale of what is physically possible.

Parameters have different units, so a bare condition number says nothing. Here each
direction of parameter space is measured in units of its prior: how far a real board's
value may lie from nominal. A direction that the data fixes to no better than half of
that is not observed: its value stays null, whatever a solver would print for it.
(SciPy returns success with 1.75 or 15.6 for an unexcited parameter of true value 0.03;
peers' notes, section 4.)
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.result import Observability
from gyrorig_solver.model.gain import FACTOR_NAMES, factor_jacobian, factorise

BIAS_NAMES = ("bias.x", "bias.y", "bias.z")

# How far real parts lie from nominal. Gain entries: scale +-15 % worst (L3G4200D family),
# mount and cross-axis a few degrees. Bias: +-25 dps worst. Offset: a loaded link.
PRIOR_STD = {"gain": 0.1, "bias": 0.45, "time_offset": 0.1}
# A direction counts as observed when the data alone gives half its prior or better.
OBSERVED_BELOW = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """The split of parameter space into what the data shows and what it does not."""

    covariance: FloatArray  # (n, n), from the data, zero along unobserved directions
    hidden: FloatArray  # (n, n), the prior's covariance along unobserved directions
    inverse: FloatArray  # (n, n), pseudo-inverse of the information on what is observed
    rank: int
    condition: float

    def shows(self, index: int) -> bool:
        """Return whether a parameter is the data's: the prior adds no more than it leaves."""
        return bool(0.0 < self.covariance[index, index] > self.hidden[index, index])


def prior_std(names: tuple[str, ...]) -> FloatArray:
    """Return the prior standard deviation of each named parameter, shape (n,)."""
    return np.array([PRIOR_STD[name.partition(".")[0]] for name in names])


def decide(information: FloatArray, names: tuple[str, ...]) -> Decision:
    """Split the space of `names` by what the information matrix holds.

    Args:
        information: inverse covariance of the parameters, nuisances marginalised, (n, n).
        names: of the parameters, as in `GAIN_NAMES`, `BIAS_NAMES` and `time_offset`.
    """
    return decide_in(information, prior_std(names))


def decide_in(information: FloatArray, unit: FloatArray) -> Decision:
    """Split a space of parameters of any kind, each measured in its prior's deviation.

    Args:
        information: inverse covariance of the parameters, nuisances marginalised, (n, n).
        unit: prior standard deviation of each, shape (n,).
    """
    values, vectors = np.linalg.eigh(information * np.outer(unit, unit))
    seen = values > 1.0 / OBSERVED_BELOW**2
    directions = unit[:, None] * vectors
    inverse = (directions[:, seen] / values[seen]) @ directions[:, seen].T
    hidden = directions[:, ~seen] @ directions[:, ~seen].T
    return Decision(
        covariance=inverse,
        hidden=hidden,
        inverse=inverse,
        rank=int(np.sum(seen)),
        condition=_condition(information, bool(seen.all())),
    )


def _condition(information: FloatArray, complete: bool) -> float:
    """Return the column-normalised condition of the Jacobian behind the information."""
    diagonal = np.sqrt(np.clip(np.diag(information), 0.0, None))
    known = diagonal > 0.0
    if not known.any():
        return float("inf")
    normal = information[np.ix_(known, known)] / np.outer(diagonal[known], diagonal[known])
    values = np.linalg.eigvalsh(normal)
    values = values[values > (0.0 if complete else 1e-9)]
    return float(np.sqrt(values[-1] / values[0])) if values.size else float("inf")


@dataclass(frozen=True, slots=True, eq=False)
class Concluded:
    """The parameters of the document: values, deviations, covariance; nan where hidden."""

    gain: FloatArray  # (3, 3)
    gain_std: FloatArray  # (3, 3)
    values: dict[str, float]
    std: dict[str, float]
    order: tuple[str, ...]
    covariance: FloatArray
    observability: Observability

    def triple(self, group: str) -> FloatArray:
        """Return a group's three values, such as `scale`, shape (3,)."""
        return np.array([v for n, v in self.values.items() if n.startswith(group + ".")])


def conclude(
    estimate: FloatArray,
    names: tuple[str, ...],
    decision: Decision,
    words: Mapping[str, str],
    unit: FloatArray | None = None,
) -> Concluded:
    """Turn an estimate of (gain, bias, offset) into the parameters of the document.

    A derived number is hidden when the prior, through the unobserved directions, moves
    it more than the data leaves it uncertain: it would be the prior's number.

    Args:
        estimate: values of `names`, shape (n,); unobserved directions at their prior mean.
        names: `GAIN_NAMES`, then any of `BIAS_NAMES`, then maybe `time_offset`, then maybe
            values of causes beyond the base model.
        decision: of the same names.
        words: for each gain column `x`, `y`, `z` and for `bias` and `time_offset`, why the
            data could not show it and what would.
        unit: prior standard deviation of each name; needed where there are causes.
    """
    unit = prior_std(names) if unit is None else unit
    gain = estimate[:9].reshape(3, 3)
    rest = names[9:]
    transform = np.zeros((len(names), len(names)))
    transform[:9, :9] = factor_jacobian(factorise(gain))
    transform[9:, 9:] = np.eye(len(rest))
    values = np.concatenate([factorise(gain).as_vector(), estimate[9:]])
    named = (*FACTOR_NAMES, *rest)
    data = transform @ decision.covariance @ transform.T
    prior = transform @ decision.hidden @ transform.T
    visible = _visible(
        np.diag(data),
        np.diag(prior),
        prior_like=np.concatenate([np.full(9, PRIOR_STD["gain"]), unit[9:]]),
    )
    seen_gain = _visible(
        np.diag(decision.covariance)[:9], np.diag(decision.hidden)[:9], np.full(9, 0.1)
    ).reshape(3, 3)
    gain_std = np.sqrt(np.diag(decision.covariance + decision.hidden)[:9]).reshape(3, 3)
    total = data + prior
    ordered = _ordered(named)
    at = {name: i for i, name in enumerate(named)}
    shown = [name for name in ordered if visible[at[name]]]
    pick = [at[name] for name in shown]
    hidden = tuple(name for name in ordered if not visible[at[name]])
    base = [i for i, n in enumerate(names) if n.startswith(("gain", "bias"))]
    of = len(base)
    lost = _lost(decision.hidden, unit, base)
    return Concluded(
        gain=np.where(seen_gain, gain, np.nan),
        gain_std=np.where(seen_gain, gain_std, np.nan),
        values={n: float(values[at[n]]) if visible[at[n]] else np.nan for n in ordered},
        std={n: float(np.sqrt(total[at[n], at[n]])) if visible[at[n]] else np.nan for n in ordered},
        order=tuple(shown),
        covariance=total[np.ix_(pick, pick)],
        observability=Observability(
            rank=of - lost,
            of=of,
            condition=decision.condition,
            unobservable=hidden,
            reasons=_reasons(decision.hidden / np.outer(unit, unit), hidden, words),
        ),
    )


def _lost(hidden: FloatArray, unit: FloatArray, base: list[int]) -> int:
    """Return how many directions of gain and bias the data does not show."""
    inner = (hidden / np.outer(unit, unit))[np.ix_(base, base)]
    return int(np.sum(np.linalg.eigvalsh(inner) > 0.5))


def _visible(data: FloatArray, prior: FloatArray, prior_like: FloatArray) -> BoolArray:
    """Return where a number is the data's: the prior adds no more than the data leaves."""
    tiny = (1e-9 * prior_like) ** 2
    return np.asarray((prior <= np.maximum(data, tiny)) & (data > 0.0), dtype=np.bool_)


def _ordered(named: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names in the document's order: bias, factors, time offset, causes."""
    bias = [n for n in named if n in BIAS_NAMES]
    factors = [n for n in named if n in FACTOR_NAMES]
    first = (*bias, *factors, *(n for n in named if n == "time_offset"))
    return (*first, *(n for n in named if n not in first))


def _reasons(
    hidden: FloatArray, lost: tuple[str, ...], words: Mapping[str, str]
) -> tuple[str, ...]:
    """Say each unobserved group in words, once; `hidden` in units of the prior."""
    share = np.diag(hidden)
    # A column shares in a hidden direction when a tenth of its prior comes back.
    columns = [c for k, c in enumerate("xyz") if share[k:9:3].max() > 0.1 and c in words]
    said: list[str] = []
    for text in dict.fromkeys(words[c] for c in columns):
        alike = [c for c in columns if words[c] == text]
        said.append(f"column{'s' * (len(alike) > 1)} {', '.join(alike)} of the gain: {text}")
    if any(n in BIAS_NAMES for n in lost) and "bias" in words:
        said.append(f"bias: {words['bias']}")
    if "time_offset" in lost and "time_offset" in words:
        said.append(f"time offset: {words['time_offset']}")
    said += [f"{n}: {words[n]}" for n in lost if n in words and n != "time_offset"]
    return tuple(said)
