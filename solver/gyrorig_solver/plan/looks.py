"""Where to look for the causes of the catalogue in a motion that was never recorded.

What to use when: `scenes_of` for the scenes that causes look at; `looks_for` for a few rows
of a cause's bank: sizes to scan where the effect is not linear, else a few of its shapes
and moments, which stand for all of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.estimate.predict import instants_per_block
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.model.terms.protocol import Term, indices, value_parameters
from gyrorig_solver.model.terms.scene import Scene, Setting, Site
from gyrorig_solver.model.terms.temperature import Temperature
from gyrorig_solver.plan.predict import Rehearsal
from gyrorig_solver.plan.sensor import MOUNT, SensorModel

MOST = 8  # rows of a bank that are looked at: of its sizes, or of its shapes and moments
# A board that was just switched on: so much warmer in the end, and how soon (as remembered
# of small boards; a recording with readings of its own is judged by those).
WARMS_K, WARMS_WITHIN_S, ROOM_DEGC = 5.0, 120.0, 25.0


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One row of a cause's bank."""

    term: Term
    values: FloatArray  # (k,)
    size: float  # in typical sizes; 0 where the effect is taken as linear
    scanned: int  # how many rows of other shapes and moments a search would look at

    @property
    def typical(self) -> FloatArray:
        """The typical size of each of the term's sizes, shape (d,)."""
        own = value_parameters(self.term)
        return np.array([own[k].typical for k in indices(self.term, role="size")])


def scenes_of(made: Rehearsal, sensor: SensorModel, site: Site) -> list[Scene]:
    """Return what causes may look at, part by part of the series."""
    series, reference = made.series, made.reference
    parts = series.parts()
    setting = Setting(
        site=site,
        temperature=_warming(float(series.time_s[-1])),
        rad_per_step=reference.rad_per_step,
        courses=tuple((axis, c) for axis in (0, 1) for c in made.timeline.courses[axis]),
        begin_s=float(series.time_s[0]),
        end_s=float(series.time_s[-1]),
        full_scale_rad_s=sensor.full_scale_rad_s,
        quantum_rad_s=sensor.quantum_rad_s,
        sample_period_s=series.period_s,
    )
    return [_scene(made, setting, series, blocks) for blocks in parts]


def looks_for(term: Term, scene: Scene) -> list[Look]:
    """Return the rows of a cause's bank to look at."""
    bank = term.bank(scene)
    sizes = indices(term, role="size")
    parameters = value_parameters(term)
    typical = np.array([parameters[k].typical for k in sizes])
    size = np.abs(bank[:, sizes] / typical).max(axis=1)
    if (size == 0.0).any():
        bank, size = bank[size == 0.0], size[size == 0.0]
    shape = bank.copy()
    shape[:, sizes] = 0.0
    _, first, group = np.unique(shape, axis=0, return_index=True, return_inverse=True)
    count = first.size
    groups = _some(np.argsort(first), 1 if bank.shape[0] > count else MOST)
    found = []
    for one in groups:
        rows = np.flatnonzero(group.ravel() == one)
        rows = rows[np.argsort(size[rows], kind="stable")]
        for row in _some(rows, MOST):
            found.append(Look(term, bank[row], float(size[row]), count))
    return found


def batches(looks: Sequence[Look], most: int) -> Iterator[list[Look]]:
    """Yield looks in turn, each time as many as have about `most` sizes together."""
    batch: list[Look] = []
    held = 0
    for look in looks:
        if batch and held + look.typical.size > most:
            yield batch
            batch, held = [], 0
        batch.append(look)
        held += look.typical.size
    if batch:
        yield batch


def _scene(made: Rehearsal, setting: Setting, series: Series, blocks: slice) -> Scene:
    # Where a block is a sample, corners of a few ms show only on the samples' own fine grid.
    per, fine = (1, series.fine) if series.block == 1 else (instants_per_block(series), 1)
    edges = series.block_edges_s(blocks, per * fine)
    return Scene.build(
        edges,
        made.reference.angles_rad(edges),
        np.ones((blocks.stop - blocks.start) * per, dtype=np.bool_),
        block=per,
        fine=fine,
        bandwidth_hz=series.bandwidth_hz,
        gain=MOUNT,
        rate_rad_s=made.reference.evaluate(edges, derivatives=False).rate_rad_s,
        setting=setting,
    )


def _warming(until_s: float) -> Temperature:
    time_s = np.arange(0.0, until_s + 2.0)
    degc = ROOM_DEGC + WARMS_K * (1.0 - np.exp(-time_s / WARMS_WITHIN_S))
    return Temperature(time_s, degc, float(degc.mean()))


def _some(of: IntArray, most: int) -> IntArray:
    """Return at most so many elements, each from the middle of an equal share of them."""
    if of.size <= most:
        return of
    return of[((np.arange(most) + 0.5) * of.size / most).astype(np.int64)]
