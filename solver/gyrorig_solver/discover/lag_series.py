"""The lag of the samples behind the reference, by time: estimates in windows of some seconds.

In each window, the lag changes the samples in proportion to the time derivative of the rate. The
score and the information of all windows, with the nuisance parameters eliminated, are a
nonparametric estimate of the lag over time. It is fast to compare the shape of a clock error with
this estimate, so that the search can try many periods and phases.

What to use when: `LagSeries.at` for the estimate; `lag_templates` for the templates of a cause that
fit it best; `lag_family` for the test whether the lag changes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.checks.basis_family import BasisFamily
from gyrorig_solver.estimate import NuisanceProjector, ScoreStatistics
from gyrorig_solver.model import SignalState, Term, zero_signals
from gyrorig_solver.numerics import chi2_upper_tail, score_statistic

WINDOW_S = 2.0
MAX_WINDOWS = 60
POINTS_PER_WINDOW = 5  # times over which a shape is averaged
WINDOWS_PER_BATCH = 20  # windows that are whitened together
NEGLIGIBLE_INFORMATION = 1e-6  # share of the energy; the fit absorbs a lag with less information
MAX_TEMPLATES = 2  # templates that are fitted exactly
MIN_DISTANCE = 0.02  # share of the information that two templates do not have in common
LAG_FAMILY = "lag_time"


@dataclass(frozen=True, slots=True, eq=False)
class LagSeries:
    """The lag in each of m windows, to first order."""

    edges_s: FloatArray  # (m + 1,)
    statistics: ScoreStatistics  # of the lag in each window

    @classmethod
    def at(cls, projection: NuisanceProjector) -> Self:
        """Return the series of a residual; `projection`: the nuisance projector at the fit."""
        edges_s = window_edges_s(projection.states)
        return cls(edges_s, lag_family(projection.states).statistics(projection))

    @property
    def p_value(self) -> float:
        """The p-value of the test that the lag does not change."""
        largest = max(float(self.statistics.energy.max()), 1e-300)
        statistic, degrees = score_statistic(
            self.statistics.information, self.statistics.score, NEGLIGIBLE_INFORMATION, largest
        )
        return chi2_upper_tail(statistic, degrees) if degrees else 1.0

    def score_shapes(self, shapes_s: FloatArray) -> FloatArray:
        """Return the score statistic (b,) of each shape; `shapes_s`: lags by window, (b, m)."""
        information = np.einsum("bm,bm->b", shapes_s @ self.statistics.information, shapes_s)
        energy = shapes_s**2 @ self.statistics.energy
        is_seen = information > NEGLIGIBLE_INFORMATION * energy
        score = shapes_s @ self.statistics.score
        return np.where(is_seen, score**2 / np.where(is_seen, information, 1.0), 0.0)


def window_edges_s(states: Sequence[SignalState]) -> FloatArray:
    """Return the edges of the windows, (m + 1,).

    They cover the recordings in which the board turns, because a rest shows no lag.

    Args:
        states: all parts of all recordings that are fitted together. If all are at rest, the
            windows cover all of them.
    """
    turning = {state.context.recording_index for state in states if not state.is_at_rest}
    contexts = [
        state.context for state in states if not turning or state.context.recording_index in turning
    ]
    begin_s = min(context.begin_s for context in contexts)
    end_s = max(context.end_s for context in contexts)
    count = int(np.clip((end_s - begin_s) / WINDOW_S, 1, MAX_WINDOWS))
    return np.linspace(begin_s, end_s, count + 1)


def lag_family(states: Sequence[SignalState]) -> BasisFamily:
    """Return the family of lags that are constant in windows of some seconds."""
    edges_s = window_edges_s(states)
    count = edges_s.size - 1
    batches = tuple(
        partial(_window_signals, edges_s[first : first + WINDOWS_PER_BATCH + 1])
        for first in range(0, count, WINDOWS_PER_BATCH)
    )
    return BasisFamily(LAG_FAMILY, "on the time (the lag changes)", batches, np.ones(count))


def lag_templates(projection: NuisanceProjector, term: Term) -> tuple[FloatArray, int]:
    """Return the templates of a cause that fit the lag by time best (b, k), out of how many."""
    series = LagSeries.at(projection)
    middle_s = 0.5 * (series.edges_s[:-1] + series.edges_s[1:])
    bank = np.unique(np.concatenate([term.template_bank(s) for s in projection.states]), axis=0)
    # A correction of the clock can be inside a window, so the shape is averaged over the window.
    width_s = series.edges_s[1] - series.edges_s[0]
    shares = (np.arange(POINTS_PER_WINDOW) + 0.5) / POINTS_PER_WINDOW - 0.5
    fine_s = (middle_s[:, None] + shares * width_s).ravel()
    shapes = np.array(
        [term.lag_shape(fine_s, row).reshape(-1, POINTS_PER_WINDOW).mean(axis=1) for row in bank]
    )
    statistics = series.score_shapes(shapes)
    chosen: list[int] = []
    for k in np.argsort(-statistics).tolist():
        if all(_difference(series, shapes[k], shapes[j]) > MIN_DISTANCE for j in chosen):
            chosen.append(k)
        if len(chosen) == MAX_TEMPLATES:
            break
    return np.asarray(bank[chosen], dtype=np.float64), len(bank)


def _difference(series: LagSeries, first: FloatArray, second: FloatArray) -> float:
    """Return the share of the energy that two shapes do not have in common."""
    information = series.statistics.information
    both = float(first @ information @ second)
    energies = float(first @ information @ first) * float(second @ information @ second)
    return 1.0 - both**2 / energies if energies > 0.0 else 1.0


def _window_signals(edges_s: FloatArray, scene: SignalState) -> FloatArray:
    """Return the effect of a lag of 1 s in each window, (m, blocks, 3)."""
    signals = zero_signals(edges_s.size - 1, scene.interval_count)
    bounds = np.searchsorted(scene.time_s, edges_s)
    for k, (first, last) in enumerate(pairwise(bounds)):
        signals[k, first:last] = scene.filtered_slope_rad_s2[first:last]
    return scene.sample_output(signals)
