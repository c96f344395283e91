"""Stored results of the long tier: one line per case, enough to compute every figure.

What to use when: `write_kept` after judging, `read_kept` for the page and its test.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
from tests.hidden.scoring.figures import Gap
from tests.hidden.scoring.outcome import Covered, Outcome
from tests.hidden.scoring.possible import Bound

SIGMA_DIGITS = 2


@dataclass(frozen=True, slots=True)
class Kept:
    """All outcomes, second recordings, and bounds from rivals."""

    outcomes: list[Outcome]
    gaps: list[Gap]
    bounds: list[Bound] = field(default_factory=list)  # for cases that hide one cause


def write_kept(path: Path, kept: Kept) -> None:
    """Write one line per case, then the second recordings and the bounds."""
    lines = [msgspec.json.encode(_short(one)) for one in kept.outcomes]
    gaps = [msgspec.json.encode(one) for one in kept.gaps]
    bounds = [msgspec.json.encode(_shortened(one)) for one in kept.bounds]
    between = b",\n"
    body = b'{"outcomes":[\n%b\n],"gaps":[\n%b\n],"bounds":[\n%b\n]}\n' % (
        between.join(lines), between.join(gaps), between.join(bounds),
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(body)


def read_kept(path: Path) -> Kept:
    """Return the results that `write_kept` wrote."""
    return msgspec.json.decode(path.read_bytes(), type=Kept)


def _short(one: Outcome) -> Outcome:
    """Return an outcome rounded to the digits that a figure needs."""

    def near(each: tuple[Covered, ...]) -> tuple[Covered, ...]:
        return tuple(replace(c, sigma=round(c.sigma, SIGMA_DIGITS)) for c in each)

    return replace(
        one,
        fates=tuple(replace(fate, times=round(fate.times, 2)) for fate in one.fates),
        covered_causes=near(one.covered_causes),
        covered_calibration=near(one.covered_calibration),
        harm=None if one.harm is None else (one.harm[0], round(one.harm[1], 1)),
    )


def _shortened(one: Bound) -> Bound:
    return replace(
        one,
        times=round(one.times, 2),
        left=round(one.left, 4),
        noncentrality=round(one.noncentrality, 2),
    )
