"""Words that arrive damaged: flipped bits and torn bytes, by their fourth difference.

A lone wrong word of size A shows as A (1, -4, 6, -4, 1) in the fourth difference, which no
motion through a low-pass does. It is called damage only where its size is what one bit, or
the high byte of the sample before, makes of the word that its neighbours call for. Judged
without a model: judged on a residual, backlash was once called a flipped bit.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.raw.result import AXES, WINDOW, Look, RawFinding, Stream

CHECK = "damaged words"
PATTERN = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
STICKS_OUT = 14.0  # local deviations of the fourth difference, over 6
QUIET = 6.0  # the same, for the other axes
ALONE = 3.5  # the same, for what is left around a spike when it is taken out
CLEAR = 30.0  # a word this far off is damage by itself; where none is, several are wanted
SEVERAL = 3
WORD_BITS = 16
REMEDY = (
    "give the frame a check sum, read the six bytes in one burst with block data update on, "
    "and look at the bus' speed, pull-ups and cable"
)


@dataclass(frozen=True, slots=True)
class Damaged:
    """One word."""

    row: int
    axis: int
    kind: str
    sigmas: float


def look(stream: Stream) -> Look:
    """Look for damaged words in the counts as they were sent."""
    if np.any(stream.grain > 1) or np.any(np.abs(stream.samples.counts[:1]) > 1 << 15):
        return Look(CHECK, "not looked for: the file holds physical values, not the words as sent")
    found = {(one.row, one.axis): one for one in _damaged(stream)}
    words = sorted(found.values(), key=lambda one: one.row)
    if len(words) < SEVERAL and all(one.sigmas < CLEAR for one in words):
        return Look(CHECK, f"none among {3 * stream.size} words")
    flips = sum(one.kind == "bit" for one in words)
    axes = tuple(AXES[k] for k in sorted({one.axis for one in words}))
    share = len(words) / stream.size
    said = (
        f"{len(words)} of {stream.size} samples ({100.0 * share:.2g} %) hold a damaged word: "
        f"{flips} with a flipped bit, {len(words) - flips} torn by whole high bytes"
    )
    finding = RawFinding(
        cause="corrupt_samples",
        part="link",
        where=axes,
        count=len(words),
        total=stream.size,
        p_value=0.0,
        name="share",
        size=share,
        unit="1",
        seen_as=said,
        remedy=REMEDY,
        times_s=stream.times_s(np.array([one.row for one in words], dtype=np.int64)),
    )
    return Look(CHECK, said, (finding,))


def _damaged(stream: Stream) -> Iterator[Damaged]:
    for rows, counts in stream.pieces():
        if counts.shape[0] < 2 * WINDOW:
            continue
        size = np.diff(counts.astype(np.float64), 4, axis=0) / 6.0  # at row 2 and on
        local = _local(size)
        far = np.abs(size) > STICKS_OUT * local
        for at, axis in np.argwhere(far):
            kind = _kind(counts, size, local, int(at), int(axis))
            if kind:
                sigmas = float(abs(size[at, axis]) / local[at, axis])
                yield Damaged(rows.start + int(at) + 2, int(axis), kind, sigmas)


def _local(size: FloatArray) -> FloatArray:
    """Return the deviation of the fourth difference around each sample, same shape."""
    overall = np.median(np.abs(size), axis=0) / 0.6745
    many = -(-size.shape[0] // WINDOW)
    padded = np.pad(size, ((0, many * WINDOW - size.shape[0]), (0, 0)), mode="reflect")
    near = np.median(np.abs(padded.reshape(many, WINDOW, 3)), axis=1) / 0.6745
    wide = np.maximum.reduce([near, np.roll(near, 1, axis=0), np.roll(near, -1, axis=0)])
    return np.repeat(np.maximum(np.maximum(wide, overall), 0.5), WINDOW, axis=0)[: size.shape[0]]


def _kind(counts: IntArray, size: FloatArray, local: FloatArray, at: int, axis: int) -> str:
    """Return what a spike at fourth difference `at` is: bit, torn, or "" for neither."""
    if at < 2 or at >= size.shape[0] - 2:
        return ""
    amplitude, unit = float(size[at, axis]), float(local[at, axis])
    near = size[at - 2 : at + 3, axis] - amplitude * PATTERN / 6.0
    if np.abs(near).max() > ALONE * unit:
        return ""  # more than one sample wide: something that moved
    others = [k for k in range(3) if k != axis]
    moved = bool(np.any(np.abs(size[at, others]) > QUIET * local[at, others]))
    again = np.array_equal(counts[at + 2], counts[at + 1])  # that is another fault
    if moved or again:
        return ""
    return _made_by(int(counts[at + 2, axis]), int(counts[at + 1, axis]), amplitude, unit)


def _made_by(word: int, before: int, amplitude: float, unit: float) -> str:
    """Return what makes a word that is too large by `amplitude`, known to about `unit`."""
    same_high = word >> 8 == before >> 8
    for bit in range(WORD_BITS):
        meant = _signed((word & 0xFFFF) ^ (1 << bit))
        if abs(amplitude - (word - meant)) < ALONE * unit:
            return "torn" if bit == 8 and same_high else "bit"
    high = round(amplitude / 256.0)
    torn = high != 0 and same_high and abs(amplitude - 256.0 * high) < ALONE * unit
    return "torn" if torn else ""


def _signed(word: int) -> int:
    return (word ^ 0x8000) - 0x8000
