"""The gyroscopes of a flight log: which of several messages has the rates, and their names.

What to use when: `choose_source` for one gyroscope whose rates a log has in several messages;
`name_boards` for the boards of all gyroscopes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.measured_streams import MeasuredBoard

MIN_RATE_SHARE = 0.5  # of the fastest message of the same gyroscope
MIN_SAMPLES = 3


@dataclass(frozen=True, slots=True, eq=False)
class RateSource:
    """The rates of one gyroscope in one kind of message."""

    name: str
    time_s: FloatArray  # (n,)
    rate_rad_s: FloatArray  # (n, 3)

    def in_order(self) -> "RateSource":
        """Return the rows with finite values, sorted by time, each time once."""
        valid = np.flatnonzero(np.isfinite(self.time_s) & np.all(np.isfinite(self.rate_rad_s), 1))
        _, first = np.unique(self.time_s[valid], return_index=True)
        return RateSource(self.name, self.time_s[valid[first]], self.rate_rad_s[valid[first]])

    @property
    def rate_hz(self) -> float:
        """Return the sample rate."""
        step_s = float(np.median(np.diff(self.time_s)))
        return 1.0 / step_s if step_s > 0.0 else 0.0


def choose_source(
    sources: Sequence[RateSource], notes: list[str], gyroscope: str
) -> RateSource | None:
    """Return the first source that is not much slower than the fastest; None if none is usable.

    Args:
        sources: in the order of preference, the least processed first.
        notes: texts for a reader; may be appended to.
        gyroscope: the name of the gyroscope in these texts.
    """
    usable = [source.in_order() for source in sources]
    usable = [source for source in usable if source.time_s.size >= MIN_SAMPLES]
    if not usable:
        return None
    fastest_hz = max(source.rate_hz for source in usable)
    chosen = next(s for s in usable if s.rate_hz >= MIN_RATE_SHARE * fastest_hz)
    slower = list(usable[: usable.index(chosen)])
    for source in slower:
        notes.append(
            f"{gyroscope}: {source.name} was logged with only {source.rate_hz:.3g} Hz, so the "
            f"rates are those of {chosen.name} with {chosen.rate_hz:.4g} Hz"
        )
    return chosen


def name_boards(
    boards: Sequence[MeasuredBoard], name: str | None, default: str
) -> tuple[MeasuredBoard, ...]:
    """Return boards with names: the given one alone, or a name and a number for several."""
    if len(boards) == 1 and name:
        return (replace(boards[0], name=name),)
    return tuple(replace(board, name=f"{name or default}-{board.name}") for board in boards)
