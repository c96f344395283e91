"""The sample counter as the clock of a board whose samples share timestamps.

A board that reads the FIFO of its sensor often gives all samples of one reading the same time, that
of the reading. The delay from the sample to the reading changes, so these times are no sampling
times. The counter of the samples follows the clock of the sensor. The arrival times show its rate,
which drifts with the temperature of the sensor.

What to use when: `has_shared_times` decides; `map_sample_counter` replaces `map_clock`;
`map_counted_pieces` for times that the counter corrects.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from gyrorig_solver.data.arrays import FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_faults import CounterArray
from gyrorig_solver.data.clocks.clock_map import ClockMap, map_clock
from gyrorig_solver.data.clocks.tick_unwrapping import counter_modulus

INSPECTED_SAMPLES = 1 << 14
RATE_SAMPLES = 1 << 10  # between the two times of one estimate of the rate


def has_shared_times(ticks: IntArray, sequence: CounterArray) -> bool:
    """Return whether most samples have the time of the sample before, but another number.

    False if all times are equal: then the board sends none.
    """
    rows = slice(0, INSPECTED_SAMPLES)
    is_same_time = np.diff(ticks[rows]) == 0
    is_counted = np.diff(sequence[rows].astype(np.int64)) != 0
    is_shared = np.count_nonzero(is_same_time & is_counted) > is_same_time.size / 2
    return bool(is_shared and not is_same_time.all())


def map_sample_counter(
    sequence: CounterArray, host_s: FloatArray, sequence_bits: int | None = None
) -> ClockMap:
    """Return sample times from the counter of the samples and their arrival times.

    Args:
        sequence: the sample counter as sent, shape (n,).
        host_s: arrival times, shape (n,), not decreasing.
        sequence_bits: width of the sample counter; None: 16 if no value exceeds 65535,
            otherwise 32.
    """
    modulus = counter_modulus(sequence, sequence_bits)
    rate_hz = _sample_rate_hz(sequence, host_s, modulus)
    bits = modulus.bit_length() - 1
    return map_clock(
        sequence.astype(np.int64), host_s, rate_hz, bits, sequence,
        sequence_bits=bits, is_sensor_clock=True,
    )  # fmt: skip


def map_counted_pieces(
    sequence: CounterArray,
    time_s: FloatArray,
    longest_step_s: float,
    map_piece: Callable[[IntArray, FloatArray, float], FloatArray],
) -> FloatArray:
    """Return new times of samples, computed for each piece without a restart of the counter, (n,).

    Without a counter, the times are returned as they are.

    Args:
        sequence: the sample counter, shape (n,).
        time_s: of the samples, shape (n,), not decreasing.
        longest_step_s: of the times against the counter. A longer step is a restart of the board or
            a pause of the host, after which the counter does not show the time.
        map_piece: returns the new times from the numbers of the samples, their times and the rough
            period.
    """
    modulus = counter_modulus(sequence)
    rate_hz = _sample_rate_hz(sequence, time_s, modulus)
    if rate_hz <= 0.0:
        return time_s
    counts: IntArray = sequence.astype(np.int64)
    steps: IntArray = np.diff(counts) % modulus
    number: IntArray = np.concatenate([[0], np.cumsum(steps)])
    is_break = np.abs(steps / rate_hz - np.diff(time_s)) > longest_step_s
    edges = [0, *(1 + np.flatnonzero(is_break)).tolist(), time_s.size]
    return np.concatenate(
        [map_piece(number[a:b], time_s[a:b], 1.0 / rate_hz) for a, b in pairwise(edges)]
    )


def _sample_rate_hz(sequence: CounterArray, host_s: FloatArray, modulus: int) -> float:
    """Return a rough sample rate, which lost samples and gaps do not change."""
    stride = min(RATE_SAMPLES, sequence.size - 1)
    rows = slice(0, INSPECTED_SAMPLES + stride)
    number, time_s = sequence[rows].astype(np.int64), host_s[rows]
    counted = (number[stride:] - number[:-stride]) % modulus
    elapsed_s = np.maximum(time_s[stride:] - time_s[:-stride], 1e-9)
    return float(np.median(counted / elapsed_s))
