"""Stores for the messages of one channel.

What to use when: only in the reader. `FixedSizeChannel` for messages of one size: the records of
each chunk are copied into one buffer without a loop, and the fields are views of it.
`VariableSizeChannel` for other messages, which have a low rate: payloads are kept one by one.
Samples that are too many for records are kept in `imu_columns`.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.recording.encoding.cdr_codec import ENCAPSULATION
from gyrorig_protocol.recording.encoding.message_layouts import HEADER_BYTES, PayloadLayout
from gyrorig_protocol.recording.mcap.chunk_reader import RECORD_BYTES, Offsets, gather_records
from gyrorig_protocol.recording.mcap.record_cursor import Buffer

_FRAME_BYTES = 9
_ENCAPSULATION = int.from_bytes(ENCAPSULATION, "little")

_RECORD_HEAD_DTYPE = np.dtype(
    {
        "names": ["length", "sequence", "log_time", "publish_time"],
        "formats": ["<u8", "<u4", "<i8", "<i8"],
        "offsets": [1, 11, 15, 23],
        "itemsize": RECORD_BYTES,
    }
)


def array_dtype(layout: PayloadLayout) -> np.dtype[np.void]:
    """Return the dtype of a record: log_time, publish_time, message_sequence, the payload."""
    names = ["log_time", "publish_time", "message_sequence"]
    formats: list[object] = ["<i8", "<i8", "<u4"]
    offsets = [15, 23, 11]
    for name in layout.dtype.names or ():
        dtype, offset = layout.dtype.fields[name][:2]  # type: ignore[index]
        names.append(f"payload.{name}" if name in names else name)
        formats.append(dtype)
        offsets.append(RECORD_BYTES + HEADER_BYTES + offset)
    itemsize = RECORD_BYTES + layout.size_bytes
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": itemsize})


def split_valid_records(
    content: Buffer, record_bytes: int, offsets: Offsets
) -> tuple[npt.NDArray[np.void], Offsets]:
    """Return the valid records at `offsets`, and the offsets of the invalid ones."""
    invalid_offsets = offsets[:0]
    last_offset = int(offsets.max(initial=0))
    if len(offsets) and max(last_offset, (len(offsets) - 1) * record_bytes) + record_bytes > len(
        content
    ):
        # Some messages are shorter; read with the expected size they would overlap.
        lengths = gather_records(content, RECORD_BYTES, offsets).view(_RECORD_HEAD_DTYPE)["length"]
        is_record = lengths == record_bytes - _FRAME_BYTES
        invalid_offsets, offsets = offsets[~is_record], offsets[is_record]
    records = gather_records(content, record_bytes, offsets)
    is_invalid = _invalid_mask(records, record_bytes)
    if not is_invalid.any():
        return records, invalid_offsets
    return records[~is_invalid], np.concatenate([invalid_offsets, offsets[is_invalid]])


def _invalid_mask(records: npt.NDArray[np.void], record_bytes: int) -> npt.NDArray[np.bool_]:
    """Return a mask of the records with the wrong length or a wrong payload header."""
    heads = records.view(_check_dtype(record_bytes))
    is_invalid: npt.NDArray[np.bool_] = heads["length"] != record_bytes - _FRAME_BYTES
    is_invalid |= heads["encapsulation"] != _ENCAPSULATION
    return is_invalid


@lru_cache(maxsize=64)
def _check_dtype(record_bytes: int) -> np.dtype[np.void]:
    return np.dtype(
        {
            "names": ["length", "encapsulation"],
            "formats": ["<u8", "<u4"],
            "offsets": [1, RECORD_BYTES],
            "itemsize": record_bytes,
        }
    )


class FixedSizeChannel:
    """The records of one channel whose messages have one size."""

    def __init__(self, layout: PayloadLayout, expected: int) -> None:
        self._record_bytes = RECORD_BYTES + layout.size_bytes
        self._raw_dtype = np.dtype((np.void, self._record_bytes))
        self._dtype = array_dtype(layout)
        self._records: npt.NDArray[np.void] = np.empty(expected, self._raw_dtype)
        self.count = 0

    def append(self, content: Buffer, offsets: Offsets) -> Offsets:
        """Append the records at `offsets`; return the offsets of invalid ones."""
        record_count = len(offsets)
        last_offset = int(offsets.max(initial=0))
        if record_count and max(
            last_offset, (record_count - 1) * self._record_bytes
        ) + self._record_bytes > len(content):
            # Some messages are shorter; read with the expected size they would overlap.
            lengths = gather_records(content, RECORD_BYTES, offsets).view(_RECORD_HEAD_DTYPE)[
                "length"
            ]
            is_record = lengths == self._record_bytes - _FRAME_BYTES
            return np.concatenate([offsets[~is_record], self.append(content, offsets[is_record])])
        self._reserve(record_count)
        target = self._records[self.count : self.count + record_count]
        if (
            record_count
            and int(offsets[-1]) - int(offsets[0]) == (record_count - 1) * self._record_bytes
            and _is_evenly_spaced(offsets)
        ):
            target[:] = np.frombuffer(content, self._raw_dtype, record_count, int(offsets[0]))
        else:
            target[:] = gather_records(content, self._record_bytes, offsets)
        is_invalid = _invalid_mask(target, self._record_bytes)
        invalid_offsets = offsets[is_invalid]
        if len(invalid_offsets):
            target[: record_count - len(invalid_offsets)] = target[~is_invalid]
        self.count += record_count - len(invalid_offsets)
        return invalid_offsets

    def array(self) -> npt.NDArray[np.void]:
        """Return the records so far; fields are views of them."""
        return self._records[: self.count].view(self._dtype)

    def _reserve(self, record_count: int) -> None:
        if self.count + record_count > len(self._records):
            grown = np.empty(
                max(self.count + record_count, 2 * len(self._records)), self._raw_dtype
            )
            grown[: self.count] = self._records[: self.count]
            self._records = grown


def _is_evenly_spaced(offsets: Offsets) -> bool:
    steps = offsets[1:] - offsets[:-1]
    return not (steps != steps[:1]).any()


@dataclass(frozen=True, slots=True)
class StoredMessage:
    """One message of varying size, not yet decoded."""

    log_time_ns: int
    publish_time_ns: int
    message_sequence: int
    payload: bytes


@dataclass(slots=True)
class VariableSizeChannel:
    """The messages of one channel whose size varies."""

    messages: list[StoredMessage] = field(default_factory=list)

    def append(self, content: Buffer, offsets: Offsets) -> None:
        """Append the messages at `offsets`."""
        heads = gather_records(content, RECORD_BYTES, offsets).view(_RECORD_HEAD_DTYPE)
        columns = (
            heads[name].tolist() for name in ("length", "log_time", "publish_time", "sequence")
        )
        for offset, length, log_time, publish_time, sequence in zip(
            offsets.tolist(), *columns, strict=True
        ):
            payload = bytes(content[offset + RECORD_BYTES : offset + _FRAME_BYTES + length])
            self.messages.append(StoredMessage(log_time, publish_time, sequence, payload))
