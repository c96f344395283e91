"""Column packing: derivatives that are zero outside an interval share a few long signals.

A motion has thousands of unknowns that act for a short time each. Columns that are further apart
than the noise's memory share one row, a signal as long as the series. Filtering and whitening then
run once per row for all of its columns.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.reference.reference_motion import LocalDerivative


@dataclass(frozen=True, slots=True, eq=False)
class PackedColumns:
    """Derivatives by local unknowns, ordered by row and time."""

    values: FloatArray  # (rows, 3, n), stage rate per unknown, divided by its scale
    scale: FloatArray  # (c,), equalises columns of different size in one row
    unknown_index: IntArray  # (c,), of the reference
    row: IntArray  # (c,)
    first_interval: IntArray  # (c,), beginning of its interval in the row
    stop_interval: IntArray  # (c,), end of that interval

    @property
    def count(self) -> int:
        """The number of columns."""
        return int(self.unknown_index.size)

    def resample(
        self, values: FloatArray, intervals_per_interval: int, reach_intervals: int
    ) -> "PackedColumns":
        """Return the same columns on a coarser grid.

        Args:
            values: the rows on that grid, shape (rows, 3, n / intervals_per_interval).
            intervals_per_interval: intervals of this grid per interval of that grid.
            reach_intervals: number of those intervals by which each column extends beyond its ends.
        """
        n = values.shape[2]
        first = np.clip(self.first_interval // intervals_per_interval - reach_intervals, 0, n)
        stop = np.clip(-(-self.stop_interval // intervals_per_interval) + reach_intervals, 0, n)
        return PackedColumns(values, self.scale, self.unknown_index, self.row, first, stop)


def pack_columns(
    columns: Sequence[LocalDerivative], length: int, gap_intervals: int
) -> PackedColumns:
    """Pack columns into the fewest rows with `gap_intervals` between two columns of one row."""
    nonzero = [c for c in columns if c.values.shape[0] and c.values.any()]
    nonzero.sort(key=lambda column: column.first_interval)
    ends: list[int] = []
    row_of_column = []
    for column in nonzero:
        free_rows = [
            k for k, end in enumerate(ends) if end + gap_intervals <= column.first_interval
        ]
        # Use the row that ended first, so that neighbours stay far apart.
        row = min(free_rows, key=ends.__getitem__) if free_rows else len(ends)
        if row == len(ends):
            ends.append(0)
        ends[row] = column.first_interval + column.values.shape[0]
        row_of_column.append(row)
    scale = np.array([np.sqrt(np.sum(c.values**2)) for c in nonzero])
    values = np.zeros((len(ends), 3, length))
    for column, row, size in zip(nonzero, row_of_column, scale, strict=True):
        stop = column.first_interval + column.values.shape[0]
        values[row, :, column.first_interval : stop] = column.values.T / size
    order = np.argsort(row_of_column, kind="stable")
    nonzero = [nonzero[k] for k in order]
    first = np.array([c.first_interval for c in nonzero], dtype=np.int64)
    return PackedColumns(
        values,
        scale[order],
        np.array([c.unknown for c in nonzero], dtype=np.int64),
        np.array(row_of_column, dtype=np.int64)[order],
        first,
        first + np.array([c.values.shape[0] for c in nonzero], dtype=np.int64),
    )


def column_products(
    packed: PackedColumns, whitened: FloatArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the inner products of all pairs of columns whose intervals overlap.

    Each column is an interval of its whitened row and zero elsewhere. The truncated matrix is
    therefore still a matrix of inner products, and positive semidefinite.

    Args:
        packed: the columns.
        whitened: the sensor signals of the rows, whitened, (3, rows, n).

    Returns:
        Unknown, unknown and product, in both orders of each pair; distant pairs are left out.
    """
    rows, columns, values = [], [], []
    columns_of_row = [
        np.flatnonzero(packed.row == row_a) for row_a in range(packed.values.shape[0])
    ]
    for row_a, indices_a in enumerate(columns_of_row):
        for row_b in range(row_a, len(columns_of_row)):
            indices_b = columns_of_row[row_b]
            low = np.searchsorted(
                packed.stop_interval[indices_a], packed.first_interval[indices_b], side="right"
            )
            high = np.searchsorted(
                packed.first_interval[indices_a], packed.stop_interval[indices_b], side="left"
            )
            if row_a == row_b:
                low, high = np.arange(indices_a.size), np.arange(indices_a.size) + 1
            count = np.maximum(high - low, 0)
            if not count.any():
                continue
            index_b = np.repeat(np.arange(indices_b.size), count)
            index_a = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
            column_a, column_b = indices_a[index_a + np.repeat(low, count)], indices_b[index_b]
            cumulative = np.zeros(whitened.shape[2] + 1)
            np.cumsum(
                np.einsum("in,in->n", whitened[:, row_a], whitened[:, row_b]), out=cumulative[1:]
            )
            overlap_begin = np.maximum(
                packed.first_interval[column_a], packed.first_interval[column_b]
            )
            overlap_end = np.minimum(packed.stop_interval[column_a], packed.stop_interval[column_b])
            value = (
                (cumulative[overlap_end] - cumulative[overlap_begin])
                * packed.scale[column_a]
                * packed.scale[column_b]
            )
            column_a, column_b = packed.unknown_index[column_a], packed.unknown_index[column_b]
            rows += [column_a] if row_a == row_b else [column_a, column_b]
            columns += [column_b] if row_a == row_b else [column_b, column_a]
            values += [value] if row_a == row_b else [value, value]
    if not rows:
        empty = np.zeros(0, dtype=np.int64)
        return empty, empty, np.zeros(0)
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)
