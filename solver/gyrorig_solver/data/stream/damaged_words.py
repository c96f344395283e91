"""Check for damaged words, flipped bits and torn bytes, by the fourth difference.

A single wrong word with error A appears as A (1, -4, 6, -4, 1) in the fourth difference, which is
not possible for a motion after a low-pass. It is reported only if the error agrees with one flipped
bit, or with the high byte of the previous sample. The check needs no model: on the residual of a
fit, backlash once looked like a flipped bit. A jump of the rate at the start of a move makes spikes
too, and some of them agree with a damaged word by chance. If other spikes do not agree, more spikes
must agree than by chance.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from gyrorig_solver.data.arrays import FloatArray, IntArray
from gyrorig_solver.data.link_remedies import DAMAGED_WORDS
from gyrorig_solver.data.stream.count_stream import (
    AXES,
    WINDOW_SAMPLES,
    CheckResult,
    CountStream,
    StreamFinding,
)

CHECK_NAME = "damaged words"
SPIKE_PATTERN = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
MIN_SPIKE_SIGMAS = 14.0  # in local standard deviations of the fourth difference over 6
MAX_OTHER_AXES_SIGMAS = 6.0  # the same, for the other axes
MAX_NEIGHBOUR_SIGMAS = 3.5  # the same, for the neighbours after the spike is subtracted
SINGLE_SPIKE_SIGMAS = 30.0  # one such word is sufficient; of smaller ones, MIN_WORDS are needed
MIN_WORDS = 3
MAX_CHANCE_P = 1e-3  # that so many spikes agree with a damaged word by chance
# Errors that are added to a spike, to measure how often it agrees by chance; in counts.
CONTROL_ERRORS = (37.0, -53.0, 71.0, -89.0, 103.0, -127.0)
WORD_BITS = 16


@dataclass(frozen=True, slots=True)
class WordSpike:
    """A word that differs from both neighbours more than the motion allows."""

    row: int
    axis: int
    kind: str  # "bit", "torn", or "" if it agrees with neither
    sigmas: float
    chance: float  # probability that it agrees with a damaged word by chance


def check_damaged_words(stream: CountStream) -> CheckResult:
    """Check the counts for damaged words."""
    if np.any(stream.count_step > 1) or np.any(np.abs(stream.samples.counts[:1]) > 1 << 15):
        return CheckResult(
            CHECK_NAME, "not checked, because the file has physical values instead of raw words"
        )
    by_position = {(spike.row, spike.axis): spike for spike in _find_spikes(stream)}
    spikes = sorted(by_position.values(), key=lambda spike: spike.row)
    words = [spike for spike in spikes if spike.kind]
    p_value = _chance_p_value(spikes)
    if p_value > MAX_CHANCE_P:
        return CheckResult(
            CHECK_NAME,
            f"none of {3 * stream.size} words is damaged; the motion has {len(spikes)} spikes",
        )
    if len(words) < MIN_WORDS and all(word.sigmas < SINGLE_SPIKE_SIGMAS for word in words):
        return CheckResult(CHECK_NAME, f"none of {3 * stream.size} words is damaged")
    flips = sum(word.kind == "bit" for word in words)
    axes = tuple(AXES[k] for k in sorted({word.axis for word in words}))
    share = len(words) / stream.size
    summary = (
        f"{len(words)} of {stream.size} samples ({100.0 * share:.2g} %) contain a damaged "
        f"word: {flips} with a flipped bit, {len(words) - flips} with a wrong high byte"
    )
    finding = StreamFinding(
        cause="corrupt_samples",
        part="link",
        where=axes,
        count=len(words),
        total=stream.size,
        p_value=p_value,
        quantity="share",
        size=share,
        unit="1",
        seen_as=summary,
        remedy=DAMAGED_WORDS.for_link(stream.samples.link),
        times_s=stream.times_s(np.array([word.row for word in words], dtype=np.int64)),
    )
    return CheckResult(CHECK_NAME, summary, (finding,))


def _chance_p_value(spikes: Sequence[WordSpike]) -> float:
    """Return the probability that so many spikes agree with damaged words by chance.

    It is 0 if all of them agree, because then no spike shows that the motion makes spikes.
    """
    agreeing = sum(bool(spike.kind) for spike in spikes)
    if agreeing == len(spikes):
        return 0.0
    chance = sum(spike.chance for spike in spikes) / len(spikes)
    return float(bdtrc(agreeing - 1, len(spikes), chance))


def _find_spikes(stream: CountStream) -> Iterator[WordSpike]:
    for rows, counts in stream.pieces():
        if counts.shape[0] < 2 * WINDOW_SAMPLES:
            continue
        spike_size = (
            np.diff(counts.astype(np.float64), 4, axis=0) / 6.0
        )  # row 0 belongs to sample 2
        deviation = _local_deviation(spike_size)
        is_spike = np.abs(spike_size) > MIN_SPIKE_SIGMAS * deviation
        for row, axis in np.argwhere(is_spike):
            if not _is_single_word(counts, spike_size, deviation, int(row), int(axis)):
                continue
            before, word = (int(counts[row + k, axis]) for k in (1, 2))
            amplitude, unit = float(spike_size[row, axis]), float(deviation[row, axis])
            kind = _bit_or_byte_error(word, before, amplitude, unit)
            agreeing = sum(
                bool(_bit_or_byte_error(word, before, amplitude + error, unit))
                for error in CONTROL_ERRORS
            )
            yield WordSpike(
                rows.start + int(row) + 2,
                int(axis),
                kind,
                abs(amplitude) / unit,
                agreeing / len(CONTROL_ERRORS),
            )


def _local_deviation(spike_size: FloatArray) -> FloatArray:
    """Return the local standard deviation of the fourth difference, same shape."""
    overall = np.median(np.abs(spike_size), axis=0) / 0.6745
    window_count = -(-spike_size.shape[0] // WINDOW_SAMPLES)
    padded = np.pad(
        spike_size,
        ((0, window_count * WINDOW_SAMPLES - spike_size.shape[0]), (0, 0)),
        mode="reflect",
    )
    window_deviation = (
        np.median(np.abs(padded.reshape(window_count, WINDOW_SAMPLES, 3)), axis=1) / 0.6745
    )
    neighbour_deviation = np.maximum.reduce(
        [
            window_deviation,
            np.roll(window_deviation, 1, axis=0),
            np.roll(window_deviation, -1, axis=0),
        ]
    )
    return np.repeat(
        np.maximum(np.maximum(neighbour_deviation, overall), 0.5), WINDOW_SAMPLES, axis=0
    )[: spike_size.shape[0]]


def _is_single_word(
    counts: IntArray, spike_size: FloatArray, deviation: FloatArray, row: int, axis: int
) -> bool:
    """Return whether a spike at fourth difference `row` comes from one word of one axis."""
    if row < 2 or row >= spike_size.shape[0] - 2:
        return False
    amplitude, unit = float(spike_size[row, axis]), float(deviation[row, axis])
    neighbours = spike_size[row - 2 : row + 3, axis] - amplitude * SPIKE_PATTERN / 6.0
    if np.abs(neighbours).max() > MAX_NEIGHBOUR_SIGMAS * unit:
        return False  # wider than one sample: a motion
    others = [k for k in range(3) if k != axis]
    others_moved = bool(
        np.any(np.abs(spike_size[row, others]) > MAX_OTHER_AXES_SIGMAS * deviation[row, others])
    )
    is_repeat = np.array_equal(counts[row + 2], counts[row + 1])  # another defect
    return not others_moved and not is_repeat


def _bit_or_byte_error(word: int, before: int, amplitude: float, unit: float) -> str:
    """Return the kind of damage that changes a word by `amplitude`, with deviation `unit`."""
    same_high = word >> 8 == before >> 8
    for bit in range(WORD_BITS):
        intended = _to_signed((word & 0xFFFF) ^ (1 << bit))
        if abs(amplitude - (word - intended)) < MAX_NEIGHBOUR_SIGMAS * unit:
            return "torn" if bit == 8 and same_high else "bit"
    high = round(amplitude / 256.0)
    torn = high != 0 and same_high and abs(amplitude - 256.0 * high) < MAX_NEIGHBOUR_SIGMAS * unit
    return "torn" if torn else ""


def _to_signed(word: int) -> int:
    return (word ^ 0x8000) - 0x8000
