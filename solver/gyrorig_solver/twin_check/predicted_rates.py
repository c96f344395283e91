"""The noise-free rates of a simulation at the sample times of another recording.

Simulated and real unit execute the same commands, but the start times of their moves differ: the
unit answers a command a few milliseconds later or earlier. No simulation can predict the single
delays. Therefore the prediction takes them from the recording: each move is shifted to the start
that the position replies of the recording show. The distribution of the delays is compared
separately, see `session_features`. The remaining error of a start is an unknown of the likelihood,
see `predictive_density`.

What to use when: `SimulatedRates.of` for a run; `SimulatedRates.at` for the prediction.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from scipy.interpolate import CubicSpline

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.twin_check.observed_session import AXES, ObservedSession

# Tilt turns the stage about its x axis, pan about the other two.
STAGE_AXES_OF = ((1, 2), (0,))
LEAD_S = 0.01  # a move's shift begins this much before its start, because the start has an error
MAX_COUNTING_OFFSET = 3  # samples that the daemon can miss while it opens the port
MAX_MISSING_MOVES = 8  # at the begin of one of two recordings of the same orders
GAIN_BLOCK_S = 0.5  # means for the gain; longer than the delay of a sensor


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRates:
    """Noise-free rates of one simulated session."""

    own_rad_s: FloatArray  # block means at the session's samples, (n, 3)
    rates: CubicSpline  # over the time of the simulated session
    starts_s: tuple[FloatArray, FloatArray]  # true starts of its observed moves, pan and tilt
    first_s: float  # time of the first sample
    gain: FloatArray  # stage to sensor, (3, 3), approximate

    @classmethod
    def of(cls, session: ObservedSession, board: str, arrays: Mapping[str, FloatArray]) -> Self:
        """Return the rates of a run.

        Args:
            session: the recording of the run.
            board: its name.
            arrays: of `gyrorigd record --rates`.

        Raises:
            InputError: the recording and the rates are not of one session.
        """
        rows = np.asarray(arrays[f"{board}.number"], dtype=np.int64)
        hidden, true_s = arrays[f"{board}.hidden_rad_s"], arrays[f"{board}.time_s"]
        numbers = session.sample_numbers() - int(rows[0])
        numbers += _counting_offset(session.samples.rate_rad_s, hidden, numbers)
        inside = np.arange(int(numbers[0]), int(numbers[-1]) + 1)
        # Between lost samples, the mapped time changes like the true time.
        mapping_s = session.samples.time_s - true_s[numbers]
        mapped_s = true_s[inside] + np.interp(inside, numbers, mapping_s)
        if np.any(np.diff(mapped_s) <= 0.0):
            # Arrival times: after a stall of the host, many samples arrive at once.
            mapped_s = true_s[inside] + np.median(mapping_s)
        starts = tuple(
            _mapped_starts(arrays[f"{axis}_s"], moves.start_s, float(np.median(mapping_s)))
            for axis, moves in zip(AXES, session.moves, strict=True)
        )
        own_means = _own_block_means(session, hidden, numbers)
        return cls(
            own_means,
            _interpolate(mapped_s, hidden[inside], arrays.get(f"{board}.between_rad_s"), inside),
            (starts[0], starts[1]),
            float(mapped_s[0]),
            _approximate_gain(session, own_means),
        )

    def at(self, session: ObservedSession) -> FloatArray:
        """Return block means at the samples of another recording, shape (n, 3)."""
        shifts = self._shifts(session)
        rate = self._shifted(session.time_s, shifts)
        return session.block_means(rate)

    def start_derivatives(self, session: ObservedSession) -> list[tuple[int, FloatArray]]:
        """Return the derivative of `at` by the start of each move: axis and (n, 3), in order."""
        shifts = self._shifts(session)
        derivatives = []
        inverse = np.linalg.inv(self.gain)
        for axis, moves in enumerate(session.moves):
            slope = -self.rates(session.time_s + shifts[axis], 1)
            stage = slope @ inverse.T
            selector = np.zeros((3, 3))
            for row in STAGE_AXES_OF[axis]:
                selector[row, row] = 1.0
            slope = session.block_means(stage @ (self.gain @ selector).T)
            bounds = np.searchsorted(
                session.block_time_s, np.append(moves.start_s - LEAD_S, np.inf)
            )
            for first, last in pairwise(bounds.tolist()):
                column = np.zeros_like(slope)
                column[first:last] = slope[first:last]
                derivatives.append((axis, column))
        return derivatives

    def _shifted(self, time_s: FloatArray, shifts: tuple[FloatArray, FloatArray]) -> FloatArray:
        """Return the rates with pan and tilt shifted separately, shape (m, 3)."""
        pan, tilt = (self.rates(time_s + shift) for shift in shifts)
        inverse = np.linalg.inv(self.gain)
        tilt_part = self.gain[:, :1] @ inverse[:1]  # sensor to sensor
        return np.asarray(pan + (tilt - pan) @ tilt_part.T, dtype=np.float64)

    def _shifts(self, session: ObservedSession) -> tuple[FloatArray, FloatArray]:
        """Return simulated minus measured time at each sample, for pan and tilt."""
        differences = [
            _match_starts(moves.start_s, starts)
            for moves, starts in zip(session.moves, self.starts_s, strict=True)
        ]
        known = np.concatenate(differences)
        typical = float(np.median(known)) if known.size else self.first_s - float(session.time_s[0])
        shifts = []
        for moves, difference in zip(session.moves, differences, strict=True):
            if not difference.size:
                shifts.append(np.full(session.time_s.size, typical))
                continue
            begin_s = _shift_begins(moves.start_s, difference)
            row = np.searchsorted(begin_s, session.time_s, side="right") - 1
            shifts.append(difference[np.maximum(row, 0)])
        return shifts[0], shifts[1]


def _interpolate(
    mapped_s: FloatArray, rates: FloatArray, between: FloatArray | None, inside: IntArray
) -> CubicSpline:
    """Return the rates over time.

    At the edges of the motion, the rates change within a sample. The rates half a sample before
    each sample keep the error of the interpolation far below the noise. Without them, a recording
    whose samples are between those of the simulation has a larger residual than the draws.

    Args:
        mapped_s: times of the samples, (n,).
        rates: at these times, (n, 3).
        between: rates half a sample earlier, of all samples; None if the file has none.
        inside: indices of the n samples in `between`.
    """
    if between is None:
        return CubicSpline(mapped_s, rates)
    times_s = np.empty(2 * mapped_s.size - 1)
    values = np.empty((times_s.size, rates.shape[1]))
    times_s[::2], times_s[1::2] = mapped_s, 0.5 * (mapped_s[:-1] + mapped_s[1:])
    values[::2], values[1::2] = rates, between[inside[1:]]
    return CubicSpline(times_s, values)


def _counting_offset(measured: FloatArray, noise_free: FloatArray, numbers: IntArray) -> int:
    """Return by how many samples the numbers of a recording are behind those of the simulation.

    The daemon numbers the samples of a board without a sequence number from the first one that
    arrives. The right offset leaves the noise alone, and so the smallest residual.

    Args:
        measured: rates of the simulated recording, (m, 3).
        noise_free: rates of all samples since power-up, (n, 3).
        numbers: of the m samples, without the offset.

    Raises:
        InputError: samples have no noise-free rates.
    """
    offsets = [
        offset
        for offset in range(-MAX_COUNTING_OFFSET, MAX_COUNTING_OFFSET + 1)
        if numbers[0] + offset >= 0 and numbers[-1] + offset < len(noise_free)
    ]
    if not offsets:
        raise InputError(
            "the simulated recording has samples without noise-free rates",
            "simulate the session again",
        )
    return min(
        offsets, key=lambda k: float(np.var(measured - noise_free[numbers + k], axis=0).sum())
    )


def _mapped_starts(true_s: FloatArray, observed_s: FloatArray, mapping_s: float) -> FloatArray:
    """Return the true starts of the observed moves on the time axis of the recording.

    The simulation also lists orders that move nothing. True and observed starts differ by a
    constant, which the position replies of all moves show.

    Args:
        true_s: starts of all orders of an axis.
        observed_s: starts of its moves, shape (m,).
        mapping_s: time of the recording minus true time, approximate.
    """
    if not true_s.size or not observed_s.size:
        return np.zeros(0)
    matched_s = true_s[_nearest(observed_s - mapping_s, true_s)]
    return np.asarray(matched_s + np.median(observed_s - matched_s), dtype=np.float64)


def _match_starts(starts_s: FloatArray, others_s: FloatArray) -> FloatArray:
    """Return, for each of some starts, the other start minus this start, shape of `starts_s`.

    With unequal numbers of moves, each start is matched with the nearest one, at the offset that
    matches the starts best.
    """
    if not starts_s.size or not others_s.size:
        return np.zeros(0)
    if starts_s.size == others_s.size:
        return np.asarray(others_s - starts_s, dtype=np.float64)
    # The first moves alone give candidates: with all of them, the time grows as the fourth power.
    offsets = (others_s[:MAX_MISSING_MOVES] - starts_s[:MAX_MISSING_MOVES, None]).ravel()
    nearest = [_nearest(starts_s + offset, others_s) for offset in offsets]
    misfits = [
        float(np.median(np.abs(others_s[k] - starts_s - offset)))
        for k, offset in zip(nearest, offsets, strict=True)
    ]
    return np.asarray(others_s[nearest[int(np.argmin(misfits))]] - starts_s, dtype=np.float64)


def _shift_begins(starts_s: FloatArray, shifts_s: FloatArray) -> FloatArray:
    """Return the time from which each move has its shift, shape of `starts_s`.

    With the shift of the move before, the simulation can start this move earlier than the recording
    does. Therefore the shift changes before both starts.

    Args:
        starts_s: of the moves of one axis in the recording, increasing.
        shifts_s: start in the simulation minus start in the recording.
    """
    earlier_s = np.minimum(np.diff(shifts_s, prepend=shifts_s[0]), 0.0)
    return np.asarray(np.maximum.accumulate(starts_s + earlier_s - LEAD_S), dtype=np.float64)


def _nearest(times_s: FloatArray, others_s: FloatArray) -> IntArray:
    """Return the index of the nearest of increasing times, for each of some times."""
    after = np.clip(np.searchsorted(others_s, times_s), 1, max(others_s.size - 1, 1))
    before = after - 1
    after = np.minimum(after, others_s.size - 1)
    is_before = times_s - others_s[before] <= others_s[after] - times_s
    return np.where(is_before, before, after)


def _own_block_means(session: ObservedSession, rates: FloatArray, numbers: IntArray) -> FloatArray:
    """Return the block means of the noise-free rates at the session's samples."""
    first = int(np.searchsorted(session.samples.time_s, session.time_s[0]))
    begin = int(numbers[first])
    return session.block_means(rates[begin : begin + session.time_s.size])


def _approximate_gain(session: ObservedSession, rates: FloatArray) -> FloatArray:
    """Return the gain from means of the stage rate and the sensor's rate, shape (3, 3).

    It only separates pan from tilt, for shifts of milliseconds; 1 % is enough.
    """
    size = max(1, round(GAIN_BLOCK_S * session.sampling.rate_hz))
    rows = session.block_count // size
    stage, sensor = (
        values[: rows * size].reshape(rows, size, 3).mean(axis=1)
        for values in (session.stage_rate_rad_s, rates)
    )
    stage, sensor = stage - stage.mean(axis=0), sensor - sensor.mean(axis=0)
    moments = stage.T @ stage
    weak = np.trace(moments) * 1e-6 + 1e-12
    # Without motion in a direction, the gain in this direction is 1.
    return np.asarray(
        np.linalg.solve(moments + weak * np.eye(3), stage.T @ sensor + weak * np.eye(3)).T
    )
