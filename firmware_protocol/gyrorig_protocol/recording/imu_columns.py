"""A board's samples as compact columns: 30 bytes per sample instead of 95.

What to use when: `Recording.imu_columns` for the fields that a solver needs, `Recording.imu_field`
for one field. In the reader, `ImuColumnsChannel` keeps the samples of a channel as columns if
complete records would need too much memory.

Integers are kept as sent. A triple of counts has 16 bits if all of its counts fit, as they do for
most parts, otherwise 32 bits.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.recording.channel_arrays import array_dtype, split_valid_records
from gyrorig_protocol.recording.encoding.cdr_codec import NS_PER_S
from gyrorig_protocol.recording.encoding.message_layouts import PayloadLayout
from gyrorig_protocol.recording.mcap.chunk_reader import RECORD_BYTES, Offsets
from gyrorig_protocol.recording.mcap.record_cursor import Buffer

Counts = npt.NDArray[np.int16] | npt.NDArray[np.int32]
RecordArray = npt.NDArray[np.void]

_TRIPLE_FIELDS = ("gyro", "accel", "mag")
_DTYPES = {
    "host_time": np.int64,
    "device_time": np.int64,
    "sequence": np.uint32,
    "status": np.uint16,
    "temperature": np.int16,
}
SOLVER_FIELDS = (*_DTYPES, "gyro")
_BLOCK_ROWS = 2048  # per step; their records fit into the processor's cache


@dataclass(slots=True, eq=False)
class ImuColumns:
    """The fields that a solver needs of every sample, in the order of arrival.

    The caller owns the arrays and can overwrite them.
    """

    host_time_ns: npt.NDArray[np.int64]  # (n,)
    device_time: npt.NDArray[np.int64]  # (n,), ticks as sent
    sequence: npt.NDArray[np.uint32]  # (n,), as sent
    status: npt.NDArray[np.uint16]  # (n,), ImuStatus bits
    temperature: npt.NDArray[np.int16]  # (n,), raw
    gyro: Counts  # (n, 3)


class GrowingColumns:
    """Fields of a growing number of samples.

    Args:
        names: fields of ImuRaw.
        expected: the initial capacity in samples.
    """

    def __init__(self, names: tuple[str, ...], expected: int) -> None:
        self._names = names
        self._capacity = expected
        self._arrays: dict[str, npt.NDArray[Any]] = {
            name: np.empty((expected, 3), np.int16)
            if name in _TRIPLE_FIELDS
            else np.empty(expected, _DTYPES[name])
            for name in names
        }
        self.count = 0

    def append(self, records: RecordArray) -> None:
        """Append the fields of a structured array of records."""
        for begin in range(0, len(records), _BLOCK_ROWS):
            self._append_block(records[begin : begin + _BLOCK_ROWS])

    def column(self, name: str) -> npt.NDArray[Any]:
        """Return a field of all samples so far."""
        return self._arrays[name][: self.count]

    def to_imu_columns(self) -> ImuColumns:
        """Return all of `SOLVER_FIELDS`."""
        return ImuColumns(self.column("host_time"), *map(self.column, SOLVER_FIELDS[1:]))

    def _append_block(self, records: RecordArray) -> None:
        begin, end = self.count, self.count + len(records)
        if end > self._capacity:
            self._grow(max(end, 2 * self._capacity))
        for name in self._names:
            field = records[name]
            if name == "host_time":
                target = self._arrays[name][begin:end]
                np.multiply(field["sec"], NS_PER_S, out=target, dtype=np.int64)
                target += field["nanosec"]
            elif name in _TRIPLE_FIELDS:
                self._append_counts(name, field, begin, end)
            else:
                self._arrays[name][begin:end] = field
        self.count = end

    def _append_counts(self, name: str, field: npt.NDArray[np.int32], begin: int, end: int) -> None:
        target = self._arrays[name][begin:end]
        target[...] = field  # counts of more than 16 bits wrap; the comparison detects it
        if target.dtype == np.int16 and not np.array_equal(target, field):
            self._arrays[name] = self._arrays[name].astype(np.int32)
            self._arrays[name][begin:end] = field

    def _grow(self, capacity: int) -> None:
        for name, old_array in self._arrays.items():
            new_array = np.empty((capacity, *old_array.shape[1:]), old_array.dtype)
            new_array[: self.count] = old_array[: self.count]
            self._arrays[name] = new_array
        self._capacity = capacity


class ImuColumnsChannel:
    """The samples of one channel as columns, without their records."""

    def __init__(self, layout: PayloadLayout, expected: int, names: tuple[str, ...]) -> None:
        self._layout = layout
        self._dtype = array_dtype(layout)
        self._columns: GrowingColumns | None = GrowingColumns(names, expected)
        self.count = 0
        self.log_time_span_ns = (0, 0)  # least and largest
        self._sequence_span = (0, 0)  # least and largest message number of the writer

    def append(self, content: Buffer, offsets: Offsets) -> Offsets:
        """Append the records at `offsets`; return the offsets of invalid ones."""
        raw_records, invalid_offsets = split_valid_records(
            content, RECORD_BYTES + self._layout.size_bytes, offsets
        )
        records = raw_records.view(self._dtype)
        if len(records) and self._columns is not None:
            self._columns.append(records)
            is_first = self.count == 0
            self.log_time_span_ns = _widen_span(
                self.log_time_span_ns, records["log_time"], is_first
            )
            self._sequence_span = _widen_span(
                self._sequence_span, records["message_sequence"], is_first
            )
            self.count += len(records)
        return invalid_offsets

    @property
    def missing_count(self) -> int:
        """Number of messages that the writer counted and that are missing."""
        first, last = self._sequence_span
        return max(0, last - first + 1 - self.count) if self.count else 0

    def take_columns(self) -> GrowingColumns | None:
        """Return the columns once; None at later calls."""
        columns, self._columns = self._columns, None
        return columns


def _widen_span(span: tuple[int, int], values: npt.NDArray[Any], is_first: bool) -> tuple[int, int]:
    low, high = int(values.min()), int(values.max())
    return (low, high) if is_first else (min(span[0], low), max(span[1], high))
