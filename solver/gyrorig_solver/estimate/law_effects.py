"""Effects of the values of the motion law, for score tests under the law of a candidate.

A change of the law changes the samples directly and through the moves, which follow the replies
under the changed law. The replies have information about the law too. A score test of a cause that
changes the law needs all three, because the effect looks different under the moves of another law.

A higher base speed b mainly shortens the moves, which earlier starts absorb; the remaining effect
grows as b^2. The effect of a rounded corner grows as the square of its length. Neither has a
derivative at zero, so derivatives are computed at small values instead.

What to use when: `LawEffects.of` at a fit; `NuisanceProjector.law_statistics` for the statistics.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.reference_prediction import predict_derivatives
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.estimate.series_segment import SeriesSegment
from gyrorig_solver.model import DEG
from gyrorig_solver.reference import (
    LAW_QUANTITIES,
    LAW_VALUES,
    LawProfile,
    MotionLaw,
    PanTiltReference,
    ReferenceMotion,
    RestReference,
)

# The smallest values at which derivatives are computed; their effects are far below the noise.
PROBED_BASE_SPEED_RAD_S = 0.15 * DEG
PROBED_CORNER_S = 5e-3


@dataclass(frozen=True, slots=True, eq=False)
class LawScale:
    """Conversion between changes of k values of a law and their first-order changes."""

    origin: FloatArray  # (k,), values of the fit, including the setting
    probed: FloatArray  # (k,), values at which the derivatives are computed
    is_square: tuple[bool, ...]  # whether the effect grows as the square of the value

    @classmethod
    def of(cls, references: Sequence[PanTiltReference]) -> Self:
        """Return the scale of all values of a law, in the order of `MotionLaw.of_values`.

        Args:
            references: of the recordings of one unit under one law, at least one. The base speed of
                an axis is that of the first recording in which the axis moves.
        """
        law = references[0].law
        base_rad_s = np.array([_base_speed_rad_s(references, axis) for axis in (0, 1)])
        origin = np.concatenate([law.acceleration_share, base_rad_s, law.corner_s])
        least = [0.0, 0.0, *[PROBED_BASE_SPEED_RAD_S] * 2, *[PROBED_CORNER_S] * 2]
        is_square = np.repeat([quantity != "acceleration" for quantity in LAW_QUANTITIES], 2)
        probed = np.where(is_square, np.maximum(origin, least), origin)
        return cls(origin, probed, tuple(is_square.tolist()))

    def subset(self, values: IntArray) -> Self:
        """Return the scale of some values; `values`: their positions, shape (k,)."""
        is_square = tuple(self.is_square[k] for k in values)
        return replace(
            self, origin=self.origin[values], probed=self.probed[values], is_square=is_square
        )

    def changes(self, first_order: FloatArray) -> FloatArray:
        """Return the changes that have the same effect as these first-order changes, (k,)."""
        squares = np.maximum(self.origin**2 + 2.0 * self.probed * first_order, 0.0)
        return np.where(self.is_square, np.sqrt(squares) - self.origin, first_order)

    @property
    def probed_effect(self) -> FloatArray:
        """The effect of the probed law, relative to that of the fit, as first-order changes."""
        added = (self.probed**2 - self.origin**2) / (
            2.0 * np.where(self.is_square, self.probed, 1.0)
        )
        return np.where(self.is_square, added, 0.0)

    def effect_shares(self, values: FloatArray) -> FloatArray:
        """Return the effect of values of the fit, in units of their derivative times the value.

        `values`: differences between the law and the setting, (k,).
        """
        squares = (self.origin - 0.5 * values) / np.where(self.origin > 0.0, self.origin, 1.0)
        return np.where(self.is_square, squares, 1.0)

    def probe(self, reference: PanTiltReference) -> PanTiltReference:
        """Return a reference under the probed law; this scale must have all values of the law."""
        added = self.probed - self.origin
        law = reference.law
        base = np.array(law.base_speed_steps_s) + added[2:4] / np.abs(reference.rad_per_step)
        corner = np.array(law.corner_s) + added[4:]
        return reference.with_law(
            MotionLaw(
                law.acceleration_share,
                (float(base[0]), float(base[1])),
                (float(corner[0]), float(corner[1])),
                law.has_known_acceleration,
            )
        )


@dataclass(frozen=True, slots=True, eq=False)
class LawEffects:
    """The effects of the values of the law, in the order of `MotionLaw.of_values`."""

    direct: tuple[tuple[FloatArray, ...], ...]  # (6, n, 3) of each part of each segment
    profiles: tuple[LawProfile, ...]  # of all values, one per recording
    scale: LawScale  # of all recordings

    @classmethod
    def of(cls, solution: ConvergedFit, segments: Sequence[SeriesSegment]) -> Self | None:
        """Return the effects at a fit; None without a unit, see `unit_references`.

        Args:
            solution: the fit.
            segments: its series, in order.
        """
        references = unit_references(solution)
        if not references:
            return None
        probed = {k: LawScale.of([each]).probe(each) for k, each in references.items()}
        sessions = solution.sessions
        all_series = [each for session in sessions for each in session.series]
        direct = []
        for segment, each in zip(segments, all_series, strict=True):
            k = segment.session_index
            direct.append(
                _direct_effects(segment, each, probed[k], sessions[k].lag_s, solution.gain)
                if k in probed
                else tuple(np.zeros((LAW_VALUES, used.size, 3)) for used in segment.used)
            )
        profiles = [
            probed[k].law_profile(np.arange(LAW_VALUES))
            if k in probed
            else _profile_without_replies(session.reference)
            for k, session in enumerate(sessions)
        ]
        return cls(tuple(direct), tuple(profiles), LawScale.of(list(references.values())))

    def reply_information(self) -> FloatArray:
        """Return the information of all replies about the values, (6, 6)."""
        return np.asarray(np.sum([p.information for p in self.profiles], axis=0), np.float64)

    def reply_score(self) -> FloatArray:
        """Return the score of the values from all replies, (6,), at the law of the fit.

        The profiles belong to the probed law, so their residuals contain the effect of the
        difference between the two laws.
        """
        score = np.sum([profile.score for profile in self.profiles], axis=0)
        return np.asarray(score + self.reply_information() @ self.scale.probed_effect, np.float64)


def _base_speed_rad_s(references: Sequence[PanTiltReference], axis: int) -> float:
    """Return the base speed of an axis under the law of its first recording with moves, rad/s."""
    reference = next((each for each in references if _moves(axis, each).any()), references[0])
    moves = _moves(axis, reference)
    base_steps_s = reference.move_fit.table.base_speed_steps_s[moves]
    steps_s = float(np.mean(base_steps_s)) if moves.any() else 0.0
    steps_s += reference.law.base_speed_steps_s[axis]
    return steps_s * abs(reference.rad_per_step[axis])


def _moves(axis: int, reference: PanTiltReference) -> BoolArray:
    return np.asarray(reference.move_fit.table.axis == axis)


def unit_references(solution: ConvergedFit) -> dict[int, PanTiltReference]:
    """Return the references of the recordings of a unit, by the index of the recording.

    A rest without a unit shows nothing of the law, and is left out. With another motion without a
    unit there are none.
    """
    references = [session.reference for session in solution.sessions]
    if not all(isinstance(each, PanTiltReference | RestReference) for each in references):
        return {}
    return {k: each for k, each in enumerate(references) if isinstance(each, PanTiltReference)}


def _direct_effects(
    segment: SeriesSegment,
    series: Series,
    reference: PanTiltReference,
    lag_s: float,
    gain: FloatArray,
) -> tuple[FloatArray, ...]:
    """Return the effects of the values on the samples of each part, (6, n, 3) each."""
    parts = []
    for blocks, model in zip(series.part_slices(), segment.models, strict=True):
        law = predict_derivatives(series, blocks, reference.executed, lag_s).law
        passing = model.pass_through
        share = None if passing is None else passing.at_stage("profile")
        signals = (gain @ law).transpose(0, 2, 1)
        parts.append(signals if share is None else signals * share)
    return tuple(parts)


def _profile_without_replies(reference: ReferenceMotion) -> LawProfile:
    local_count, shared_count = reference.information.size
    return LawProfile(
        np.zeros((local_count + shared_count, LAW_VALUES)),
        np.zeros((LAW_VALUES, LAW_VALUES)),
        np.zeros(LAW_VALUES),
        local_count,
    )
