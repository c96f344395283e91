"""All derivatives of a fit, whitened, and what is known of its unknowns.

What to use when: `base_of` for the space that a fit can follow; projection.py takes it out of
signals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.fft import idct
from scipy.sparse import block_diag, csc_array, csr_array

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.estimate.chain import columns_of
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import GAINS, PER_SESSION, Solution
from gyrorig_solver.estimate.observability import PRIOR_STD
from gyrorig_solver.estimate.stretch import Stretch
from gyrorig_solver.estimate.whitening import PartModel
from gyrorig_solver.model.terms.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known of everything a fit moves: local unknowns, and the others."""

    local: csc_array
    cross: FloatArray
    shared: FloatArray
    pull_local: FloatArray
    pull_shared: FloatArray
    first: int  # where the causes begin among the shared ones
    board: int  # and where they end: the first so many are the board's, G, b, tau, causes
    away: FloatArray = field(default_factory=lambda: np.zeros(0))  # of a motion's unknowns:
    # where knowledge has them, minus where they are


def base_of(
    solution: Solution, stretches: Sequence[Stretch], extensions: Sequence[Extension]
) -> tuple[FloatArray, csr_array, Prior]:
    """Return all derivatives of a fit, whitened, and what is known of its unknowns.

    In the order G, each recording's (b, tau), the causes, each reference's shared unknowns.
    """
    many = len(solution.sessions)
    causes = sum(one.free.size for one in extensions)
    board = GAINS + PER_SESSION * many + causes
    known = [session.reference.information for session in solution.sessions]
    shared_at = board + np.cumsum([0, *(k.size[1] for k in known)])
    local_at = np.cumsum([0, *(k.size[0] for k in known)])
    length = [3 * sum(u.size for u in s.used) for s in stretches]
    starts = np.cumsum([0, *length])
    base = np.zeros((int(shared_at[-1]), int(starts[-1])))
    rows, columns, values = [], [], []
    for s, start, size in zip(stretches, starts[:-1], length, strict=True):
        own = GAINS + PER_SESSION * s.session
        acting = s.models[0].columns.shared.shape[0]
        after = GAINS + PER_SESSION * many
        at = [
            *range(GAINS),
            *range(own, own + PER_SESSION),
            *range(after, after + causes),
            *range(int(shared_at[s.session]), int(shared_at[s.session]) + acting),
        ]
        parts = [
            _columns(model, scene, solution.gain, extensions)
            for model, scene in zip(s.models, s.exact, strict=True)
        ]
        base[at, start : start + size] = s.whitened(parts)
        for found in _locals(s, solution.gain, int(start)):
            rows.append(found[0] + local_at[s.session])
            columns.append(found[1])
            values.append(found[2])
    shape = (int(local_at[-1]), int(starts[-1]))
    triple = (
        np.concatenate(values or [np.zeros(0)]),
        (
            np.concatenate(rows or [np.zeros(0, np.int64)]),
            np.concatenate(columns or [np.zeros(0, np.int64)]),
        ),
    )
    local = csr_array(triple, shape=shape)
    return base, local, _known(solution, extensions, board, shared_at, local_at)


def _known(
    solution: Solution,
    extensions: Sequence[Extension],
    board: int,
    shared_at: IntArray,
    local_at: IntArray,
) -> Prior:
    size = int(shared_at[-1])
    shared, cross = np.zeros((size, size)), np.zeros((int(local_at[-1]), size))
    pull_local, pull_shared = np.zeros(int(local_at[-1])), np.zeros(size)
    # What no motion fixes has its prior, or a cause in that direction would look seen.
    each = [PRIOR_STD["bias"]] * 3 + [PRIOR_STD["time_offset"]]
    std = [PRIOR_STD["gain"]] * GAINS + each * len(solution.sessions)
    std += [float(v) for one in extensions for v in one.prior_std]
    shared[np.arange(board), np.arange(board)] = np.array(std) ** -2.0
    first = GAINS + PER_SESSION * len(solution.sessions)
    for one in extensions:
        at = slice(first, first + one.free.size)
        if one.told is not None:
            shared[at, at] += one.told.information
            pull_shared[at] += one.told.pull(one.values[one.free])
        first = at.stop
    near = []
    pulls = [(one.reference.pull, one.reference.information.size[0]) for one in solution.sessions]
    away = np.concatenate([*(p[:m] for p, m in pulls), *(p[m:] for p, m in pulls)])
    for k, session in enumerate(solution.sessions):
        known = session.reference.information
        pull = known.times(session.reference.pull)
        here = slice(int(shared_at[k]), int(shared_at[k + 1]))
        there = slice(int(local_at[k]), int(local_at[k + 1]))
        near.append(known.local)
        cross[there, here], shared[here, here] = known.cross, known.shared
        pull_local[there] = pull[: known.size[0]]
        pull_shared[here] = pull[known.size[0] :]
    some = [one for one in near if one.shape[0]]
    local = csc_array(block_diag(some, format="csc")) if some else csc_array((0, 0))
    first = GAINS + PER_SESSION * len(solution.sessions)
    return Prior(local, cross, shared, pull_local, pull_shared, first, board, away)


def _columns(
    model: PartModel, scene: Scene, gain: FloatArray, extensions: Sequence[Extension]
) -> FloatArray:
    """Return a part's derivatives by all but local unknowns, sensor frame, (q, n, 3)."""
    causes = columns_of(extensions, scene)
    return np.concatenate([model.own(gain), causes, model.shared(gain)])


def _locals(
    s: Stretch, gain: FloatArray, start: int
) -> list[tuple[IntArray, IntArray, FloatArray]]:
    """Return rows, columns and values of a series' local derivatives, whitened."""
    found = []
    for model in s.models:
        lanes, n = model.columns.lanes, model.used.size
        if lanes.count:
            deviation = np.sqrt(s.noise.variance(n))
            felt = idct(
                model.lane_signals(gain) / deviation.T[:, None, :],
                axis=-1,
                norm="ortho",
            )
            for k in range(lanes.count):
                a, b = int(lanes.first[k]), int(lanes.stop[k])
                value = felt[:, lanes.lane[k], a:b] * lanes.scale[k]
                place = start + np.arange(3)[:, None] * n + np.arange(a, b)
                row = np.full(value.size, lanes.unknown[k], dtype=np.int64)
                found.append((row, place.ravel(), value.ravel()))
        start += 3 * n
    return found
