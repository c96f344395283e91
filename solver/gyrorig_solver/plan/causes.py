"""What a program would show of each cause of the catalogue, before any motor moves.

A cause is projected off everything that is fitted anyway (gain, bias, time offset, the
motion's own unknowns), whitened by the noise. What is left decides how large it must be to
be detected (its minimal detectable size), how like another cause it looks, and how far it
moves the calibration while it is not detected (geodesy: external reliability, Baarda).

What to use when: `foresee` for a program; `cause_words` prints what it returns.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.chance import chi2_limit, chi2_noncentrality
from gyrorig_solver.estimate.information import NAMES, marginalise
from gyrorig_solver.estimate.normal import NormalSum
from gyrorig_solver.estimate.observability import prior_std
from gyrorig_solver.estimate.predict import PartColumns, predict_columns, predict_rate
from gyrorig_solver.estimate.whitening import OWN, PartModel, WhitePart
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.model.terms.protocol import Term, indices, places, value_parameters
from gyrorig_solver.model.terms.scene import Scene, Site
from gyrorig_solver.plan.looks import Look, batches, looks_for, scenes_of
from gyrorig_solver.plan.predict import PARAMETERS, Prediction
from gyrorig_solver.plan.sensor import MOUNT, SensorModel

DETECTED, FALSE_ALARMS = 0.8, 0.01  # of a cause of that size; of all looks together
ALIKE = 0.5  # share of a cause's energy that another may take before they are confusable
TAKEN_AT_MOST, UNSEEN = 0.99, 1000.0
POWERS = (0.5, 4.0)  # of its size that an effect may grow with
BATCH_VALUES = 2_000_000  # of the causes' derivatives on one sensor axis, held at a time


@dataclass(frozen=True, slots=True, eq=False)
class Foreseen:
    """What a program shows of one cause at one of its places."""

    term: Term
    place: str | None  # x, y, z, pan, tilt; None where it has none
    smallest: float  # detectable size, SI, in the direction that shows best
    largest: float  # in the direction that shows least
    typical: float  # size of an ordinary rig, SI
    unit: str
    absorbed: float  # share of the effect's energy that the fit takes for its own
    moves: str  # which parameter it moves most, undetected
    harm: float  # by how many standard deviations, at its detectable size
    look: Look
    likest: float = 0.0  # share of its energy that the likest other cause takes

    @property
    def identifiable(self) -> float:
        """Size from which it is told from the likest other cause, SI.

        What the other takes is lost; of causes all but equal, that no motion tells apart,
        `TAKEN_AT_MOST` counts as taken.
        """
        return self.largest / float(np.sqrt(1.0 - min(self.likest, TAKEN_AT_MOST)))

    @property
    def visible(self) -> bool:
        """True where some size that is possible at all would be detected."""
        own = value_parameters(self.term)[indices(self.term, self.place, "size")[0]]
        return self.largest <= max(abs(own.lower), abs(own.upper))


@dataclass(frozen=True, slots=True)
class Pair:
    """Two causes that look alike under a program."""

    causes: tuple[str, str]
    places: tuple[str | None, str | None]
    share: float  # of one's energy that the other takes


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """What a program shows of the catalogue."""

    foreseen: tuple[Foreseen, ...]
    pairs: tuple[Pair, ...]  # the likest first
    gauges: tuple[Term, ...]  # seen by no program: gain, bias and time offset take them whole
    elsewhere: tuple[Term, ...]  # seen in the noise or the raw stream, not in a motion
    missing: tuple[tuple[Term, str], ...]  # cannot be looked at here, and why

    @property
    def hidden(self) -> tuple[Foreseen, ...]:
        """What this program cannot show at any size that is possible."""
        return tuple(f for f in self.foreseen if not f.visible)

    @property
    def blindness(self) -> float:
        """How large causes must be to be known by name: mean over causes, typical sizes.

        A geometric mean, so that a cause ten times better known counts as much as another ten
        times worse. What is not seen at all counts as `UNSEEN`.
        """
        logs: dict[str, list[float]] = {}
        for f in self.foreseen:
            size = min(f.identifiable / f.typical, UNSEEN)
            logs.setdefault(f.term.cause, []).append(float(np.log(size)))
        return float(np.exp(np.mean([np.mean(places) for places in logs.values()])))

    @property
    def worst_harm(self) -> float:
        """The largest harm of all, standard deviations."""
        return max((f.harm for f in self.foreseen), default=0.0)


@cache
def noncentrality(degrees: int, tests: int) -> float:
    """Return the non-centrality at which a chi-squared test detects `DETECTED` of the time.

    Args:
        degrees: of freedom.
        tests: among which all false alarms are shared (Bonferroni).
    """
    return chi2_noncentrality(chi2_limit(FALSE_ALARMS / tests, degrees), degrees, DETECTED)


def foresee(prediction: Prediction, sensor: SensorModel, site: Site | None = None) -> Outlook:
    """Return what a program would show of every cause.

    Args:
        prediction: of the program.
        sensor: as it was predicted for.
        site: where the rig stands.
    """
    scenes = scenes_of(prediction.made, sensor, site or Site())
    causes = tuple(catalogue().values())
    shown = [t for t in causes if t.kind in ("effect", "known") and t.missing(scenes[0]) is None]
    missing = [(t, t.missing(scenes[0])) for t in causes if t.kind in ("effect", "known")]
    tested = sum(max(1, len(places(t))) for t in shown)
    sums = _Sums(prediction, sensor, scenes)
    found: dict[tuple[str, str | None], list[_Shown]] = {}
    for batch in batches([k for t in shown for k in looks_for(t, scenes[0])], sums.most):
        seen = sums.of(batch)
        for look in batch:
            for place in places(look.term) or (None,):
                one = seen.shown(look, place, noncentrality_of(look, place, tested))
                found.setdefault((look.term.cause, place), []).append(one)
    foreseen = [_foreseen(looked) for looked in found.values()]
    compared, pairs = _compared(foreseen, sums)
    return Outlook(
        foreseen=tuple(sorted(compared, key=lambda f: -f.harm)),
        pairs=pairs,
        gauges=tuple(t for t in causes if t.kind == "gauge"),
        elsewhere=tuple(t for t in causes if t.kind in ("stochastic", "raw")),
        missing=tuple((t, why) for t, why in missing if why is not None),
    )


def noncentrality_of(look: Look, place: str | None, tested: int) -> float:
    """Return the non-centrality for one look of a search over the catalogue."""
    return noncentrality(len(indices(look.term, place, "size")), tested * look.scanned)


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """One look at one place, sizes in typical ones."""

    look: Look
    place: str | None
    sizes: FloatArray  # (d,), detectable in each principal direction, best first
    absorbed: float
    harm: FloatArray  # (p,), of each parameter


class _Sums:
    """Normal equations of a motion with any causes beside the base model."""

    def __init__(
        self, prediction: Prediction, sensor: SensorModel, scenes: Sequence[Scene]
    ) -> None:
        series, reference = prediction.made.series, prediction.made.reference
        self._reference, self._noise, self._scenes = reference, sensor.noise, scenes
        self._prediction = prediction
        self.most = max(16, BATCH_VALUES // max(p.stop - p.start for p in series.parts()))
        self._parts: list[tuple[FloatArray, BoolArray, PartColumns]] = []
        for blocks in series.parts():
            sampled = predict_rate(series, blocks, reference, 0.0)
            use = series.good[series.samples_of(blocks)] & sampled.known
            columns = predict_columns(series, blocks, reference, 0.0)
            self._parts.append((series.means(sampled.rate, use), series.used(use), columns))

    def of(self, looks: Sequence[Look]) -> "_Seen":
        """Return what is known of the causes' sizes, in typical ones, beside the base."""
        local, _ = self._reference.information.size
        sums: list[NormalSum] = []
        for (rate, used, columns), scene in zip(self._parts, self._scenes, strict=True):
            terms = np.concatenate(
                [k.term.directions(scene, k.values) * k.typical[:, None, None] for k in looks]
            )
            part = WhitePart.of(PartModel(rate, used, terms, columns), MOUNT, self._noise)
            sums = sums or [NormalSum(self._noise, local, part.size)]
            sums[0].add(part, np.zeros_like(rate), whole=len(self._parts) == 1)
        normal = sums[0].total()
        size = OWN + sum(k.typical.size for k in looks)
        left = marginalise(normal, self._reference, size).information
        raw = np.diag(normal.matrix.shared)[OWN:size]
        return _Seen(looks, left, raw, self._prediction)


class _Seen:
    """The information on some looks' sizes once the base model is projected off."""

    def __init__(
        self,
        looks: Sequence[Look],
        information: FloatArray,
        raw: FloatArray,
        prediction: Prediction,
    ) -> None:
        base, cross = information[:OWN, :OWN], information[:OWN, OWN:]
        self._raw = raw
        # What no motion fixes has its prior, or a cause in that direction would look seen.
        held = np.linalg.solve(base + np.diag(prior_std(NAMES) ** -2.0), cross)
        self.left = information[OWN:, OWN:] - cross.T @ held
        first = np.cumsum([0, *(k.typical.size for k in looks)])
        self._first = {id(k): int(at) for k, at in zip(looks, first[:-1], strict=True)}
        std = np.array([prediction.std[name] for name in PARAMETERS])
        self._std = np.where(np.isfinite(std), std, np.inf)
        self._moved = prediction.by_name @ held

    def index(self, look: Look, place: str | None) -> list[int]:
        """Return which rows and columns of `left` are a look's at a place."""
        sizes = indices(look.term, role="size")
        return [
            self._first[id(look)] + sizes.index(k) for k in indices(look.term, place, role="size")
        ]

    def shown(self, look: Look, place: str | None, wanted: float) -> _Shown:
        """Return what a look shows at a place, detected at a non-centrality."""
        at = self.index(look, place)
        raw = float(np.sum(self._raw[at]))
        if raw <= 0.0:
            none = np.full(len(at), np.inf)
            return _Shown(look, place, none, 1.0, np.zeros(OWN))
        values, vectors = np.linalg.eigh(self.left[np.ix_(at, at)])
        values = np.maximum(values[::-1], 1e-15 * raw)
        sizes = np.sqrt(wanted / values)
        # A size that nothing can have does no harm: what is not seen is taken as typical.
        possible = np.where(sizes <= _bound(look, place), sizes, 1.0)
        moved = self._moved[:, at] @ vectors[:, ::-1] * possible
        harm = np.sqrt(np.sum(moved**2, axis=1)) / self._std
        return _Shown(look, place, sizes, 1.0 - float(np.sum(values)) / raw, harm)


def _bound(look: Look, place: str | None) -> float:
    """Return the largest size that is possible, in typical ones."""
    own = value_parameters(look.term)[indices(look.term, place, "size")[0]]
    return max(abs(own.lower), abs(own.upper)) / own.typical


def _foreseen(looked: Sequence[_Shown]) -> Foreseen:
    """Return what all looks at one place of a cause say together."""
    sized = looked[0].look.size > 0.0
    chosen = _crossing(looked) if sized else _middling(looked)
    place, look = chosen.place, chosen.look
    own = value_parameters(look.term)[indices(look.term, place, "size")[0]]
    worst = int(np.argmax(chosen.harm))
    return Foreseen(
        term=look.term,
        place=place,
        smallest=float(chosen.sizes[0]) * own.typical,
        largest=float(chosen.sizes[-1]) * own.typical,
        typical=own.typical,
        unit=own.unit,
        absorbed=chosen.absorbed,
        moves=PARAMETERS[worst],
        harm=float(chosen.harm[worst]),
        look=look,
    )


def _middling(looked: Sequence[_Shown]) -> _Shown:
    """Return the look of middling detectable size among those that see anything."""
    some = [one for one in looked if np.isfinite(one.sizes[-1])] or list(looked)
    return sorted(some, key=lambda one: float(one.sizes[-1]))[(len(some) - 1) // 2]


def _crossing(looked: Sequence[_Shown]) -> _Shown:
    """Return the look nearest to where an effect of its own size is just detected.

    Between two sizes, and beyond them, the effect is drawn as a power of its size.
    """
    size = np.array([one.look.size for one in looked])
    detectable = np.array([one.sizes[-1] for one in looked])
    ratio = size / detectable  # 1: just detected
    some = np.flatnonzero(ratio > 0.0)
    if not some.size:
        return looked[-1]
    above = np.flatnonzero(ratio >= 1.0)
    at = int(above[0]) if above.size else int(some[-1])
    beside = [k for k in (at - 1, at + 1) if k in some and size[k] != size[at]]
    power = 1.0
    if beside:
        other = beside[0]
        power = float(np.log(ratio[at] / ratio[other]) / np.log(size[at] / size[other]))
    found = size[at] * float(ratio[at]) ** (-1.0 / np.clip(power, *POWERS))
    if at > 0 and at - 1 not in some:
        found = max(found, size[at - 1])  # nothing at all shows there
    # The harm stays: it is that of an effect just detected, whatever size makes it so large.
    one, factor = looked[at], found / detectable[at]
    return _Shown(one.look, one.place, one.sizes * factor, one.absorbed, one.harm)


def _compared(
    foreseen: Sequence[Foreseen], sums: _Sums
) -> tuple[tuple[Foreseen, ...], tuple[Pair, ...]]:
    """Return the causes with how like the likest other is, and those that look alike."""
    seen = [f for f in foreseen if f.visible]
    looks = list({id(f.look): f.look for f in seen}.values())
    if not looks:
        return tuple(foreseen), ()
    joint = sums.of(looks)
    at = [joint.index(f.look, f.place) for f in seen]
    best: dict[tuple[str, str], Pair] = {}
    likest = {id(f): 0.0 for f in foreseen}
    for j, one in enumerate(seen):
        for k, other in enumerate(seen[:j]):
            if one.term.cause == other.term.cause:
                continue
            share = _share(joint.left, at[j], at[k])
            likest[id(one)] = max(likest[id(one)], share)
            likest[id(other)] = max(likest[id(other)], share)
            names = (other.term.cause, one.term.cause)
            if share > max(ALIKE, best[names].share if names in best else 0.0):
                best[names] = Pair(names, (other.place, one.place), share)
    pairs = tuple(sorted(best.values(), key=lambda pair: -pair.share))
    return tuple(replace(f, likest=likest[id(f)]) for f in foreseen), pairs


def _share(left: FloatArray, a: list[int], b: list[int]) -> float:
    """Return the share of energy that one of two causes takes of the other, at most 1."""
    across = left[np.ix_(a, b)]
    taken = np.linalg.solve(left[np.ix_(a, a)], across) @ np.linalg.solve(
        left[np.ix_(b, b)], across.T
    )
    return float(np.trace(taken)) / min(len(a), len(b))
