"""Where two stepper axes are, by closed forms: trapezoids between rests.

An axis jumps to the base speed, ramps, cruises and comes to rest the same way back
(reference: command reference manual v3.00D, section 5). A rest may lie off its count by
a detent's error, which the axis gains in proportion to its way there.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
RAD_PER_STEP = float(np.radians(185.142857 / 3600.0))  # D46 user's manual v2.14, half step


@dataclass(frozen=True)
class Trapezoid:
    """One move of one axis from rest to rest."""

    axis: int  # 0 pan, 1 tilt
    start_s: float
    begin_steps: float
    end_steps: float
    speed_steps_s: float
    acceleration_steps_s2: float
    base_steps_s: float

    @property
    def sign(self) -> float:
        """Which way it goes."""
        return 1.0 if self.end_steps > self.begin_steps else -1.0

    @cached_property
    def _legs(self) -> tuple[float, float, float, float]:
        """Return base and top speed, and how long ramp and cruise last."""
        way, ramp = float(abs(self.end_steps - self.begin_steps)), self.acceleration_steps_s2
        base = min(self.base_steps_s, self.speed_steps_s)
        # From v0^2 + 2 a d = v^2 up and down again: the top speed of a short move.
        top = min(self.speed_steps_s, float(np.sqrt(base**2 + ramp * way)))
        up_s = (top - base) / ramp
        cruise_s = (way - (top**2 - base**2) / ramp) / top
        return base, top, up_s, max(0.0, cruise_s)

    @cached_property
    def end_s(self) -> float:
        """When it stands."""
        _, _, up_s, cruise_s = self._legs
        return self.start_s + 2.0 * up_s + cruise_s

    def gone_steps(self, time_s: FloatArray) -> FloatArray:
        """Return the way gone, not signed."""
        base, top, up_s, cruise_s = self._legs
        way = float(abs(self.end_steps - self.begin_steps))
        ramp = self.acceleration_steps_s2

        def rising(since: FloatArray) -> FloatArray:
            on_ramp = np.clip(since, 0.0, up_s)
            on_top = np.maximum(since - up_s, 0.0)
            return np.asarray(base * on_ramp + 0.5 * ramp * on_ramp**2 + top * on_top)

        whole_s = 2.0 * up_s + cruise_s
        since = np.clip(time_s - self.start_s, 0.0, whole_s)
        half = whole_s / 2.0
        first, last = (
            rising(np.minimum(since, half)),
            way - rising(np.minimum(whole_s - since, half)),
        )
        gone = np.where(since < half, first, last)
        return np.asarray(np.where(since >= whole_s, way, gone), dtype=np.float64)

    def speed_at_steps_s(self, time_s: FloatArray) -> FloatArray:
        """Return the signed speed."""
        base, top, up_s, cruise_s = self._legs
        since = time_s - self.start_s
        left = 2.0 * up_s + cruise_s - since
        speed = np.minimum(top, base + self.acceleration_steps_s2 * np.minimum(since, left))
        return np.where((since > 0.0) & (left > 0.0), self.sign * speed, 0.0)


_Moves = tuple[list[Trapezoid], FloatArray, FloatArray]  # moves, their starts and ends


@dataclass(frozen=True, eq=False)
class Path:
    """All moves of both axes, and how far each rest is off its count.

    `off_steps[axis][k]` is the rest before that axis' k-th move; one more after the last.
    """

    moves: tuple[Trapezoid, ...]
    off_steps: tuple[FloatArray, FloatArray]
    begin_steps: tuple[int, int] = (0, 0)

    def of_axis(self, axis: int) -> list[Trapezoid]:
        """Return one axis' moves in the order of time."""
        return self._by_axis[axis][0]

    def counted_steps(self, axis: int, time_s: FloatArray) -> FloatArray:
        """Return where the controller has the axis, without detents; times not decreasing."""
        return self._where(axis, time_s, detents=False)

    def angle_rad(self, axis: int, time_s: FloatArray) -> FloatArray:
        """Return the true angle; times not decreasing."""
        return self._where(axis, time_s, detents=True) * RAD_PER_STEP

    @cached_property
    def _by_axis(self) -> tuple[_Moves, _Moves]:
        tables = []
        for axis in (0, 1):
            axis_moves = [move for move in self.moves if move.axis == axis]
            starts = np.array([move.start_s for move in axis_moves])
            tables.append((axis_moves, starts, np.array([move.end_s for move in axis_moves])))
        return tables[0], tables[1]

    def _where(self, axis: int, time_s: FloatArray, detents: bool) -> FloatArray:
        moves, starts, ends = self._by_axis[axis]
        off = self.off_steps[axis] if detents else np.zeros(len(moves) + 1)
        if time_s.size == 0:
            return np.zeros(0)
        ended = int(np.searchsorted(ends, time_s[0]))
        begun = int(np.searchsorted(starts, time_s[-1], side="right"))
        stood = moves[ended - 1].end_steps if ended else self.begin_steps[axis]
        where = np.full(time_s.size, stood + off[ended])
        for k in range(ended, begun):
            move, gained = moves[k], off[k + 1] - off[k]
            first, last = np.searchsorted(time_s, [move.start_s, move.end_s])
            if last > first:
                gone = move.gone_steps(time_s[first:last])
                share = gone / abs(move.end_steps - move.begin_steps)
                where[first:last] = move.begin_steps + move.sign * gone + off[k] + gained * share
            where[last:] = move.end_steps + off[k + 1]
        return where

    def mean_rate_rad_s(self, edges_s: FloatArray) -> FloatArray:
        """Return the stage's mean rate between edges in its own frame, shape (n, 3).

        R = Rz(pan) Rx(tilt): (tilt', pan' sin tilt, pan' cos tilt), contract: frames.
        """
        width = np.diff(edges_s)
        pan, tilt = self.angle_rad(0, edges_s), self.angle_rad(1, edges_s)
        middle = self.angle_rad(1, (edges_s[1:] + edges_s[:-1]) / 2.0)
        pan_rate, tilt_rate = np.diff(pan) / width, np.diff(tilt) / width
        return np.column_stack([tilt_rate, pan_rate * np.sin(middle), pan_rate * np.cos(middle)])
