"""A board's samples as compact columns, for solving: 30 bytes a sample instead of 95.

What to use when: `Recording.imu_columns` for what a solver needs of every sample, and
`Recording.imu_field` for one field of them. Under the reader, `ColumnsChannel`
keeps a channel of samples as columns where whole records would take too much memory.

Whole numbers stay as they were sent. A triple of counts has 16 bits where all of its
counts fit them, which is so for the usual parts, and 32 where they do not.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.recording.arrays import array_dtype, sound_records
from gyrorig_protocol.recording.cdr import Layout
from gyrorig_protocol.recording.cdr_stream import NS_PER_S
from gyrorig_protocol.recording.chunks import RECORD_BYTES, Offsets
from gyrorig_protocol.recording.fields import Buffer

Counts = npt.NDArray[np.int16] | npt.NDArray[np.int32]
RecordArray = npt.NDArray[np.void]

_TRIPLES = ("gyro", "accel", "mag")
_DTYPES = {
    "host_time": np.int64,
    "device_time": np.int64,
    "sequence": np.uint32,
    "status": np.uint16,
    "temperature": np.int16,
}
FOR_SOLVING = (*_DTYPES, "gyro")
_ROWS = 2048  # cut at a time: their records stay in the processor's cache


@dataclass(slots=True, eq=False)
class ImuColumns:
    """What a solver needs of every sample, in the order of arrival.

    The arrays belong to whoever asked for them, who may write over them.
    """

    host_time_ns: npt.NDArray[np.int64]  # (n,)
    device_time: npt.NDArray[np.int64]  # (n,), ticks as sent
    sequence: npt.NDArray[np.uint32]  # (n,), as sent
    status: npt.NDArray[np.uint16]  # (n,), ImuStatus bits
    temperature: npt.NDArray[np.int16]  # (n,), raw
    gyro: Counts  # (n, 3)


class Columns:
    """Some fields of a growing number of samples.

    Args:
        names: fields of ImuRaw.
        expected: room for so many samples at first.
    """

    def __init__(self, names: tuple[str, ...], expected: int) -> None:
        self._names = names
        self._room = expected
        self._arrays: dict[str, npt.NDArray[Any]] = {
            name: np.empty((expected, 3), np.int16)
            if name in _TRIPLES
            else np.empty(expected, _DTYPES[name])
            for name in names
        }
        self.count = 0

    def append(self, records: RecordArray) -> None:
        """Take over the fields of records, an array with the fields' names."""
        for begin in range(0, len(records), _ROWS):
            self._append(records[begin : begin + _ROWS])

    def array(self, name: str) -> npt.NDArray[Any]:
        """A field of all samples so far."""
        return self._arrays[name][: self.count]

    def imu(self) -> ImuColumns:
        """All of `FOR_SOLVING`."""
        return ImuColumns(self.array("host_time"), *map(self.array, FOR_SOLVING[1:]))

    def _append(self, records: RecordArray) -> None:
        begin, end = self.count, self.count + len(records)
        if end > self._room:
            self._grow(max(end, 2 * self._room))
        for name in self._names:
            field = records[name]
            if name == "host_time":
                into = self._arrays[name][begin:end]
                np.multiply(field["sec"], NS_PER_S, out=into, dtype=np.int64)
                into += field["nanosec"]
            elif name in _TRIPLES:
                self._append_counts(name, field, begin, end)
            else:
                self._arrays[name][begin:end] = field
        self.count = end

    def _append_counts(self, name: str, field: npt.NDArray[np.int32], begin: int, end: int) -> None:
        into = self._arrays[name][begin:end]
        into[...] = field  # beyond 16 bits this wraps, and the comparison shows it
        if into.dtype == np.int16 and not np.array_equal(into, field):
            self._arrays[name] = self._arrays[name].astype(np.int32)
            self._arrays[name][begin:end] = field

    def _grow(self, room: int) -> None:
        for name, old in self._arrays.items():
            grown = np.empty((room, *old.shape[1:]), old.dtype)
            grown[: self.count] = old[: self.count]
            self._arrays[name] = grown
        self._room = room


class ColumnsChannel:
    """The samples of one channel as columns; their records are not kept."""

    def __init__(self, layout: Layout, expected: int, names: tuple[str, ...]) -> None:
        self._layout = layout
        self._dtype = array_dtype(layout)
        self._columns: Columns | None = Columns(names, expected)
        self.count = 0
        self.log_times_ns = (0, 0)  # least and largest
        self._numbers = (0, 0)  # least and largest of the writer's own count

    def append(self, content: Buffer, offsets: Offsets) -> Offsets:
        """Take over the records at `offsets`; returns those of no such message."""
        raw, wrong = sound_records(content, RECORD_BYTES + self._layout.size, offsets)
        records = raw.view(self._dtype)
        if len(records) and self._columns is not None:
            self._columns.append(records)
            fresh = self.count == 0
            self.log_times_ns = _widened(self.log_times_ns, records["log_time"], fresh)
            self._numbers = _widened(self._numbers, records["message_sequence"], fresh)
            self.count += len(records)
        return wrong

    @property
    def dropped(self) -> int:
        """How many messages the writer counted that are not here."""
        first, last = self._numbers
        return max(0, last - first + 1 - self.count) if self.count else 0

    def take(self) -> Columns | None:
        """Give the columns away; None when they have been."""
        columns, self._columns = self._columns, None
        return columns


def _widened(span: tuple[int, int], values: npt.NDArray[Any], fresh: bool) -> tuple[int, int]:
    low, high = int(values.min()), int(values.max())
    return (low, high) if fresh else (min(span[0], low), max(span[1], high))
