"""The series of one recording in a fit, in the order of time.

What to use when: `RecordingSeries` for values of all series; `SessionFit` extends it by the fit.
"""

from collections.abc import Sequence
from functools import reduce
from operator import add

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.initial_guess import LeastSquaresSums
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.estimate.series_state import SeriesState


class RecordingSeries:
    """The states of all series of a recording."""

    def __init__(self, series: Sequence[Series]) -> None:
        """Start before any prediction."""
        self._series_states = [SeriesState.empty(one_series) for one_series in series]

    @property
    def series(self) -> list[Series]:
        """The series, in the order of time."""
        return [series_state.series for series_state in self._series_states]

    @property
    def measured(self) -> list[FloatArray]:
        """Measured block means, (n, 3) per series."""
        return [series_state.measured for series_state in self._series_states]

    @property
    def cause_effects(self) -> list[FloatArray]:
        """The effect of causes beyond the base model, sensor frame, (n, 3) per series."""
        return [series_state.effect for series_state in self._series_states]

    @property
    def rates(self) -> list[FloatArray]:
        """Stage rates, (n, 3) per series."""
        return [series_state.rate for series_state in self._series_states]

    @property
    def used(self) -> list[BoolArray]:
        """Which blocks are used, (n,) per series."""
        return [series_state.used for series_state in self._series_states]

    @property
    def used_samples(self) -> list[BoolArray]:
        """Which samples of each block are used, (n, m) per series."""
        return [series_state.used_samples for series_state in self._series_states]

    @property
    def moving(self) -> list[BoolArray]:
        """Which blocks are in motion, (n,) per series."""
        return [series_state.moving for series_state in self._series_states]

    @property
    def outliers(self) -> int:
        """The number of samples rejected as outliers."""
        return sum(series_state.outlier_count for series_state in self._series_states)

    def least_squares_sums(self, masks: Sequence[BoolArray]) -> LeastSquaresSums:
        """Return the sums of least squares over masked blocks of each series."""
        pairs = zip(self._series_states, masks, strict=True)
        return reduce(add, (series_state.least_squares_sums(mask) for series_state, mask in pairs))
