"""Which rows of a cause's bank are looked at in a residual.

What to use when: `quick_rows` for a pass over the whole catalogue, `all_rows` for a cause
that is being weighed. Lost steps and lines are as short, or as narrow, as can be: where to
look is read from the residual first, at a product each.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.bases import BaseTerm, start_values
from gyrorig_solver.model.terms.bound import acts_in
from gyrorig_solver.model.terms.lost_steps import pulses
from gyrorig_solver.model.terms.protocol import Term, indices, value_parameters
from gyrorig_solver.model.terms.supply_hum import FEWEST_WAVES, waves

QUICK = 20  # rows to a cause in the pass over all
BEST = 12  # of the moments or lines that a residual shows
APART_S = 0.1  # two moments less apart are one
PULSES = 4  # pulses looked at for one that is independent: two a block, two blocks wide
FINER = 4  # the line's power is read this much finer than a periodogram has it


def quick_rows(projection: Projection, term: Term) -> tuple[FloatArray, int]:
    """Return rows (b, k) and how many places were looked at for them."""
    if term.cause == "lost_steps":
        return _pulses(projection, term)
    if term.cause == "supply_hum":
        return _lines(projection, term)
    rows = all_rows(projection, term)
    if term.cause == "ringing":  # as narrow as its damping: a mode that is left out is not seen
        return rows, len(rows)
    sizes = np.abs(rows[:, indices(term, role="size")]).max(axis=1)
    if (sizes == 0.0).any():
        rows = rows[sizes == 0.0]
    some = np.unique(np.round(np.linspace(0, len(rows) - 1, QUICK)).astype(np.int64))
    return rows[some], len(rows)


def all_rows(projection: Projection, term: Term) -> FloatArray:
    """Return the whole bank, (b, k); of lost steps and lines what the residual shows."""
    if term.cause == "lost_steps":
        return _pulses(projection, term)[0]
    if term.cause == "supply_hum":
        return _lines(projection, term)[0]
    return np.unique(np.concatenate([term.bank(scene) for scene in projection.scenes]), axis=0)


def _pulses(projection: Projection, term: Term) -> tuple[FloatArray, int]:
    times, gains, looked = [], [], 0
    for scene, weighed in zip(projection.scenes, projection.weighed(), strict=True):
        if not scene.has_angles or not acts_in(term, scene):
            continue
        found = pulses(scene)
        span = found.first[:, None] + np.arange(found.values.shape[1])
        score = np.einsum("rmi,rmi->r", weighed[span], found.values)
        energy = np.einsum("rmi,rmi->r", found.values, found.values)
        times.append(found.time_s)
        gains.append(score**2 / np.maximum(energy, 1e-30))
        looked += found.time_s.size
    rows = np.tile(_start(term), (BEST, 1))
    time_s, gain = np.concatenate(times), np.concatenate(gains)
    event = indices(term, role="event")[0]
    many = 0
    while many < BEST and gain.size:
        best = int(np.argmax(gain))
        rows[many, event] = time_s[best]
        keep = np.abs(time_s - time_s[best]) > APART_S
        time_s, gain, many = time_s[keep], gain[keep], many + 1
    return rows[:many], max(1, looked // PULSES)


def _lines(projection: Projection, term: Term) -> tuple[FloatArray, int]:
    own = [k for k, scene in enumerate(projection.scenes) if acts_in(term, scene)]
    scene, weighed = projection.scenes[own[0]], projection.weighed()[own[0]]
    bank = term.bank(scene)
    frequency = indices(term, role="shape")[0]
    length_s = float(scene.edges_s[-1] - scene.edges_s[0])
    rate_hz = weighed.shape[0] / length_s
    shown = waves(bank[:, frequency], rate_hz, length_s)
    bank, shown = bank[shown >= FEWEST_WAVES], shown[shown >= FEWEST_WAVES]
    power = np.abs(np.fft.rfft(weighed, FINER * weighed.shape[0], axis=0)) ** 2
    at = np.minimum(np.round(shown * FINER), power.shape[0] - 1)
    relative = power / np.mean(power, axis=0)
    order = np.argsort(-relative[at.astype(np.int64)].sum(axis=1), kind="stable")
    return bank[order[:BEST]], len(bank)


def _start(term: Term) -> FloatArray:
    if isinstance(term, BaseTerm):
        return start_values(term)
    return np.array([p.start for p in value_parameters(term)], dtype=np.float64)
