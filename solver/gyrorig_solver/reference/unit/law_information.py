"""Information of the polled counts about the values of a motion law.

What to use when: `LawInformation.of` for normal equations whose last unknowns are the law's values;
`LawProfile.of` to eliminate the moves.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.numerics import ArrowheadMatrix, solve_arrowhead
from gyrorig_solver.reference.unit.motion_law import LAW_VALUES
from gyrorig_solver.reference.unit.move_equations import BandedNormalEquations


@dataclass(frozen=True, slots=True, eq=False)
class LawInformation:
    """Information of the counts about the values of a motion law, and the score of these values."""

    cross: FloatArray  # (n + g, k), with the unknowns of the moves
    law_block: FloatArray  # (k, k)
    score: FloatArray  # (k,)

    @classmethod
    def of(cls, equations: BandedNormalEquations) -> Self:
        """Return the part of the last six shared unknowns of a system."""
        first = equations.shared.shape[0] - LAW_VALUES
        local = equations.cross[equations.band_position, first:]
        return cls(
            np.vstack([local, equations.shared[:first, first:]]),
            equations.shared[first:, first:].copy(),
            equations.score[-LAW_VALUES:].copy(),
        )

    def after_step(self, step: FloatArray) -> Self:
        """Return the information at unknowns changed by `step`, shape (n + g,)."""
        return replace(self, score=self.score - self.cross.T @ step)

    def with_stage_rests(self, starts: int, rests: int) -> Self:
        """Return the information over starts, rests of stage and of count, and shared unknowns.

        The counts do not depend on the rests of the stage.
        """
        return replace(self, cross=np.insert(self.cross, [starts] * rests, 0.0, axis=0))

    def subset(self, values: IntArray) -> Self:
        """Return the information about values of the law; `values`: their positions, shape (k,)."""
        law_block = self.law_block[np.ix_(values, values)]
        return replace(
            self, cross=self.cross[:, values], law_block=law_block, score=self.score[values]
        )

    def scaled(self, scale: FloatArray) -> Self:
        """Return the information in other units; `scale`: derivatives of the values, shape (6,)."""
        return replace(
            self,
            cross=self.cross * scale,
            law_block=self.law_block * np.outer(scale, scale),
            score=self.score * scale,
        )


@dataclass(frozen=True, slots=True, eq=False)
class LawProfile:
    """Information of the counts about k values of a law if the moves follow the counts.

    With other values of the law, the counts give other moves. The unknowns of the moves are
    relative to these moves, so that the counts do not couple them to the law.
    """

    shift: FloatArray  # (n + g, k), derivative of the fitted moves by the values
    information: FloatArray  # (k, k), the moves eliminated
    score: FloatArray  # (k,)
    local_count: int  # n

    @classmethod
    def of(cls, law: LawInformation, moves: ArrowheadMatrix) -> Self:
        """Eliminate the moves."""
        columns = [solve_arrowhead(moves, column) for column in law.cross.T]
        shift = -np.stack(columns, axis=1)
        information = law.law_block + law.cross.T @ shift
        return cls(shift, (information + information.T) / 2.0, law.score, moves.size[0])
