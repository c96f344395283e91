"""One pass over the catalogue: how much each cause would explain of a residual.

Every cause's directions at every row of its bank are whitened and projected off all that
the fit can follow; T = s' A^-1 s is chi-squared with as many degrees of freedom as sizes
where there is nothing but noise. The best of many rows is judged by the number of
independent ones among them (Galwey, Genet. Epidemiol. 33 (2009) 559), and by how many
tests the catalogue makes.

What to use when: `sights` in each round of the search; `Seen.of` for one set of signals.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.banks import quick_rows
from gyrorig_solver.estimate.projection import Looked, Projection
from gyrorig_solver.model.terms.protocol import Term, indices, places, value_parameters
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.plan.causes import noncentrality

VANISHED = 1e-9  # of its energy: a signal with less left is the fit's own
GRAM = 48  # signals of one cause that are looked at together, and whose likeness counts
MOST_VALUES = 4_000_000  # of signals that are looked at together: memory counts
MOST_PLACES = 3  # sizes with more parts are looked at together only


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a few signals together say."""

    statistic: float
    degrees_of_freedom: int
    values: FloatArray  # (d,), their best sizes to first order

    @classmethod
    def of(cls, looked: Looked) -> "Seen":
        """Judge signals by their information and score, vanished ones left out."""
        if looked.score.size == 1:
            return cls._of_one(looked)
        energy = np.diag(looked.information)
        some = energy > VANISHED * np.maximum(looked.raw, 1e-300)
        values = np.zeros(energy.size)
        if not some.any():
            return cls(0.0, 0, values)
        scale = np.sqrt(energy[some])
        alike = looked.information[np.ix_(some, some)] / np.outer(scale, scale)
        strength, along = np.linalg.eigh(alike)
        keep = strength > 1e-7
        score = along.T @ (looked.score[some] / scale)
        values[some] = along[:, keep] @ (score[keep] / strength[keep]) / scale
        statistic = float(np.sum(score[keep] ** 2 / strength[keep]))
        return cls(statistic, int(keep.sum()), values)

    @classmethod
    def _of_one(cls, looked: Looked) -> "Seen":
        energy, score = float(looked.information[0, 0]), float(looked.score[0])
        if energy <= VANISHED * max(float(looked.raw[0]), 1e-300):
            return cls(0.0, 0, np.zeros(1))
        return cls(score * score / energy, 1, np.array([score / energy]))


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What one row of a cause's bank would show, in typical sizes."""

    size: float  # of the row; 0 where the effect is taken as linear
    detectable: float  # in the direction that shows least, inf where nothing shows
    moved: FloatArray  # (board,), what that makes of the fit's parameters, unseen


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A cause at one of its places, or all, at the row of its bank that shows best."""

    term: Term
    place: str | None
    row: FloatArray  # (k,)
    seen: Seen
    looks: float  # effective number of independent rows
    p_value: float  # rows and tests counted
    shown: tuple[Shown, ...]  # of every row

    @property
    def detectable(self) -> Shown:
        """The row whose own size is about what is just detected; of linear ones the middle.

        Where even the largest row would not be seen, `detectable` is infinite.
        """
        if self.shown[0].size > 0.0:
            rows = sorted(self.shown, key=lambda one: one.size)
            some = [one for one in rows if one.size >= one.detectable]
            if some:
                return replace(some[0], detectable=some[0].size)
            return replace(rows[-1], detectable=np.inf)
        rows = sorted(self.shown, key=lambda one: one.detectable)
        # A step that is lost where the axis stands still is none: such rows say nothing.
        rows = [one for one in rows if np.isfinite(one.detectable)] or rows
        return rows[(len(rows) - 1) // 2]


def sights(
    projection: Projection, terms: Iterable[Term], tests: int, whole: FloatArray | None = None
) -> list[Sight]:
    """Return the best sight of each cause at each place, the least likely by chance first.

    Args:
        projection: the space beside the fit.
        terms: the causes to look at.
        tests: how many of them share the false alarms.
        whole: rows of the bank to look at instead, for a single cause.
    """
    found: list[Sight] = []
    for term in terms:
        rows, looked = (whole, len(whole)) if whole is not None else quick_rows(projection, term)
        found += _of_term(projection, term, rows, looked, tests)
    return sorted(found, key=lambda s: (s.p_value, -s.seen.statistic))


def where(term: Term) -> list[tuple[str | None, list[int]]]:
    """Return the places of a cause, None for all of them, and which sizes each has."""
    sizes = indices(term, role="size")
    found: list[tuple[str | None, list[int]]] = [(None, list(range(len(sizes))))]
    parts = places(term)
    if 1 < len(parts) <= MOST_PLACES:
        for part in parts:
            own = indices(term, part, "size")
            found.append((part, [sizes.index(k) for k in own]))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Spot:
    """One place of a cause, and what it takes to be seen there."""

    place: str | None
    at: IntArray  # which sizes of the cause
    sizes: IntArray  # the same among all its values
    typical: FloatArray
    wanted: float  # non-centrality

    @classmethod
    def of(cls, term: Term, place: str | None, at: Sequence[int], tests: int) -> "_Spot":
        """Return a place with the sizes that it has; `tests` share the false alarms."""
        own, every = value_parameters(term), indices(term, role="size")
        sizes = np.array([every[k] for k in at], dtype=np.int64)
        typical = np.array([own[k].typical for k in sizes])
        wanted = noncentrality(len(at), tests)
        return cls(place, np.array(at, dtype=np.int64), sizes, typical, wanted)

    def shown(self, row: FloatArray, looked: Looked) -> Shown:
        """Return what a row of the bank would show here."""
        typical = self.typical
        size = float(np.max(np.abs(row[self.sizes]) / typical))
        if typical.size == 1:
            least, along = float(looked.information[0, 0] * typical[0] ** 2), typical
        else:
            values, vectors = np.linalg.eigh(looked.information * np.outer(typical, typical))
            least, along = float(values[0]), vectors[:, 0] * typical
        if least <= VANISHED * float(np.max(looked.raw * typical**2)):
            return Shown(size, np.inf, looked.taken.T @ along)
        detectable = float(np.sqrt(self.wanted / least))
        return Shown(size, detectable, looked.taken.T @ (along * detectable))


def _of_term(
    projection: Projection, term: Term, rows: FloatArray, looked: int, tests: int
) -> list[Sight]:
    spots = [_Spot.of(term, place, at, tests * max(looked, 1)) for place, at in where(term)]
    best: dict[str | None, tuple[FloatArray, Seen]] = {}
    shown: dict[str | None, list[Shown]] = {one.place: [] for one in spots}
    counted = 1 < len(rows) == looked and len(rows) * spots[0].at.size <= GRAM
    looks = float(max(looked, 1))
    for some, says in _looked_at(projection, term, rows, counted):
        size = says.score.size // len(some)
        if counted:
            looks = _independent(says.information, size)
        for k, row in enumerate(some):
            for one in spots:
                own = says.part(k * size + one.at)
                seen = Seen.of(own)
                shown[one.place].append(one.shown(row, own))
                if one.place not in best or seen.statistic > best[one.place][1].statistic:
                    best[one.place] = row, seen
    found = []
    for place, (row, seen) in best.items():
        if seen.degrees_of_freedom:
            alone = chi2_tail(seen.statistic, seen.degrees_of_freedom)
            p_value = min(1.0, alone * looks * tests)
            found.append(Sight(term, place, row, seen, looks, p_value, tuple(shown[place])))
    return found


def _looked_at(
    projection: Projection, term: Term, rows: FloatArray, whole: bool
) -> Iterator[tuple[list[FloatArray], Looked]]:
    """Yield rows of a bank and what their signals say, several at a time: that is quicker.

    `whole`: all rows at once.
    """
    some: list[FloatArray] = []
    white: list[FloatArray] = []
    for k, row in enumerate(rows):
        some.append(row)
        white.append(projection.signals(partial(_directions, term, row), term=term))
        count = (len(some) + 1) * len(white[0])
        full = not whole and (count > GRAM or count * white[0].shape[1] > MOST_VALUES)
        if full or k + 1 == len(rows):
            yield some, projection.look(white[0] if len(white) == 1 else np.concatenate(white))
            some, white = [], []


def _directions(term: Term, row: FloatArray, scene: Scene) -> FloatArray:
    return term.directions(scene, row)


def _independent(information: FloatArray, sizes: int) -> float:
    """Return how many independent looks rows of a bank are, the most of their sizes.

    Args:
        information: of all signals, those of one row after the other.
        sizes: signals of a row.
    """
    several = []
    for k in range(sizes):
        own = information[k::sizes, k::sizes]
        energy = np.diag(own)
        some = energy > 1e-12 * max(float(energy.max()), 1e-300)
        if some.sum() < 2:
            several.append(1.0)
            continue
        scale = np.sqrt(energy[some])
        alike = own[np.ix_(some, some)] / np.outer(scale, scale)
        strength = np.clip(np.linalg.eigvalsh(alike), 0.0, None)
        several.append(float(np.sum(np.sqrt(strength)) ** 2 / np.sum(strength)))
    return max(several, default=1.0)
