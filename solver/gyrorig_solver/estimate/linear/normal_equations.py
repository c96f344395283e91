"""Whitened normal equations of one series, without a dense Jacobian.

Model of axis i: y_i = G_i . omega(t - tau) + b_i + terms + noise. The unknowns are G (9, row by
row), b (3), tau, the terms' values and the reference's shared unknowns. In addition, the reference
has local unknowns (one start per move), which are the sparse part of an `ArrowheadMatrix`. A long
series is transformed in parts, and then the constants of the parts are transformed. This too is an
orthonormal transform, and its coefficients have the densities of the whole series at the same
frequencies.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import idct
from scipy.linalg import block_diag
from scipy.sparse import coo_array, csc_array

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate.linear.packed_columns import column_products
from gyrorig_solver.estimate.linear.whitening import WhitenedPart
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, dct_frequencies_hz
from gyrorig_solver.estimate.noise.relative_std import (
    MAX_LOG_WEIGHT_CHANGE,
    RelativeStd,
    mean_white_power,
    orthonormal_dct,
)
from gyrorig_solver.numerics import ArrowheadMatrix


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Information and score over (local | G, b, tau, terms, shared)."""

    matrix: ArrowheadMatrix
    score: FloatArray  # local unknowns first

    def __add__(self, other: "NormalEquations") -> "NormalEquations":
        """Add the information of another series."""
        return NormalEquations(self.matrix + other.matrix, self.score + other.score)


class NormalEquationsSum:
    """The normal equations of one series, summed over its parts."""

    def __init__(self, noise: NoiseModel, local_count: int, parameter_count: int) -> None:
        """Start from zero.

        Args:
            noise: density of the residual.
            local_count: number of local unknowns of the reference.
            parameter_count: number of other parameters.
        """
        self._noise, self._local_count = noise, local_count
        self._information, self._score = (
            np.zeros((parameter_count, parameter_count)),
            np.zeros(parameter_count),
        )
        self._cross, self._local_score = (
            np.zeros((local_count, parameter_count)),
            np.zeros(local_count),
        )
        self._local_products: list[tuple[IntArray, IntArray, FloatArray]] = []
        self._constants: list[FloatArray] = []
        self._relative_stds: list[RelativeStd | None] = []
        self._indices: list[IntArray] = []
        self._blocks = 0

    def add(self, part: WhitenedPart, residual: FloatArray, is_whole_series: bool) -> None:
        """Add a part with its residual, shape (n, 3), zero where unused.

        `is_whole_series`: the series has one part; otherwise the constants of all parts are added
        later.
        """
        self._blocks += residual.shape[0]
        self._indices = [part.parameter_index(axis) for axis in range(3)]
        white_residual = part.whiten(residual)
        if part.packed.count:
            self._cross[part.packed.unknown_index] += _cross_products(part, self._score.size)
            self._local_score[part.packed.unknown_index] += part.local_score(white_residual)
            self._local_products.append(column_products(part.packed, part.packed_signals))
        first = 0
        if not is_whole_series:
            constants = np.concatenate([part.columns[:, :, 0], white_residual[:, :1]], axis=1)
            self._constants.append(constants * part.std[0][:, None])
            self._relative_stds.append(part.relative_std)
            first = 1
        for axis in range(3):
            columns = part.columns[axis, :, first:]
            self._accumulate(axis, columns @ columns.T, columns @ white_residual[axis, first:])

    def total(self) -> NormalEquations:
        """Return the sum, with the constants of the parts weighted together."""
        if self._constants:
            self._add_part_constants()
        rows, columns, values = (
            np.concatenate(
                [products[k] for products in self._local_products] or [np.zeros(0, dtype)]
            )
            for k, dtype in enumerate((np.int64, np.int64, np.float64))
        )
        shape = (self._local_count, self._local_count)
        local_information = csc_array(coo_array((values, (rows, columns)), shape=shape))
        matrix = ArrowheadMatrix(local_information, self._cross, self._information)
        return NormalEquations(matrix, np.concatenate([self._local_score, self._score]))

    def _accumulate(self, axis: int, information: FloatArray, score: FloatArray) -> None:
        index = self._indices[axis]
        self._information[np.ix_(index, index)] += information
        self._score[index] += score

    def _add_part_constants(self) -> None:
        """Add the constants of the parts: the lowest frequencies of the whole series."""
        constants = np.stack(self._constants, axis=-1)  # (3, columns + residual, parts)
        count = constants.shape[-1]
        f = dct_frequencies_hz(self._blocks, self._noise.sampling.rate_hz)[:count]
        density = self._noise.density_with(f, mean_white_power(self._relative_stds))
        variance = density * self._noise.sampling.rate_hz / 2.0
        spectra = orthonormal_dct(constants)
        for axis in range(3):
            columns, residual_spectrum = spectra[axis, :-1], spectra[axis, -1]
            weighted = columns / variance[:, axis]
            self._accumulate(axis, weighted @ columns.T, weighted @ residual_spectrum)


@dataclass(frozen=True, slots=True, eq=False)
class CachedNormalEquations:
    """A recording's normal equations, for later iterations with small changes."""

    part: WhitenedPart
    normal: NormalEquations
    noise: NoiseModel

    def is_valid_for(self, noise: NoiseModel, relative_std: RelativeStd | None) -> bool:
        """Return whether another noise gives the same weights within a few percent."""
        if relative_std is not self.part.relative_std:
            return False
        n = self.part.std.shape[0]
        ratio = noise.dct_variance(n)[1:] / self.part.std[1:] ** 2
        return bool(np.all(np.abs(np.log(ratio)) < MAX_LOG_WEIGHT_CHANGE))

    def at_residual(self, residual: FloatArray, local_count: int) -> NormalEquations:
        """Return the equations for another residual, shape (n, 3)."""
        return NormalEquations(
            self.normal.matrix, _score_of_residual(self.part, residual, local_count)
        )


def _score_of_residual(part: WhitenedPart, residual: FloatArray, local_count: int) -> FloatArray:
    """Return a series' score for another residual, local unknowns first.

    Args:
        part: the whole series, already whitened.
        residual: shape (n, 3).
        local_count: number of local unknowns of the reference.
    """
    white_residual = part.whiten(residual)
    score = np.zeros(local_count + part.size)
    score[part.packed.unknown_index] = part.local_score(white_residual)
    for axis in range(3):
        score[local_count + part.parameter_index(axis)] += part.columns[axis] @ white_residual[axis]
    return score


def _cross_products(part: WhitenedPart, size: int) -> FloatArray:
    """Return the products of each local column with all other columns, (c, size)."""
    packed = part.packed
    result = np.zeros((packed.count, size))
    intervals = list(
        zip(
            packed.row.tolist(),
            packed.first_interval.tolist(),
            packed.stop_interval.tolist(),
            strict=True,
        )
    )
    for axis in range(3):
        signals = np.ascontiguousarray(idct(part.columns[axis], axis=-1, norm="ortho").T)
        whitened = part.packed_signals[axis]
        products = np.array([whitened[row, a:b] @ signals[a:b] for row, a, b in intervals])
        result[:, part.parameter_index(axis)] += products
    return result * packed.scale[:, None]


def stack_boards(
    boards: Sequence[NormalEquations], parameter_counts: Sequence[int]
) -> NormalEquations:
    """Return one recording's equations over (local | each board's parameters, the unit's shared).

    Args:
        boards: of each, over (local | the board's, shared), of the same local and shared unknowns.
        parameter_counts: number of each board's parameters.
    """
    if len(boards) == 1:
        return boards[0]
    local = boards[0].matrix.size[0]
    boards_and_counts = list(zip(boards, parameter_counts, strict=True))
    local_information = boards[0].matrix.local
    for other in boards[1:]:
        local_information = (local_information + other.matrix.local).tocsc()
    board_information = block_diag(
        *(equations.matrix.shared[:count, :count] for equations, count in boards_and_counts)
    )
    shared = np.sum(
        [equations.matrix.shared[count:, count:] for equations, count in boards_and_counts], axis=0
    )
    border = np.vstack(
        [equations.matrix.shared[:count, count:] for equations, count in boards_and_counts]
    )
    cross = [equations.matrix.cross[:, :count] for equations, count in boards_and_counts]
    shared_cross = np.sum(
        [equations.matrix.cross[:, count:] for equations, count in boards_and_counts], axis=0
    )
    matrix = ArrowheadMatrix(
        local_information,
        np.hstack([*cross, shared_cross]),
        np.block([[board_information, border], [border.T, shared]]),
    )
    board_scores = [
        equations.score[local : local + count] for equations, count in boards_and_counts
    ]
    shared_score = np.sum(
        [equations.score[local + count :] for equations, count in boards_and_counts], axis=0
    )
    local_score = np.sum([equations.score[:local] for equations in boards], axis=0)
    return NormalEquations(matrix, np.concatenate([local_score, *board_scores, shared_score]))
