"""Posterior probabilities of names compared with how often the names are right.

In a session with one hidden cause of the catalogue, a ranking gives each cause that it compared a
posterior probability. Of all names with a probability near p, a share near p must be the hidden
cause. The rows are those of a reliability diagram.

What to use when: `collect_beliefs` for a case; `table_text` for the table of all cases.

Source: DeGroot and Fienberg, The Statistician 32 (1983) 12.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from docs.markdown import table
from scipy.stats import binom
from tests.hidden.scoring.goals import TWINS

BINS = 10
TAIL = 0.025
MIN_PROBABILITY = 1e-3  # a name below it was not a serious alternative


@dataclass(frozen=True, slots=True)
class Belief:
    """A name that a ranking compared."""

    probability: float
    right: bool  # it is the hidden cause


@dataclass(frozen=True, slots=True)
class ReliabilityRow:
    """The names of one bin of probabilities."""

    low: float
    high: float
    names: int
    mean_probability: float
    right: int

    @property
    def limits(self) -> tuple[float, float]:
        """Limits of the share of right names, 95 %, if the probabilities are right."""
        low, high = (
            float(binom.ppf(tail, self.names, self.mean_probability)) / self.names
            for tail in (TAIL, 1.0 - TAIL)
        )
        return low, high

    @property
    def inside(self) -> bool:
        """Whether the share of right names is within the limits."""
        low, high = self.limits
        return low <= self.right / self.names <= high


def collect_beliefs(hidden_cause: str, line: Mapping[str, Any]) -> tuple[Belief, ...]:
    """Return the names that the ranking of a case compared; () without a single stated set.

    Twins of the catalogue count as one name.
    """
    if len(line["causes"]) != 1:
        return ()
    (entry,) = line["causes"]
    shares = {entry["set"][0]: entry["posterior"], **entry.get("rivals", {})}
    right_names = next((twins for twins in TWINS if hidden_cause in twins), {hidden_cause})
    right = sum(shares.get(name) or 0.0 for name in right_names)
    beliefs = [Belief(share, False) for name, share in shares.items() if name not in right_names]
    beliefs.append(Belief(right, True))
    return tuple(each for each in beliefs if each.probability >= MIN_PROBABILITY)


def reliability_rows(beliefs: Sequence[Belief]) -> list[ReliabilityRow]:
    """Return the bins that contain names."""
    rows = []
    edges = np.linspace(0.0, 1.0, BINS + 1)
    for k, (low, high) in enumerate(pairwise(edges)):
        chosen = [
            each
            for each in beliefs
            if low <= each.probability < high or (k == BINS - 1 and each.probability == high)
        ]
        if chosen:
            mean = float(np.mean([each.probability for each in chosen]))
            right = sum(each.right for each in chosen)
            rows.append(ReliabilityRow(float(low), float(high), len(chosen), mean, right))
    return rows


def table_text(beliefs: Sequence[Belief]) -> str:
    """Return how often names are right, by their posterior probability."""
    rows = reliability_rows(beliefs)
    inside = sum(row.inside for row in rows)
    body = table(
        ("posterior probability", "names", "mean", "right", "expected, 95 % limits", "inside"),
        [
            (
                f"{100 * row.low:.0f} to {100 * row.high:.0f} %",
                str(row.names),
                f"{100 * row.mean_probability:.1f} %",
                f"{row.right} = {100 * row.right / row.names:.1f} %",
                f"{100 * row.limits[0]:.1f} to {100 * row.limits[1]:.1f} %",
                "yes" if row.inside else "no",
            )
            for row in rows
        ],
    )
    return f"{body}\n\nThe share is within the limits in {inside} of {len(rows)} bins."
