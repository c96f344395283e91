"""Words that are not what was measured: stale, torn, flipped, swapped, clipped.

A register that is read again before a new sample is there gives the old words. Read while it
changes, it gives the low byte of the new word with the high byte of the old one (boards
survey, section 1.1: isolated spikes of about 256 counts). A wire may flip a bit. None of this
breaks a frame's checksum: it happens before the frame is made.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]

_BITS = 16
_LEAST, _MOST = -(2**15), 2**15 - 1


class Stale:
    """Now and then the words of the sample before are read again."""

    def __init__(self, share: float, rng: np.random.Generator) -> None:
        """Repeat a share of the samples."""
        self._share, self._rng = share, rng
        self._again = np.zeros(0, dtype=np.bool_)
        self._before: IntArray | None = None
        self._end: IntArray | None = None

    def draw(self, count: int) -> None:
        """See `sensor.CountEffect`."""
        self._again = self._rng.random(count) < self._share
        self._before = self._end

    def changed(self, counts: IntArray) -> IntArray:
        """See `sensor.CountEffect`."""
        first = counts[:1] if self._before is None else self._before
        known = np.vstack([first, counts])
        fresh = np.where(self._again, 0, np.arange(1, len(counts) + 1))
        read = known[np.maximum.accumulate(fresh)]
        self._end = read[-1:].copy()
        return read


class Corrupt:
    """Now and then one word of a sample has a wrong bit, or an old high byte."""

    def __init__(self, share: float, flips: float, rng: np.random.Generator) -> None:
        """Spoil a share of the samples; `flips` of these by a bit, the others by tearing."""
        self._share, self._flips, self._rng = share, flips, rng
        self._hit = np.zeros(0, dtype=np.bool_)
        self._flip = np.zeros(0, dtype=np.bool_)
        self._axis: IntArray = np.zeros(0, dtype=np.int64)
        self._bit: IntArray = np.zeros(0, dtype=np.int64)
        self._before: IntArray | None = None
        self._end: IntArray | None = None

    def draw(self, count: int) -> None:
        """See `sensor.CountEffect`."""
        hit, flip = self._rng.random((2, count))
        self._hit, self._flip = hit < self._share, flip < self._flips
        self._axis = self._rng.integers(0, 3, count)
        self._bit = self._rng.integers(0, _BITS, count)
        self._before = self._end

    def changed(self, counts: IntArray) -> IntArray:
        """See `sensor.CountEffect`."""
        first = counts[:1] if self._before is None else self._before
        old = np.vstack([first, counts[:-1]])
        self._end = counts[-1:].copy()
        read = counts.copy()
        rows = np.flatnonzero(self._hit)
        axes = self._axis[rows]
        new = counts[rows, axes] & 0xFFFF
        torn = (new & 0xFF) | (old[rows, axes] & 0xFF00)
        flipped = new ^ (1 << self._bit[rows])
        words = np.where(self._flip[rows], flipped, torn)
        read[rows, axes] = (words ^ 0x8000) - 0x8000  # two's complement
        return read


@dataclass(frozen=True, slots=True)
class Rewired:
    """Axes taken for one another, or with the wrong sign."""

    order: tuple[int, int, int]
    signs: tuple[int, int, int]

    def draw(self, count: int) -> None:
        """See `sensor.CountEffect`: nothing is drawn."""

    def changed(self, counts: IntArray) -> IntArray:
        """See `sensor.CountEffect`."""
        read = counts[:, list(self.order)] * np.array(self.signs)
        return np.asarray(np.clip(read, _LEAST, _MOST))


class Lost:
    """Now and then samples do not come; their numbers are missing with them."""

    def __init__(self, share: float, longest: int, rng: np.random.Generator) -> None:
        """Lose a share of the samples, in gaps of 1 to `longest`."""
        self._start = 2.0 * share / (1.0 + longest)
        self._longest, self._rng = longest, rng
        self._rest = 0

    def draw(self, count: int) -> NDArray[np.bool_]:
        """Return which of the next `count` samples are lost."""
        begins = self._rng.random(count) < self._start
        lengths = self._rng.integers(1, self._longest + 1, count)
        lost = np.zeros(count, dtype=np.bool_)
        for k in range(count):
            if begins[k]:
                self._rest = max(self._rest, int(lengths[k]))
            lost[k] = self._rest > 0
            self._rest = max(self._rest - 1, 0)
        return lost
