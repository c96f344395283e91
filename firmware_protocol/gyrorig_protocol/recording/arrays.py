"""Collect the messages of one channel as one numpy array, without a loop over them.

What to use when: under `reader`. `FixedChannel` for messages of one size: the records
of each chunk are gathered whole into one buffer, and the fields are views into it.
`VariableChannel` for the others: payloads kept one by one, they are of low rate.
Samples that are too many to be kept as records go into `imu_columns`.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.recording.cdr import HEADER_BYTES, Layout
from gyrorig_protocol.recording.cdr_stream import ENCAPSULATION
from gyrorig_protocol.recording.chunks import RECORD_BYTES, Offsets, gather
from gyrorig_protocol.recording.fields import Buffer

_FRAME_BYTES = 9
_ENCAPSULATION = int.from_bytes(ENCAPSULATION, "little")

_RECORD_HEAD = np.dtype(
    {
        "names": ["length", "sequence", "log_time", "publish_time"],
        "formats": ["<u8", "<u4", "<i8", "<i8"],
        "offsets": [1, 11, 15, 23],
        "itemsize": RECORD_BYTES,
    }
)


def array_dtype(layout: Layout) -> np.dtype[np.void]:
    """Fields of a record: log_time, publish_time, message_sequence, then the payload's."""
    names = ["log_time", "publish_time", "message_sequence"]
    formats: list[object] = ["<i8", "<i8", "<u4"]
    offsets = [15, 23, 11]
    for name in layout.dtype.names or ():
        dtype, offset = layout.dtype.fields[name][:2]  # type: ignore[index]
        names.append(f"payload.{name}" if name in names else name)
        formats.append(dtype)
        offsets.append(RECORD_BYTES + HEADER_BYTES + offset)
    itemsize = RECORD_BYTES + layout.size
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": itemsize})


def sound_records(
    content: Buffer, size: int, offsets: Offsets
) -> tuple[npt.NDArray[np.void], Offsets]:
    """The records of `size` bytes at `offsets`, and the offsets of those that are none."""
    wrong = offsets[:0]
    last = int(offsets.max(initial=0))
    if len(offsets) and max(last, (len(offsets) - 1) * size) + size > len(content):
        # Shorter messages are among them: taken at our size they would overlap.
        lengths = gather(content, RECORD_BYTES, offsets).view(_RECORD_HEAD)["length"]
        good = lengths == size - _FRAME_BYTES
        wrong, offsets = offsets[~good], offsets[good]
    records = gather(content, size, offsets)
    bad = _unsound(records, size)
    if not bad.any():
        return records, wrong
    return records[~bad], np.concatenate([wrong, offsets[bad]])


def _unsound(records: npt.NDArray[np.void], size: int) -> npt.NDArray[np.bool_]:
    """Which records are of another length, or do not begin as a payload does."""
    heads = records.view(_ends_of_head(size))
    bad: npt.NDArray[np.bool_] = heads["length"] != size - _FRAME_BYTES
    bad |= heads["encapsulation"] != _ENCAPSULATION
    return bad


@lru_cache(maxsize=64)
def _ends_of_head(size: int) -> np.dtype[np.void]:
    return np.dtype(
        {
            "names": ["length", "encapsulation"],
            "formats": ["<u8", "<u4"],
            "offsets": [1, RECORD_BYTES],
            "itemsize": size,
        }
    )


class FixedChannel:
    """The records of one channel whose messages have one size."""

    def __init__(self, layout: Layout, expected: int) -> None:
        self._size = RECORD_BYTES + layout.size
        self._raw = np.dtype((np.void, self._size))
        self._dtype = array_dtype(layout)
        self._records: npt.NDArray[np.void] = np.empty(expected, self._raw)
        self.count = 0

    def append(self, content: Buffer, offsets: Offsets) -> Offsets:
        """Take over the records at `offsets`; returns those of no such message."""
        n = len(offsets)
        last = int(offsets.max(initial=0))
        if n and max(last, (n - 1) * self._size) + self._size > len(content):
            # Shorter messages are among them: taken at our size they would overlap.
            lengths = gather(content, RECORD_BYTES, offsets).view(_RECORD_HEAD)["length"]
            good = lengths == self._size - _FRAME_BYTES
            return np.concatenate([offsets[~good], self.append(content, offsets[good])])
        self._reserve(n)
        target = self._records[self.count : self.count + n]
        if n and int(offsets[-1]) - int(offsets[0]) == (n - 1) * self._size and _even(offsets):
            target[:] = np.frombuffer(content, self._raw, n, int(offsets[0]))
        else:
            target[:] = gather(content, self._size, offsets)
        bad = _unsound(target, self._size)
        wrong = offsets[bad]
        if len(wrong):
            target[: n - len(wrong)] = target[~bad]
        self.count += n - len(wrong)
        return wrong

    def array(self) -> npt.NDArray[np.void]:
        """The records so far; fields are views into them."""
        return self._records[: self.count].view(self._dtype)

    def _reserve(self, more: int) -> None:
        if self.count + more > len(self._records):
            grown = np.empty(max(self.count + more, 2 * len(self._records)), self._raw)
            grown[: self.count] = self._records[: self.count]
            self._records = grown


def _even(offsets: Offsets) -> bool:
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
class VariableChannel:
    """The messages of one channel whose size varies."""

    messages: list[StoredMessage] = field(default_factory=list)

    def append(self, content: Buffer, offsets: Offsets) -> None:
        """Take over the messages at `offsets`."""
        heads = gather(content, RECORD_BYTES, offsets).view(_RECORD_HEAD)
        columns = (
            heads[name].tolist() for name in ("length", "log_time", "publish_time", "sequence")
        )
        for at, length, log_time, publish_time, sequence in zip(
            offsets.tolist(), *columns, strict=True
        ):
            payload = bytes(content[at + RECORD_BYTES : at + _FRAME_BYTES + length])
            self.messages.append(StoredMessage(log_time, publish_time, sequence, payload))
