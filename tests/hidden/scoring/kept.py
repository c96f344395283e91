"""Stored results of the long tier: one line per case, enough to compute every figure.

What to use when: `write_judged_cases` after judging, `read_judged_cases` for the page and its test.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
from tests.hidden.scoring.figures import Gap
from tests.hidden.scoring.outcome import Coverage, Outcome
from tests.hidden.scoring.possible import Bound

SIGMA_DIGITS = 2
PROBABILITY_DIGITS = 4


@dataclass(frozen=True, slots=True)
class JudgedCases:
    """All outcomes, second recordings, and bounds from rivals."""

    outcomes: list[Outcome]
    gaps: list[Gap]
    bounds: list[Bound] = field(default_factory=list)  # for cases that hide one cause


def write_judged_cases(path: Path, judged_cases: JudgedCases) -> None:
    """Write one line per case, then the second recordings and the bounds."""
    lines = [msgspec.json.encode(_round_outcome(outcome)) for outcome in judged_cases.outcomes]
    gaps = [msgspec.json.encode(gap) for gap in judged_cases.gaps]
    bounds = [msgspec.json.encode(_round_bound(bound)) for bound in judged_cases.bounds]
    between = b",\n"
    body = b'{"outcomes":[\n%b\n],"gaps":[\n%b\n],"bounds":[\n%b\n]}\n' % (
        between.join(lines), between.join(gaps), between.join(bounds),
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(body)


def read_judged_cases(path: Path) -> JudgedCases:
    """Return the results that `write_judged_cases` wrote."""
    return msgspec.json.decode(path.read_bytes(), type=JudgedCases)


def _round_outcome(outcome: Outcome) -> Outcome:
    """Return an outcome rounded to the digits that a figure needs."""

    def round_sigmas(each: tuple[Coverage, ...]) -> tuple[Coverage, ...]:
        return tuple(replace(c, sigma=round(c.sigma, SIGMA_DIGITS)) for c in each)

    return replace(
        outcome,
        fates=tuple(replace(fate, times=round(fate.times, 2)) for fate in outcome.fates),
        covered_causes=round_sigmas(outcome.covered_causes),
        covered_calibration=round_sigmas(outcome.covered_calibration),
        beliefs=tuple(
            replace(each, probability=round(each.probability, PROBABILITY_DIGITS))
            for each in outcome.beliefs
        ),
        gain_sigma=(
            None if outcome.gain_sigma is None else round(outcome.gain_sigma, SIGMA_DIGITS)
        ),
        harm=None if outcome.harm is None else (outcome.harm[0], round(outcome.harm[1], 1)),
    )


def _round_bound(bound: Bound) -> Bound:
    return replace(
        bound,
        times=round(bound.times, 2),
        left=round(bound.left, 4),
        noncentrality=round(bound.noncentrality, 2),
    )
