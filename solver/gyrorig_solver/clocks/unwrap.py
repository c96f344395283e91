"""Make a wrapping tick counter continuous, and find where a device started anew.

A wrap is counted by host time, not by "the stamp went backwards": one swapped sample
read as a wrap is an error of 71.6 min (time synchronisation notes, section 5). Between
two samples the number of wraps is the nearest integer to
(host interval - device interval) / period, safe while skew x gap is below half a period.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray

# A tick that steps back by at most this many sample periods is a late sample, not a restart.
LATE_SAMPLES = 4
# How far host and device may disagree over one step before the clock is taken to have jumped.
# The largest stall seen between a device and a loaded host is far below a second.
JUMP_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Unwrapped:
    """Continuous device time, in segments between restarts."""

    device_s: FloatArray  # (n,), seconds since the segment's first sample, nominal tick rate
    segment: IntArray  # (n,), counts restarts from 0
    late: BoolArray  # (n,), True where a sample came after a younger one
    wraps: int

    @property
    def restarts(self) -> int:
        """How often the device's clock began anew inside the recording."""
        return int(self.segment[-1]) if self.segment.size else 0


def unwrap_ticks(
    ticks: IntArray, host_s: FloatArray, tick_hz: float, counter_bits: int
) -> Unwrapped:
    """Return continuous device time.

    Args:
        ticks: raw counter values as sent, shape (n,), in the order of arrival.
        host_s: arrival times on the capture clock, shape (n,), not decreasing.
        tick_hz: nominal ticks per second.
        counter_bits: width of the counter.

    A step is a restart when, after the nearest number of whole wraps is taken out, host
    and device still disagree by more than a second, or when the counter falls back by
    more than a few samples although no wrap was due.
    """
    if ticks.size == 0:
        return Unwrapped(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.bool_), 0)
    modulus = 2**counter_bits
    step_ticks = np.diff(ticks.astype(np.int64)).astype(np.float64)
    step_host_s = np.diff(host_s)
    wraps = np.rint((step_host_s * tick_hz - step_ticks) / modulus)
    wraps = np.where(wraps > 0, wraps, 0.0) if counter_bits < 64 else np.zeros_like(step_ticks)
    step_s = (step_ticks + wraps * modulus) / tick_hz
    usual_s = float(np.median(step_s)) if step_s.size else 0.0
    behind = step_s < -LATE_SAMPLES * max(usual_s, 0.0) - 1e-12
    jumped = np.abs(step_s - step_host_s) > JUMP_S
    restart = behind | jumped
    segment = np.concatenate([[0], np.cumsum(restart)]).astype(np.int64)
    step_s = np.where(restart, 0.0, step_s)
    device_s = np.concatenate([[0.0], np.cumsum(step_s)])
    first = np.concatenate([[0], np.flatnonzero(restart) + 1])
    device_s = device_s - device_s[first][segment]
    late = np.zeros(ticks.size, dtype=np.bool_)
    late[1:] = (step_s < 0.0) & ~restart
    return Unwrapped(device_s, segment, late, int(np.sum(wraps[~restart])))


def unwrap_sequence(sequence: IntArray, expected: FloatArray) -> IntArray:
    """Return a sample counter without wraps, shape (n,).

    Args:
        sequence: as sent, shape (n,); 16 bits wide where no value exceeds 65535, else 32.
        expected: how many samples should have passed since the first one by the clock,
            shape (n,); it decides how many wraps lie inside a long gap.
    """
    if sequence.size == 0:
        return sequence.astype(np.int64)
    modulus = 2**16 if int(sequence.max()) < 2**16 else 2**32
    since = (sequence - sequence[0]).astype(np.float64)
    wraps = np.rint((expected - since) / modulus)
    return np.asarray(since + wraps * modulus, dtype=np.int64)
