"""A set of signals of a sensor that depend on one covariate, with their statistics.

What to use when: `BasisFamily` for the signals of a covariate; `families_by_recording` for the
families of the time, of which each recording has its own axis.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.checks.windowed_signals import (
    WindowFunction,
    Windows,
    windowed_statistics,
)
from gyrorig_solver.estimate import (
    NuisanceProjector,
    ScoreStatistics,
    SignalFunction,
    WhitenedSignals,
)
from gyrorig_solver.model import AxisBiases, Signals, SignalState, Term


@dataclass(frozen=True, slots=True, eq=False)
class BasisFamily:
    """Smooth basis functions of one covariate; a covariate can have several families."""

    covariate: str
    description: str  # for example "on pan (the gain changes)"
    signals: tuple[SignalFunction, ...]  # each function returns some of the k signals
    detail: FloatArray  # (k,), half waves of each signal: 1 is the smoothest
    windows: Windows | None = None  # k windows, outside of which each signal is zero
    windows_sum: WindowFunction | None = None  # the sum of the signals of some windows
    recording_index: int | None = None  # outside of which each signal is zero; None: all recordings

    def statistics(self, projection: NuisanceProjector) -> ScoreStatistics:
        """Return the score statistics of the family's signals; computed once per projector."""
        key = f"{self.covariate}: {self.description}"
        if key not in projection.statistics_by_family:
            projection.statistics_by_family[key] = projection.score_statistics(
                self.whitened(projection)
            )
        return projection.statistics_by_family[key]

    def screen(self, projection: NuisanceProjector) -> ScoreStatistics | None:
        """Return statistics of nearly the same signals at little cost, or None."""
        if self.windows is None or self.windows_sum is None:
            return None
        return windowed_statistics(projection, self.windows_sum, self.windows)

    def whitened(self, projection: NuisanceProjector, term: Term | None = None) -> WhitenedSignals:
        """Return the family's signals in units of the noise.

        Args:
            projection: the nuisance projector at a fit.
            term: use the signal states at the input of this cause; None: states without causes.
        """
        return projection.evaluate_together(self.signals, self.detail.size, term)

    def limited_to(self, recording_index: int) -> Self:
        """Return the family with signals that are zero in all other recordings.

        Args:
            recording_index: index of the recording among those that are fitted together.
        """
        return replace(
            self,
            signals=tuple(
                partial(_signals_in_recording, recording_index, function)
                for function in self.signals
            ),
            recording_index=recording_index,
        )


def families_by_recording(
    scenes: Sequence[SignalState],
    make_families: Callable[[Sequence[SignalState], str], Iterable[BasisFamily]],
) -> Iterator[BasisFamily]:
    """Yield families of the time for each recording, because each has its own time axis.

    Args:
        scenes: all parts of all recordings that are fitted together.
        make_families: returns the families of the scenes of a recording; the second argument is the
            text for its time, for example "the time of recording 2".
    """
    recording_indices = sorted({scene.context.recording_index for scene in scenes})
    if len(recording_indices) < 2:
        yield from make_families(scenes, "the time")
        return
    for index in recording_indices:
        scenes_of_recording = [s for s in scenes if s.context.recording_index == index]
        for family in make_families(scenes_of_recording, f"the time of recording {index + 1}"):
            yield family.limited_to(index)


def _signals_in_recording(index: int, function: SignalFunction, scene: SignalState) -> Signals:
    signals = function(scene)
    if scene.context.recording_index == index:
        return signals
    if isinstance(signals, AxisBiases):
        return AxisBiases(np.zeros_like(signals.rows))
    return np.zeros_like(signals)
