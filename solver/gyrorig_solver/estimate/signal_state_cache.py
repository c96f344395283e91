"""Signal states of a recording's series at the current values of a fit, cached if recent.

What to use when: `SignalStateCache.state` for one part of a series.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.estimate.reference_prediction import instants_per_block
from gyrorig_solver.estimate.series import PART_BLOCKS, Series
from gyrorig_solver.estimate.series_state import FitValues
from gyrorig_solver.model import RecordingContext, SignalState
from gyrorig_solver.reference import ReferenceMotion


class SignalStateCache:
    """Builds signal states, and caches the latest ones for fit, derivatives and search."""

    def __init__(self, context: RecordingContext | None) -> None:
        """Start without states; `context`: facts that causes beyond the base model need."""
        self.context = context
        self._states: dict[tuple[int, int, bool], tuple[FitValues, SignalState]] = {}

    def clear(self) -> None:
        """Free the states."""
        self._states.clear()

    def copy(self) -> "SignalStateCache":
        """Return a cache with the same states."""
        other = SignalStateCache(self.context)
        other._states = self._states.copy()
        return other

    def state(self, series: Series, blocks: slice, values: FitValues, exact: bool) -> SignalState:
        """Return the signal state of one part of a series.

        Args:
            series: one of the recording.
            blocks: of the part.
            values: of the fit.
            exact: use the fine grid of the samples, on which pulses and corners of a few
                milliseconds are visible. Otherwise use a coarse grid, sufficient for derivatives.
        """
        key = id(series), blocks.start, exact
        if key in self._states and self._states[key][0].equals(values):
            return self._states[key][1]
        built_state = self._build(series, blocks, values, exact)
        if series.block_count * series.intervals_per_sample <= 2 * PART_BLOCKS:
            self._states[key] = values, built_state
        return built_state

    def _build(self, series: Series, blocks: slice, values: FitValues, exact: bool) -> SignalState:
        instants, intervals_per_instant = (
            (series.samples_per_block, series.intervals_per_sample)
            if exact
            else (instants_per_block(series), 1)
        )
        edges = series.block_edges_s(blocks, instants * intervals_per_instant) - values.lag_s
        angles = getattr(values.reference, "angles_rad", None)
        return SignalState.build(
            edges,
            None if angles is None else angles(edges),
            np.ones((blocks.stop - blocks.start) * instants, dtype=np.bool_),
            instants_per_block=instants,
            intervals_per_instant=intervals_per_instant,
            bandwidth_hz=series.filter_bandwidth_hz,
            gain=values.gain,
            bias_rad_s=values.bias_rad_s,
            rate_rad_s=values.reference.evaluate(edges, derivatives=False).rate_rad_s,
            context=self._context_at(values.reference),
        )

    def _context_at(self, reference: ReferenceMotion) -> RecordingContext | None:
        """Return the context with the motion profiles of a reference."""
        profiles = getattr(reference, "profiles", None)
        if self.context is None or profiles is None or self.context.motion_profiles is profiles:
            return self.context
        return replace(self.context, motion_profiles=profiles)
