"""Moves that the unit executed with other limits than commanded, for all moves of an axis.

A move from rest to rest with one command is a trapezoid of speed: see
`reference.unit.motion_profile`. Its position has a closed form, so that a fit of the limits does
not need a plan of every move.

What to use when: `simple_moves` for the moves of one axis, `SimpleMoves.position_change` for the
effect of other limits; `compound_moves` and `compound_change` for moves with commands during the
move.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.model.drive_effects import replan_with_limits
from gyrorig_solver.reference import MotionProfile

AxisProfiles = tuple[tuple[int, MotionProfile], ...]  # axis (0 pan, 1 tilt), profile
LimitChange = tuple[float, float]  # share of the acceleration, base speed in steps/s


@dataclass(frozen=True, slots=True, eq=False)
class SimpleMoves:
    """The moves of one axis from rest to rest, with one target and no other command in between.

    Moves at or below the base speed have no ramps and are left out.
    """

    start_s: FloatArray  # (m,)
    distance_steps: FloatArray  # (m,), signed
    speed_steps_s: FloatArray  # (m,), commanded, as are the next two
    acceleration_steps_s2: FloatArray  # (m,)
    base_speed_steps_s: FloatArray  # (m,)

    def position_change(
        self, edges_s: FloatArray, change: LimitChange, previous: LimitChange
    ) -> FloatArray:
        """Return the change of the position by other limits at the edges, steps, (n + 1,).

        Args:
            edges_s: increasing, shape (n + 1,).
            change: of the limits, in addition to `previous`.
            previous: change of the commanded limits with which the result is compared.
        """
        position_change = np.zeros_like(edges_s)
        moves = self._started_before(edges_s[-1])
        plans = (
            _Trapezoids.of(moves, (change[0] + previous[0], change[1] + previous[1])),
            _Trapezoids.of(moves, previous),
        )
        end_s = moves.start_s + np.maximum(plans[0].duration_s, plans[1].duration_s)
        first = np.searchsorted(edges_s, moves.start_s)
        count = np.maximum(np.searchsorted(edges_s, end_s) - first, 0)
        move = np.repeat(np.arange(count.size), count)
        edge = np.arange(move.size) + np.repeat(first - np.cumsum(count) + count, count)
        elapsed_s = edges_s[edge] - moves.start_s[move]
        difference = plans[0].covered_steps(move, elapsed_s) - plans[1].covered_steps(
            move, elapsed_s
        )
        # A move with other limits can last until the next move has started.
        np.add.at(position_change, edge, np.sign(moves.distance_steps)[move] * difference)
        return position_change

    def _started_before(self, time_s: float) -> "SimpleMoves":
        has_started = self.start_s <= time_s
        return SimpleMoves(
            self.start_s[has_started],
            self.distance_steps[has_started],
            self.speed_steps_s[has_started],
            self.acceleration_steps_s2[has_started],
            self.base_speed_steps_s[has_started],
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Trapezoids:
    """Moves as ramp, cruise and ramp, (m,) each; distances are positive."""

    base: FloatArray  # speed at both ends
    peak: FloatArray  # speed between the ramps
    acceleration: FloatArray
    ramp_s: FloatArray
    cruise_s: FloatArray
    distance: FloatArray

    @classmethod
    def of(cls, moves: SimpleMoves, change: LimitChange) -> Self:
        """Plan moves with changed limits."""
        distance, commanded = np.abs(moves.distance_steps), moves.speed_steps_s
        acceleration = moves.acceleration_steps_s2 * (1.0 + change[0])
        base = np.minimum(np.maximum(0.0, moves.base_speed_steps_s + change[1]), commanded)
        peak = np.minimum(commanded, np.sqrt(acceleration * distance + base**2))
        ramp_s = (peak - base) / acceleration
        cruise = np.maximum(distance - (peak**2 - base**2) / acceleration, 0.0)
        return cls(base, peak, acceleration, ramp_s, cruise / peak, distance)

    @property
    def duration_s(self) -> FloatArray:
        """Time from the start to rest."""
        return 2.0 * self.ramp_s + self.cruise_s

    def covered_steps(self, move: IntArray, elapsed_s: FloatArray) -> FloatArray:
        """Return the distance that moves (k,) have covered a time after their start."""
        ramp_s, cruise_s = self.ramp_s[move], self.cruise_s[move]
        up_s = np.minimum(elapsed_s, ramp_s)
        level_s = np.clip(elapsed_s - ramp_s, 0.0, cruise_s)
        down_s = np.maximum(elapsed_s - ramp_s - cruise_s, 0.0)
        half_acceleration = 0.5 * self.acceleration[move]
        covered = (self.base[move] + half_acceleration * up_s) * up_s
        covered += (level_s + down_s) * self.peak[move] - half_acceleration * down_s**2
        return np.where(elapsed_s >= self.duration_s[move], self.distance[move], covered)


@lru_cache(maxsize=8)
def simple_moves(profiles: AxisProfiles, axis: int) -> SimpleMoves:
    """Return the simple moves of an axis, cached; no row for the moves of the other axis."""
    rows = []
    for moved_axis, profile in profiles:
        if moved_axis != axis or not _is_simple(profile):
            continue
        limits = profile.commands[0].limits
        distance = float(profile.start_steps[-1] - profile.start_steps[0])
        if distance and limits.speed_steps_s > limits.base_speed_steps_s:
            limit_values = (limits.speed_steps_s, limits.acceleration_steps_s2)
            rows.append(
                (float(profile.start_s[0]), distance, *limit_values, limits.base_speed_steps_s)
            )
    return SimpleMoves(*np.array(rows, dtype=np.float64).reshape(-1, 5).T)


def compound_moves(profiles: AxisProfiles, axis: int) -> list[MotionProfile]:
    """Return the moves of an axis that received further commands during the move."""
    return [
        profile
        for moved_axis, profile in profiles
        if moved_axis == axis and profile.commands and not _is_simple(profile)
    ]


def compound_change(
    profile: MotionProfile, edges_s: FloatArray, change: LimitChange, previous: LimitChange
) -> tuple[slice, FloatArray]:
    """Return the edges of a compound move and the change of the position there by other limits.

    Args:
        profile: of the move.
        edges_s: increasing, shape (n + 1,).
        change: of the limits, in addition to `previous`.
        previous: change of the commanded limits with which the result is compared.
    """
    changed = replan_with_limits(profile, change[0] + previous[0], change[1] + previous[1])
    before = profile if previous == (0.0, 0.0) else replan_with_limits(profile, *previous)
    if changed is None or before is None:
        return slice(0), np.zeros(0)
    end_s = max(before.end_s, changed.end_s)
    edges = slice(*np.searchsorted(edges_s, (profile.start_s[0], end_s)))
    return edges, changed.position_steps(edges_s[edges]) - before.position_steps(edges_s[edges])


def _is_simple(profile: MotionProfile) -> bool:
    return len(profile.commands) == 1 and profile.commands[0].kind in ("to", "by")
