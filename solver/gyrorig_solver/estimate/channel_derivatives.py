"""Products of whitened signals with a fit's derivatives, channel by channel.

Derivatives by local unknowns are zero outside a short interval. Each channel is cut into pieces. In
a piece, only a few local unknowns act, so that all products are products of small dense matrices,
and one pass over the signals gives all of them.

What to use when: `ChannelDerivatives.split` once per fit, `multiply` for signals.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_array

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate.whitened_signals import WhitenedSignals

PIECE_LENGTH = 512  # values; a piece of all rows fits into a cache


@dataclass(frozen=True, slots=True, eq=False)
class SignalProducts:
    """Inner products of k signals."""

    gram: FloatArray  # (k, k), with each other
    shared: FloatArray  # (q, k), with the derivatives by the shared unknowns
    local: FloatArray  # (m, k), with the derivatives by the local unknowns
    residual: FloatArray  # (k,), with the residual


@dataclass(frozen=True, slots=True, eq=False)
class OwnProducts:
    """Inner products of a fit's derivatives with each other and with the residual."""

    shared: FloatArray  # (q, q)
    cross: FloatArray  # (m, q)
    local: csc_array  # (m, m)
    shared_score: FloatArray  # (q,)
    local_score: FloatArray  # (m,)


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """All rows of one piece of a channel: residual, shared derivatives, local derivatives."""

    columns: slice  # of the channel
    rows: FloatArray  # (1 + s + l, n)
    local_index: IntArray  # (l,)


@dataclass(frozen=True, slots=True, eq=False)
class ChannelDerivatives:
    """A fit's derivatives and residual, cut into the pieces of each channel."""

    shared_count: int
    local_count: int
    channels: tuple[tuple[IntArray, tuple[_Piece, ...]], ...]  # active shared unknowns, pieces

    @classmethod
    def split(
        cls, shared: FloatArray, local: csc_array, residual: FloatArray, lengths: Sequence[int]
    ) -> "ChannelDerivatives":
        """Split a fit's rows.

        Args:
            shared: derivatives by the shared unknowns, (q, all).
            local: derivatives by the local unknowns, (m, all).
            residual: shape (all,).
            lengths: of each channel.
        """
        channels, first = [], 0
        for length in lengths:
            values = shared[:, first : first + length]
            index = np.flatnonzero([row.any() for row in values])
            dense = np.concatenate([residual[None, first : first + length], values[index]])
            channels.append((index, tuple(_pieces(dense, local, first))))
            first += length
        return cls(len(shared), local.shape[0], tuple(channels))

    def own_products(self) -> "OwnProducts":
        """Return the inner products of the derivatives with each other and with the residual."""
        products = OwnProducts(
            np.zeros((self.shared_count, self.shared_count)),
            np.zeros((self.local_count, self.shared_count)),
            csc_array((self.local_count, self.local_count)),
            np.zeros(self.shared_count),
            np.zeros(self.local_count),
        )
        entries = []
        for index, pieces in self.channels:
            gram = np.zeros((1 + index.size, 1 + index.size))
            cross = np.zeros((self.local_count, 1 + index.size))
            for piece in pieces:
                part = piece.rows @ piece.rows.T
                gram += part[: len(gram), : len(gram)]
                cross[piece.local_index] += part[len(gram) :, : len(gram)]
                count = piece.local_index.size
                entries.append(
                    (
                        part[len(gram) :, len(gram) :].ravel(),
                        np.repeat(piece.local_index, count),
                        np.tile(piece.local_index, count),
                    )
                )
            products.shared[np.ix_(index, index)] += gram[1:, 1:]
            products.shared_score[index] += gram[0, 1:]
            products.cross[:, index] += cross[:, 1:]
            products.local_score[...] += cross[:, 0]
        values, rows, columns = (np.concatenate([entry[k] for entry in entries]) for k in range(3))
        present = values != 0.0
        pairs = (rows[present], columns[present])
        local = csc_array((values[present], pairs), shape=(self.local_count, self.local_count))
        return replace(products, local=local)

    def multiply(self, signals: WhitenedSignals) -> SignalProducts:
        """Return the inner products of signals."""
        count = signals.count
        products = SignalProducts(
            np.zeros((count, count)),
            np.zeros((self.shared_count, count)),
            np.zeros((self.local_count, count)),
            np.zeros(count),
        )
        for channel, (shared_index, pieces) in zip(signals.channels, self.channels, strict=True):
            index = channel.signal_index
            if not index.size:
                continue
            dense = np.zeros((1 + shared_index.size, index.size))
            local = np.zeros((self.local_count, index.size))
            gram = np.zeros((index.size, index.size))
            for piece in pieces:
                signal = channel.values(piece.columns)
                part = piece.rows @ signal.T
                dense += part[: len(dense)]
                local[piece.local_index] += part[len(dense) :]
                gram += signal @ signal.T
            products.residual[index] += dense[0]
            products.shared[np.ix_(shared_index, index)] += dense[1:]
            products.local[:, index] += local
            products.gram[np.ix_(index, index)] += gram
        return products


def _pieces(dense: FloatArray, local: csc_array, first: int) -> Iterator[_Piece]:
    """Yield the pieces of one channel whose first column is `first`."""
    for begin in range(0, dense.shape[1], PIECE_LENGTH):
        columns = slice(begin, min(begin + PIECE_LENGTH, dense.shape[1]))
        pointer = local.indptr[first + columns.start : first + columns.stop + 1]
        entries = slice(pointer[0], pointer[-1])
        acting = np.zeros(local.shape[0], dtype=np.bool_)
        acting[local.indices[entries]] = True
        unknowns = np.flatnonzero(acting)
        row = np.cumsum(acting)[local.indices[entries]] - 1
        rows = np.zeros((len(dense) + unknowns.size, columns.stop - columns.start))
        rows[: len(dense)] = dense[:, columns]
        position = np.repeat(np.arange(rows.shape[1]), np.diff(pointer))
        rows[len(dense) + row, position] = local.data[entries]
        yield _Piece(columns, rows, np.asarray(unknowns, dtype=np.int64))
