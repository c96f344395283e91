"""Corrupt samples: a count with a wrong bit, or with the high byte of the sample before.

A register that is read while it changes gives the low byte of the new value with the high byte
of the old one. Isolated spikes of about 250 counts were reported for an L3G4200D
(electronics.stackexchange.com, question 79502). A wire can flip a bit. The checksum of a frame
does not detect either of them, because they occur before the frame is built.
"""

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    InjectedCause,
    ParameterSampling,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

IntArray = NDArray[np.int64]

_BITS = 16
_FLIPS = 0.5  # share of the corrupt values that have a wrong bit; the others are torn


class CorruptSamples(Cause):
    """At random, one axis of a sample has a flipped bit or a torn value."""

    name = "corrupt_samples"
    size_meaning = "share of the samples with a flipped bit, or with bytes of two values"
    part = "link"
    unit = "1"
    typical = 1e-3
    sampled_min, sampled_max = 3e-4, 1e-2
    max_size = 0.1
    is_signed = False

    def __init__(self, share: float, flips: float, rng: np.random.Generator) -> None:
        """Corrupt a share of the samples; the share `flips` of these by a bit flip."""
        self._share, self._flips, self._rng = share, flips, rng
        self._is_corrupt = np.zeros(0, dtype=np.bool_)
        self._is_flipped = np.zeros(0, dtype=np.bool_)
        self._axis: IntArray = np.zeros(0, dtype=np.int64)
        self._bit: IntArray = np.zeros(0, dtype=np.int64)
        self._previous: IntArray | None = None  # the last counts of the block before
        self._last: IntArray | None = None

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        return {"share": Quantity(sampling.size, "1"), "bit_flips": Quantity(_FLIPS, "1")}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        share = Quantity(stated.number("share"), "1")
        return (CarriedCause({"share": share, "bit_flips": Quantity(_FLIPS, "1")}),)

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        effect = cls(injected.number("share"), injected.number("bit_flips"), rng)
        injected.board_hooks(hooks).count_effects.append(effect)

    def draw(self, count: int) -> None:
        """See `board_effects.CountEffect`."""
        corrupt, flip = self._rng.random((2, count))
        self._is_corrupt, self._is_flipped = corrupt < self._share, flip < self._flips
        self._axis = self._rng.integers(0, 3, count)
        self._bit = self._rng.integers(0, _BITS, count)
        self._previous = self._last

    def changed(self, counts: IntArray) -> IntArray:
        """See `board_effects.CountEffect`."""
        first = counts[:1] if self._previous is None else self._previous
        old = np.vstack([first, counts[:-1]])
        self._last = counts[-1:].copy()
        read = counts.copy()
        rows = np.flatnonzero(self._is_corrupt)
        axes = self._axis[rows]
        new = counts[rows, axes] & 0xFFFF
        torn = (new & 0xFF) | (old[rows, axes] & 0xFF00)
        flipped = new ^ (1 << self._bit[rows])
        values = np.where(self._is_flipped[rows], flipped, torn)
        read[rows, axes] = (values ^ 0x8000) - 0x8000  # two's complement
        return read
