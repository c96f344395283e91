"""Lag of the samples behind the motion: straight lines in time, with jumps between them.

A clock that is set right jumps between two samples. The samples after the jump show the motion as
the sensor's low-pass has followed it, at other times.
"""

from dataclasses import dataclass
from typing import Protocol

from gyrorig_daemon.emulator.physics.lowpass import FloatArray

MIN_JUMP_S = 1e-9  # less is the rounding of a line


class LagSource(Protocol):
    """The source of a lag, such as the hooks of a board."""

    def lag(self, time_s: float) -> tuple[float, float]:
        """Return the lag at a time, and its growth per second."""
        ...


@dataclass(frozen=True, slots=True)
class LagLine:
    """A lag that grows at a constant rate."""

    time_s: float
    lag_s: float  # at this time
    growth: float  # s per s

    def at(self, time_s: float) -> float:
        """Return the lag at a time."""
        return self.lag_s + self.growth * (time_s - self.time_s)

    def motion_duration_s(self, duration_s: float) -> float:
        """Return how long the motion is that the samples show in some time."""
        return duration_s * (1.0 - self.growth)

    def continues(self, other: "LagLine", time_s: float) -> bool:
        """Return whether another line has the same lag at a time."""
        return abs(self.at(time_s) - other.at(time_s)) < MIN_JUMP_S


def lag_lines(source: LagSource, begin_s: float, time_s: FloatArray) -> list[tuple[int, LagLine]]:
    """Return the lines that a block's samples follow, each with the index of its first sample.

    Args:
        source: of the lag.
        begin_s: start of the block, one period before its first sample.
        time_s: of the samples.
    """
    current = LagLine(begin_s, *source.lag(begin_s))
    lines = {0: current}
    for k, sample_s in enumerate(time_s.tolist()):
        line = LagLine(sample_s, *source.lag(sample_s))
        if not current.continues(line, sample_s):
            current = lines[k] = line
    return list(lines.items())
