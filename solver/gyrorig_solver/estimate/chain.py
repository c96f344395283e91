"""Causes fitted together are a chain: each acts on what those before it have made of a motion.

From what the motor is told over gear, stage, mount, sensor and low-pass to the stamp, in
the order of `protocol.CHAIN`. A gap in the gear swallows the motion that rounded ramps
have, not the told one; a late clock shows the gap's pulse late. Effects taken one by one on
scenes that the earlier ones have changed add up to the whole change exactly.

What to use when: `effect_of` and `columns_of` in a fit, `shares_of` for what each cause
adds, `lost_without` for what would lack without some; `Chain` for a cause that may come in
beside those of a fit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.model.terms.bound import label
from gyrorig_solver.model.terms.protocol import CHAIN, OPERATORS, Link, Term, value_parameters
from gyrorig_solver.model.terms.scene import Scene

CUTTING = ("threshold", "limit")  # links of the chain at which rates are cut off
READER_STEP = 1e-3  # of a typical size


def ordered(extensions: Sequence[Extension]) -> list[Extension]:
    """Return causes in the order in which they act."""
    return sorted(extensions, key=lambda one: _key(one.term))


def shares_of(extensions: Sequence[Extension], scene: Scene) -> list[FloatArray]:
    """Return what each cause adds to those before it in the chain, (blocks, 3) each.

    In the order given. Their sum is what all of them change together. What only filters or
    delays comes first: it does so to all that the others add, and some of that is written
    out behind the filter, on no grid that could be filtered again.
    """
    found = {}
    acting = _readers_first([one for one in ordered(extensions) if one.acts])
    for k, one in enumerate(acting):
        found[id(one)] = one.term.effect(scene, one.values)
        if k + 1 < len(acting):
            scene = one.term.passed(scene, one.values)
    none = np.zeros((scene.blocks, 3))
    return [found.get(id(one), none) for one in extensions]


def _readers_first(acting: list[Extension]) -> list[Extension]:
    readers = [one for one in acting if one.term.link in OPERATORS]
    return [*readers, *(one for one in acting if one.term.link not in OPERATORS)]


def effect_of(extensions: Sequence[Extension], scene: Scene) -> FloatArray:
    """Return what the causes together change, (blocks, 3), sensor frame."""
    total = np.zeros((scene.blocks, 3))
    for share in shares_of(extensions, scene):
        total += share
    return total


def unsure_of(extensions: Sequence[Extension], scene: Scene) -> BoolArray | None:
    """Return which blocks are left out beside the causes, (blocks,), None where none are."""
    each = [one.term.unsure(scene, one.values) for one in extensions if one.acts]
    found = [one for one in each if one is not None]
    return np.logical_or.reduce(found) if found else None


def lost_without(
    gone: Sequence[Extension], extensions: Sequence[Extension], scene: Scene
) -> FloatArray:
    """Return what the causes show less if some of them were not there, (blocks, 3).

    Args:
        gone: which of them.
        extensions: all of them.
        scene: without any.
    """
    acting = _readers_first([one for one in ordered(extensions) if one.acts])
    stays = [all(one is not other for other in gone) for one in acting]
    if all(stays):
        return np.zeros((scene.blocks, 3))
    first = stays.index(False)
    for one in acting[:first]:  # these show the same with and without
        scene = one.term.passed(scene, one.values)
    rest = [one for one, stay in zip(acting, stays, strict=True) if stay][first:]
    return effect_of(acting[first:], scene) - effect_of(rest, scene)


def columns_of(extensions: Sequence[Extension], scene: Scene) -> FloatArray:
    """Return the derivatives by all fitted values, (k, blocks, 3).

    To first order: what a value changes in the effect of causes further down is left out,
    but for those that only filter or delay, and those that cut rates off.
    """
    chain = Chain(extensions, scene)
    found = []
    for one in extensions:
        if one.free.size:
            columns = one.term.slopes(chain.at(one.term), one.values)[one.free]
            if one.term.link in OPERATORS:
                columns = columns + chain.unheld_columns(one)
            found.append(chain.cut(one.term, columns))
    return np.concatenate(found) if found else np.zeros((0, scene.blocks, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What still shows of a small change where causes cut rates off.

    A rate below a threshold, or beyond a limit, does not show, and nor does more or less of
    it: without this a fit takes for measured what never was.
    """

    before: FloatArray  # (blocks, 3), share of what changes before any is cut off
    after: FloatArray  # (blocks, 3), share of what changes behind the threshold
    # (3, 3, blocks), what a row of G changes in the effect of the causes: axis, entry.
    gain: FloatArray

    def of(self, link: Link) -> FloatArray | None:
        """Return the share of what a cause changes that shows, (blocks, 3), None: all."""
        at = CHAIN.index(link)
        if at < CHAIN.index("threshold"):
            return self.before
        return self.after if at < CHAIN.index("limit") else None


def shown_of(extensions: Sequence[Extension], scene: Scene) -> Shown | None:
    """Return what causes that cut rates off let pass, None where none is at work."""
    return Chain(extensions, scene).shown


class Chain:
    """One part of a series with the causes of a fit at work in it.

    Scenes are made when they are asked for, and kept.
    """

    def __init__(self, extensions: Sequence[Extension], scene: Scene) -> None:
        """Take the causes and the scene without them."""
        self.scene = scene
        self._extensions = [one for one in ordered(extensions) if one.acts]
        self._scenes: dict[tuple[int, tuple[str, ...]], Scene] = {}
        self._effects: dict[str, FloatArray] = {}

    def at(self, term: Term, but: str = "") -> Scene:
        """Return the scene as a cause finds it: those before it, and all that only read.

        Where the cause itself is among those of the fit, it is left out; `but`: and this one.
        """
        if not self._extensions:
            return self.scene
        before = [one for one in self._extensions if _key(one.term) < _key(term)]
        signals = [one for one in before if one.term.link not in OPERATORS]
        readers = [
            one
            for one in self._extensions
            if one.term.link in OPERATORS and label(one.term) not in (label(term), but)
        ]
        return self._after(signals, readers)

    @cached_property
    def shown(self) -> Shown | None:
        """What the causes that cut rates off let pass; None where none is at work."""
        after = np.ones((self.scene.blocks, 3))
        before, gain = after, np.zeros((3, 3, self.scene.blocks))
        some = False
        for one in self._extensions:
            here = self.at(one.term) if one.term.link in CUTTING else self.scene
            passes = one.term.passes(here, one.values)
            if passes is None:
                continue
            some = True
            if one.term.link == "limit":
                share = here.read(passes)
                gain = share.T[:, None] * (gain + self._rate) - self._rate
                before, after = before * share, after * share
                continue
            lost = np.moveaxis(here.rate_rad_s[:, :, None] * (passes - 1.0)[:, None, :], 1, 0)
            gain = gain + here.seen(lost).transpose(2, 0, 1)
            before = before + here.seen(passes - 1.0)
        return Shown(before, after, gain) if some else None

    @cached_property
    def _rate(self) -> FloatArray:
        """The stage's rates as the blocks show them, (3, blocks)."""
        return self.scene.seen(self.scene.rate_rad_s).T

    def cut(self, term: Term, columns: FloatArray) -> FloatArray:
        """Return what of a cause's derivatives, (k, blocks, 3), other causes let pass."""
        share = None if self.shown is None else self.shown.of(term.link)
        return columns if share is None or term.as_if_shown else columns * share

    def effect(self, term: Term, values: FloatArray) -> FloatArray:
        """Return how a cause changes what the causes of the fit show together, (blocks, 3).

        What it does to those further down is counted where that is more than the product of
        two small effects.
        """
        here = self.at(term)
        total = term.effect(here, values)
        if term.link in OPERATORS:
            total = total + self._unheld(term, values) - self._unheld(term, None)
        later = [one for one in self._extensions if _key(one.term) > _key(term)]
        later = [one for one in later if one.term.link not in OPERATORS]
        last = max((k for k, one in enumerate(later) if one.term.reshapes), default=-1)
        if last < 0:
            return total
        changed = term.passed(here, values)
        for k, one in enumerate(later[: last + 1]):
            if one.term.reshapes:
                total = total + one.term.effect(changed, one.values) - self._own(one)
            if k < last:
                changed = one.term.passed(changed, one.values)
        return total

    def unheld_columns(self, reader: Extension) -> FloatArray:
        """Return what a cause that only filters or delays makes of what no grid holds.

        By central differences, (free, blocks, 3).
        """
        found = np.zeros((reader.free.size, self.scene.blocks, 3))
        if not any(self._held_out(reader.term)):
            return found
        own = value_parameters(reader.term)
        for k, index in enumerate(reader.free):
            step = np.zeros(reader.values.size)
            step[index] = READER_STEP * own[index].typical
            more, less = (self._unheld(reader.term, reader.values + by) for by in (step, -step))
            found[k] = (more - less) / (2.0 * step[index])
        return found

    def _held_out(self, reader: Term) -> Iterator[tuple[Extension, Scene]]:
        """Yield what acts before a filter or delay, as it finds its scene without that."""
        for one in self._extensions:
            if one.term.link not in OPERATORS:
                here = self.at(one.term, but=label(reader))
                if one.term.unheld(here, one.values) is not None:
                    yield one, here

    def _unheld(self, reader: Term, values: FloatArray | None) -> FloatArray:
        """Return all that no grid holds behind a filter or delay, None: without it."""
        total = np.zeros((self.scene.blocks, 3))
        for one, here in self._held_out(reader):
            there = here if values is None else reader.passed(here, values)
            found = one.term.unheld(there, one.values)
            total += 0.0 if found is None else found
        return total

    def forget(self) -> None:
        """Drop the scenes that were made."""
        self._scenes.clear()

    def _own(self, one: Extension) -> FloatArray:
        """Return the effect of a cause of the fit, without the one that is looked at."""
        own = label(one.term)
        if own not in self._effects:
            self._effects[own] = one.term.effect(self.at(one.term), one.values)
        return self._effects[own]

    def _after(self, signals: list[Extension], readers: list[Extension]) -> Scene:
        key = len(signals), tuple(label(one.term) for one in readers)
        if key not in self._scenes:
            if signals:
                last = signals[-1]
                scene = last.term.passed(self._after(signals[:-1], readers), last.values)
            else:
                scene = self.scene
                for one in readers:
                    scene = one.term.passed(scene, one.values)
            self._scenes[key] = scene
        return self._scenes[key]


def _key(term: Term) -> tuple[int, str]:
    return CHAIN.index(term.link), label(term)
