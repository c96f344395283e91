"""Templates of the catalogue's causes in a simulated motion.

What to use when: `signal_states` for the states that causes act on; `scan_templates` for a few
templates of a cause. They differ in size if the effect is nonlinear, otherwise in shape and event.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate import TYPICAL_MOUNT, Series
from gyrorig_solver.estimate.reference_prediction import instants_per_block
from gyrorig_solver.model import (
    BoardTemperature,
    RecordingContext,
    SignalState,
    Site,
    Term,
    value_indices,
    value_parameters,
)
from gyrorig_solver.plan.prediction import SimulatedSession
from gyrorig_solver.plan.sensor_model import SensorModel

# evaluated rows of a template bank: of its sizes, or of its shapes and event times
MAX_TEMPLATES = 8
# Warm-up of a board after power-on: final temperature rise and time constant, from memory of small
# boards. A solve uses the temperature readings of the recording.
WARM_UP_K, WARM_UP_TIME_CONSTANT_S, ROOM_DEGC = 5.0, 120.0, 25.0


@dataclass(frozen=True, slots=True, eq=False)
class ScanTemplate:
    """One template of a cause."""

    term: Term
    values: FloatArray  # (k,)
    size: float  # in typical sizes; 0 if the effect is treated as linear
    template_count: int  # number of shapes and event times that a search would scan

    @property
    def typical_sizes(self) -> FloatArray:
        """The typical size of each of the term's sizes, shape (d,)."""
        parameters = value_parameters(self.term)
        return np.array([parameters[k].typical_size for k in value_indices(self.term, role="size")])


def signal_states(session: SimulatedSession, sensor: SensorModel, site: Site) -> list[SignalState]:
    """Return the signal state of each part of the series."""
    series, reference = session.series, session.reference
    parts = series.part_slices()
    setting = RecordingContext(
        site=site,
        temperature=_warm_up_temperature(float(series.time_s[-1])),
        rad_per_step=reference.rad_per_step,
        motion_profiles=tuple(
            (axis, c) for axis in (0, 1) for c in session.timeline.profiles[axis]
        ),
        begin_s=float(series.time_s[0]),
        end_s=float(series.time_s[-1]),
        full_scale_rad_s=sensor.full_scale_rad_s,
        quantum_rad_s=sensor.quantum_rad_s,
        sample_period_s=series.period_s,
    )
    return [_signal_state(session, setting, series, blocks) for blocks in parts]


def scan_templates(term: Term, scene: SignalState) -> list[ScanTemplate]:
    """Return the templates of a cause to evaluate."""
    bank = term.template_bank(scene)
    sizes = value_indices(term, role="size")
    parameters = value_parameters(term)
    typical = np.array([parameters[k].typical_size for k in sizes])
    size = np.abs(bank[:, sizes] / typical).max(axis=1)
    if (size == 0.0).any():
        bank, size = bank[size == 0.0], size[size == 0.0]
    shape = bank.copy()
    shape[:, sizes] = 0.0
    _, first, group = np.unique(shape, axis=0, return_index=True, return_inverse=True)
    count = first.size
    groups = _evenly_chosen(np.argsort(first), 1 if bank.shape[0] > count else MAX_TEMPLATES)
    templates = []
    for shape_number in groups:
        rows = np.flatnonzero(group.ravel() == shape_number)
        rows = rows[np.argsort(size[rows], kind="stable")]
        for row in _evenly_chosen(rows, MAX_TEMPLATES):
            templates.append(ScanTemplate(term, bank[row], float(size[row]), count))
    return templates


def template_batches(
    templates: Sequence[ScanTemplate], max_sizes: int
) -> Iterator[list[ScanTemplate]]:
    """Yield templates in batches of about `max_sizes` sizes."""
    batch: list[ScanTemplate] = []
    size_count = 0
    for template in templates:
        if batch and size_count + template.typical_sizes.size > max_sizes:
            yield batch
            batch, size_count = [], 0
        batch.append(template)
        size_count += template.typical_sizes.size
    if batch:
        yield batch


def _signal_state(
    session: SimulatedSession, setting: RecordingContext, series: Series, blocks: slice
) -> SignalState:
    # If a block is one sample, features of a few ms are visible only on the samples' fine grid.
    points_per_block, fine = (
        (1, series.intervals_per_sample)
        if series.samples_per_block == 1
        else (instants_per_block(series), 1)
    )
    edges = series.block_edges_s(blocks, points_per_block * fine)
    return SignalState.build(
        edges,
        session.reference.angles_rad(edges),
        np.ones((blocks.stop - blocks.start) * points_per_block, dtype=np.bool_),
        instants_per_block=points_per_block,
        intervals_per_instant=fine,
        bandwidth_hz=series.bandwidth_hz,
        gain=TYPICAL_MOUNT,
        rate_rad_s=session.reference.evaluate(edges, derivatives=False).rate_rad_s,
        context=setting,
    )


def _warm_up_temperature(until_s: float) -> BoardTemperature:
    time_s = np.arange(0.0, until_s + 2.0)
    degc = ROOM_DEGC + WARM_UP_K * (1.0 - np.exp(-time_s / WARM_UP_TIME_CONSTANT_S))
    return BoardTemperature(time_s, degc, float(degc.mean()))


def _evenly_chosen(items: IntArray, count: int) -> IntArray:
    """Return at most `count` items, each the middle one of an equal share of them."""
    if items.size <= count:
        return items
    return items[((np.arange(count) + 0.5) * items.size / count).astype(np.int64)]
