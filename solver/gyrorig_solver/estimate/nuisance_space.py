"""Space of signals that a fit can absorb, and the remainder of a signal outside of it.

Each unknown is within its prior. The remaining energy of a signal is the information that it adds;
its product with the residual is its score.

What to use when: `score_statistics` for information and score of whitened signals;
`held_out_residuals` for models that are fitted to some windows and tested on the others;
`NuisanceProjector` to whiten signals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from scipy.sparse import csc_array, csr_array

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate.channel_derivatives import ChannelDerivatives, SignalProducts
from gyrorig_solver.estimate.nuisance_basis import NuisancePrior
from gyrorig_solver.estimate.whitened_signals import WhitenedSignals
from gyrorig_solver.numerics.arrowhead import factorise_sparse

HELD_OUT_PRIOR_SHARE = 0.01  # of a cause's information: the weight of its prior on held-out data


@dataclass(frozen=True, slots=True, eq=False)
class ScoreStatistics:
    """Information and score of signals, orthogonal to the nuisance space."""

    information: FloatArray  # (k, k), orthogonal to the nuisance space
    score: FloatArray  # (k,), of the residual
    energy: FloatArray  # (k,), before the projection
    absorbed: FloatArray  # (k, q), bias of the board's parameters per unit of each signal

    def subset(self, positions: Sequence[int] | IntArray) -> "ScoreStatistics":
        """Return the statistics of a subset of the signals."""
        index = np.asarray(positions)
        if index.size == 1:
            single = slice(int(index[0]), int(index[0]) + 1)
            return ScoreStatistics(
                self.information[single, single],
                self.score[single],
                self.energy[single],
                self.absorbed[single],
            )
        return ScoreStatistics(
            self.information[np.ix_(index, index)],
            self.score[index],
            self.energy[index],
            self.absorbed[index],
        )


@dataclass(frozen=True, slots=True, eq=False)
class OtherData:
    """Information of data other than the samples on the sizes of k signals."""

    information: FloatArray  # (k, k)
    cross: FloatArray  # (q, k), with all unknowns of the fit except the local ones
    score: FloatArray  # (k,)


@dataclass(frozen=True, slots=True, eq=False)
class ReducedModel:
    """The model of a fit without some of its causes."""

    rows: IntArray  # the remaining unknowns, without the local ones
    residual: FloatArray  # (all,), whitened, with the effect of the removed causes


@dataclass(frozen=True, slots=True, eq=False)
class NormalBlocks:
    """The whitened derivatives and the priors of a projector's unknowns."""

    board_derivatives: FloatArray  # (board, all), by G, each (b, tau), causes
    board_prior_information: FloatArray  # (board, board), information
    board_prior_score: FloatArray  # (board,), score
    local_derivatives: csr_array  # (m, all), by the motion's local unknowns
    shared_derivatives: FloatArray  # (g, all), by its shared unknowns
    motion_prior_information: FloatArray  # (m + g, m + g), information
    motion_prior_offset: FloatArray  # (m + g,), prior mean minus current value


@dataclass(frozen=True, slots=True, eq=False)
class _SubsetProducts:
    """Products of a fit's derivatives over a subset of values, with each other and with residuals.

    The residuals are those of several models.
    """

    shared: FloatArray  # (q, q)
    cross: FloatArray  # (m, q)
    local: csr_array  # (m, m)
    shared_score: FloatArray  # (q, models)
    local_score: FloatArray  # (m, models)

    def __add__(self, other: "_SubsetProducts") -> "_SubsetProducts":
        """Return the products over both of two subsets that do not overlap."""
        return _SubsetProducts(
            self.shared + other.shared,
            self.cross + other.cross,
            self.local + other.local,
            self.shared_score + other.shared_score,
            self.local_score + other.local_score,
        )

    def __sub__(self, other: "_SubsetProducts") -> "_SubsetProducts":
        """Return the products over the rest of a subset."""
        return _SubsetProducts(
            self.shared - other.shared,
            self.cross - other.cross,
            self.local - other.local,
            self.shared_score - other.shared_score,
            self.local_score - other.local_score,
        )


class NuisanceSpace:
    """The projection orthogonal to the whitened derivatives of a fit; see the module."""

    def __init__(
        self,
        residual: FloatArray,
        channel_lengths: Sequence[int],
        basis: FloatArray,
        local: csr_array,
        prior: NuisancePrior,
    ) -> None:
        """Eliminate the unknowns.

        Args:
            residual: whitened, shape (all,).
            channel_lengths: of each channel.
            basis: whitened derivatives by all but local unknowns, (q, all).
            local: whitened derivatives by the local unknowns, (m, all).
            prior: of all unknowns.
        """
        self.residual, self.channel_lengths = residual, tuple(channel_lengths)
        self._basis, self._local, self._prior = basis, local, prior
        self._derivatives = ChannelDerivatives.split(
            basis, csc_array(local), self.residual, self.channel_lengths
        )
        products = self._derivatives.own_products()
        self._solve_local = factorise_sparse(csc_array((products.local + prior.local).tocsc()))
        self._cross = products.cross + prior.cross
        self._back_substitution = self._solve_local(self._cross)
        shared = products.shared + prior.shared
        shared_information = shared - self._cross.T @ self._back_substitution
        self._inverse = np.linalg.pinv(shared_information, hermitian=True)
        # An event in held-out data cannot be fitted to the other data; a prior keeps its value.
        self._held_out_prior = np.zeros(basis.shape[0])
        self._held_out_prior[prior.first_term : prior.board_parameters] = (
            HELD_OUT_PRIOR_SHARE
            * np.diag(shared_information)[prior.first_term : prior.board_parameters]
        )
        self._local_score = products.local_score + prior.local_score
        self._shared_score = products.shared_score + prior.shared_score
        self.board_parameters = prior.board_parameters

    def held_out_residuals(self, windows: IntArray, models: Sequence[ReducedModel]) -> FloatArray:
        """Return each model's whitened residual on held-out data, (models, all).

        Each window in turn is held out, and all unknowns are fitted to the other windows. In the
        held-out window, only the motion's local unknowns are fitted, because they are not part of
        the test.

        Args:
            windows: the window of each whitened value, shape (all,).
            models: from `drop_terms`.
        """
        residuals = np.zeros((len(models), self.residual.size))
        subsets = [np.flatnonzero(windows == window) for window in np.unique(windows)]
        products = [self._subset_products(subset, models) for subset in subsets]
        total = reduce(add, products)
        for inside, subset_products in zip(subsets, products, strict=True):
            step = self._fit_to_subset(total - subset_products, models)
            solve_local = factorise_sparse(csc_array(subset_products.local + self._prior.local))
            pull = (
                subset_products.local_score
                - (subset_products.cross + self._prior.cross) @ step
                + self._prior.local_score[:, None]
            )
            residuals[:, inside] = (
                np.stack([reduced_model.residual[inside] for reduced_model in models])
                - step.T @ self._basis[:, inside]
                - (self._local[:, inside].T @ solve_local(pull)).T
            )
        return residuals

    def _subset_products(
        self, subset: IntArray, models: Sequence[ReducedModel]
    ) -> "_SubsetProducts":
        """Return the products over a subset of the whitened values."""
        basis, local = self._basis[:, subset], self._local[:, subset]
        residuals = np.stack([reduced_model.residual[subset] for reduced_model in models], axis=1)
        return _SubsetProducts(
            basis @ basis.T, local @ basis.T, local @ local.T, basis @ residuals, local @ residuals
        )

    def _fit_to_subset(
        self, products: "_SubsetProducts", models: Sequence[ReducedModel]
    ) -> FloatArray:
        """Return the step of all but local unknowns that fits a subset best, (q, models)."""
        solve_local = factorise_sparse(csc_array(products.local + self._prior.local))
        cross = products.cross + self._prior.cross
        back_substitution = solve_local(cross)
        information = (
            products.shared
            + self._prior.shared
            - cross.T @ back_substitution
            + np.diag(self._held_out_prior)
        )
        pull = products.local_score + self._prior.local_score[:, None]
        score = products.shared_score + self._prior.shared_score[:, None]
        score -= back_substitution.T @ pull
        steps = np.zeros_like(score)
        for k, reduced_model in enumerate(models):
            inverse = np.linalg.pinv(
                information[np.ix_(reduced_model.rows, reduced_model.rows)], hermitian=True
            )
            steps[reduced_model.rows, k] = inverse @ score[reduced_model.rows, k]
        return steps

    def score_statistics(self, signals: WhitenedSignals) -> ScoreStatistics:
        """Return information and score of whitened signals."""
        return self._statistics(self._derivatives.multiply(signals))

    def sparse_statistics(self, signals: csr_array) -> ScoreStatistics:
        """Return information and score of whitened signals with few values, (k, all)."""
        return self._statistics(
            SignalProducts(
                gram=(signals @ signals.T).toarray(),
                shared=(signals @ self._basis.T).T,
                local=(self._local @ signals.T).toarray(),
                residual=signals @ self.residual,
            )
        )

    def dense_statistics(self, white: FloatArray, elsewhere: OtherData) -> ScoreStatistics:
        """Return information and score of whitened signals that other data measure too.

        Args:
            white: the signals, (k, all).
            elsewhere: information of the other data on the sizes of the signals.
        """
        return self._statistics(
            SignalProducts(
                gram=white @ white.T + elsewhere.information,
                shared=self._basis @ white.T + elsewhere.cross,
                local=self._local @ white.T,
                residual=white @ self.residual + elsewhere.score,
            )
        )

    def _statistics(self, products: SignalProducts) -> ScoreStatistics:
        """Return information and score of signals with these inner products."""
        shared_step = self._inverse @ (products.shared - self._back_substitution.T @ products.local)
        local_step = self._solve_local(products.local) - self._back_substitution @ shared_step
        return ScoreStatistics(
            products.gram - products.local.T @ local_step - products.shared.T @ shared_step,
            products.residual
            - local_step.T @ self._local_score
            - shared_step.T @ self._shared_score,
            np.diag(products.gram).copy(),
            shared_step[: self.board_parameters].T,
        )

    @property
    def shared_count(self) -> int:
        """The number of unknowns that are not local."""
        return len(self._basis)

    def motion_space(self) -> "NuisanceSpace":
        """Return the space of only the motion's unknowns, which belong to one recording."""
        board, prior = self.board_parameters, self._prior
        own_prior = replace(
            prior,
            cross=prior.cross[:, board:],
            shared=prior.shared[board:, board:],
            shared_score=prior.shared_score[board:],
            first_term=0,
            board_parameters=0,
        )
        return NuisanceSpace(
            self.residual, self.channel_lengths, self._basis[board:], self._local, own_prior
        )

    def normal_blocks(self) -> NormalBlocks:
        """Return the blocks from which the projector is computed."""
        board, prior = self.board_parameters, self._prior
        motion_cross = prior.cross[:, board:]
        return NormalBlocks(
            board_derivatives=self._basis[:board],
            board_prior_information=prior.shared[:board, :board],
            board_prior_score=prior.shared_score[:board],
            local_derivatives=self._local,
            shared_derivatives=self._basis[board:],
            motion_prior_information=np.block(
                [
                    [prior.local.toarray(), motion_cross],
                    [motion_cross.T, prior.shared[board:, board:]],
                ]
            ),
            motion_prior_offset=prior.motion_offset,
        )

    def orthogonal_component(self, white_signal: FloatArray) -> FloatArray:
        """Return the part of one whitened signal that the fit cannot absorb, (all,)."""
        local_products, basis_products = self._local @ white_signal, self._basis @ white_signal
        shared_step = self._inverse @ (basis_products - self._back_substitution.T @ local_products)
        local_step = self._solve_local(local_products) - self._back_substitution @ shared_step
        return np.asarray(
            white_signal - self._local.T @ local_step - self._basis.T @ shared_step, np.float64
        )
