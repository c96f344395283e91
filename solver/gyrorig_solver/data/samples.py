"""Gyro samples of one board on the capture clock, on a uniform grid of sample numbers.

What to use when: `load_samples` for a board of a recording. Use `rate_rad_s` and similar fields
for short recordings, and `gyro.counts` with `gyro.scale` (or `gyro.values(rows)`) for
recordings of hours; see `GyroSamples`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.imu_columns import ImuColumns
from gyrorig_protocol.recording.messages import ImuStatus
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_protocol.suggestions import list_closest
from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.clocks import ClockMap, map_clock
from gyrorig_solver.data.clocks.clock_faults import CounterArray
from gyrorig_solver.data.clocks.counted_samples import has_shared_times, map_sample_counter
from gyrorig_solver.data.clocks.even_times import evenly_spaced
from gyrorig_solver.data.clocks.latency_bounds import (
    LatencyBounds,
    NearestSamples,
    PingExchanges,
    estimate_latency_bounds,
    ping_reception_times,
)
from gyrorig_solver.data.clocks.sample_numbering import number_samples
from gyrorig_solver.data.clocks.shared_time_base import ClockExchanges
from gyrorig_solver.data.clocks.stalled_arrivals import times_without_stalls
from gyrorig_solver.data.clocks.tick_unwrapping import PIECE_SAMPLES
from gyrorig_solver.data.count_columns import CountArray, CountColumn, PhysicalField, stored_column
from gyrorig_solver.data.link_remedies import FILE_LINK, NO_SAMPLE_RATE, NO_SAMPLES
from gyrorig_solver.data.metadata_numbers import positive_number
from gyrorig_solver.data.pauses import count_pauses

UNUSABLE_STATUS = int(ImuStatus.SATURATED | ImuStatus.REPEATED)
_MIN_PERIOD_S, _MAX_PERIOD_S = 1e-6, 1e4  # of the samples of any gyroscope
FULL_SCALE_CODE = 32767  # a 16-bit sensor at full scale, even if its status bit is not set


@dataclass(frozen=True, eq=False, kw_only=True)
class GyroSamples:
    """The samples of one board in one recording. Times in s since `origin_ns`.

    Rates, accelerations and temperatures stay counts until they are requested. `rate_rad_s`
    converts all rates at once, 24 bytes per sample; `gyro.counts` needs 6 bytes per sample,
    and `gyro.values(rows)` converts some rows. Arrival times and accelerations are read from
    the file at their first use.
    """

    board: str
    metadata: Mapping[str, str]
    origin_ns: int
    time_s: FloatArray  # (n,), not decreasing inside a segment
    host_s: PhysicalField[FloatArray] = PhysicalField()  # noqa: RUF009 - a descriptor; (n,), arrival
    number: CounterArray  # (n,), sample count since the first of the segment, with gaps
    segment: IntArray  # (n,), counts restarts of the board, clock steps and pauses of a log
    # (n, 3), counts times nominal scale, sensor frame
    rate_rad_s: PhysicalField[FloatArray] = PhysicalField()  # noqa: RUF009
    usable: BoolArray  # (n,), False if saturated or repeated
    # (n, 3), nan if a sample has none
    accel_m_s2: PhysicalField[FloatArray | None] = PhysicalField()  # noqa: RUF009
    # (n,), nan if a sample has none
    temperature_degc: PhysicalField[FloatArray | None] = PhysicalField()  # noqa: RUF009
    quantum_rad_s: float  # step to which the rates are rounded: a count, or more in an import
    clock: ClockMap  # of the kept samples; its times are `time_s`
    latency_bounds: LatencyBounds | None  # of the link, subtracted from `time_s` if known
    lost: int  # missing by the board's counter
    repeated: int
    late: int
    exchanges: ClockExchanges | None = None  # clock requests of the host; None after a clock reset

    @property
    def link(self) -> str:
        """The way on which the samples arrived: `serial`, `can`, or `file` if imported."""
        return self.metadata.get("link", "serial")

    @property
    def is_imported(self) -> bool:
        """Whether another program recorded the samples, so that no host checked their times."""
        return self.link == FILE_LINK

    @property
    def gyro(self) -> CountColumn:
        """The rates as counts, with `scale` in rad/s; 16-bit counts if they fit."""
        column = stored_column(self, "rate_rad_s")
        if column is None:
            raise AssertionError("samples without rates")
        return column

    @property
    def counts(self) -> CountArray:
        """The rates as sent, shape (n, 3)."""
        return self.gyro.counts

    @property
    def temperature(self) -> CountColumn | None:
        """The temperatures as counts, None without temperatures."""
        return stored_column(self, "temperature_degc")

    @property
    def has_absolute_temperature(self) -> bool:
        """Whether the temperatures are in degC, not relative to an unknown zero."""
        return "temperature_offset_c" in self.metadata

    @property
    def period_s(self) -> float:
        """The sample period of the longest segment, on the capture clock."""
        edges = np.searchsorted(self.segment, np.arange(int(self.segment[-1]) + 2))
        longest = int(np.argmax(np.diff(edges)))
        first, last = edges[longest], edges[longest + 1] - 1
        periods = int(self.number[last]) - int(self.number[first])
        return float((self.time_s[last] - self.time_s[first]) / max(1, periods))

    def contiguous_slices(self, longest_gap: int) -> list[slice]:
        """Return the slices without a longer gap, each inside one segment.

        The rows are compared in pieces: all at once takes 500 MB for 8 h at 800 Hz.

        Args:
            longest_gap: largest step of the sample number inside a slice.
        """
        size = self.number.size
        bounds = [0]
        for start in range(0, size - 1, PIECE_SAMPLES):
            rows = slice(start, start + PIECE_SAMPLES + 1)
            is_boundary = np.diff(self.number[rows].astype(np.int64)) > longest_gap
            is_boundary |= self.segment[rows][1:] != self.segment[rows][:-1]
            bounds += (start + 1 + np.flatnonzero(is_boundary)).tolist()
        return [slice(a, b) for a, b in pairwise([*bounds, size])]

    @property
    def bandwidth_hz(self) -> float | None:
        """The configured low-pass bandwidth, None if the recording does not specify it."""
        return positive_number(self.metadata, "bandwidth_hz")


def mean_temperature_degc(samples: Sequence[GyroSamples]) -> float | None:
    """Return the mean temperature of the recordings of a board, None without temperatures."""
    temperatures = [s.temperature_degc for s in samples]
    valid = [t[np.isfinite(t)] for t in temperatures if t is not None]
    return float(np.mean(np.concatenate(valid))) if any(t.size for t in valid) else None


def load_samples(recording: Recording, board: str) -> GyroSamples:
    """Return the samples of one board with their times on the capture clock.

    Raises:
        InputError: the board is not in the recording, has too few samples, or has no nominal
            scale in its metadata.
    """
    if board not in recording.board_ids:
        board_names = list_closest(board, recording.board_ids) or "none"
        raise InputError(
            f"the recording {recording.path.name} does not contain board {board!r}",
            f"choose one of its boards: {board_names}",
        )
    metadata = recording.metadata.get(f"gyrorig.board.{board}", {})
    scale = positive_number(metadata, "gyro_scale_rad_s")
    if scale is None:
        raise InputError(
            f"the recording {recording.path.name} does not contain the nominal scale factor "
            f"of board {board}",
            "add `gyro_scale_rad_s` of the board to the rig file or the import map, and "
            "record or import again",
        )
    raw = recording.imu_columns(BoardId(board))
    if raw.sequence.size < 16:
        raise InputError(
            f"board {board} has only {raw.sequence.size} samples in the recording, but the "
            "solver needs at least 16",
            NO_SAMPLES.for_link(metadata.get("link", "")),
        )
    origin_ns = int(raw.host_time_ns[0])
    host_s = _seconds_in_place(raw.host_time_ns, origin_ns)
    # the sample counter of an imported recording has no wraps
    sequence_bits = 32 if metadata.get("link") == FILE_LINK else None
    counts_samples = has_shared_times(raw.device_time, raw.sequence)
    pings = None if counts_samples else _read_pings(recording, board, origin_ns)
    nearest_samples = NearestSamples.of(pings, raw.device_time, host_s) if pings else None
    clock = (
        map_sample_counter(raw.sequence, host_s, sequence_bits)
        if counts_samples
        else _map_board_clock(raw.device_time, host_s, raw.sequence, metadata, sequence_bits)
    )
    if sequence_bits is not None:
        segment = count_pauses(clock.time_s, raw.sequence, clock.segment)
        clock = replace(clock, segment=segment)
    latency_bounds = _read_latency_bounds(pings, nearest_samples, clock, metadata)
    numbering = number_samples(
        raw.sequence, clock.time_s, clock.segment, sequence_bits=sequence_bits, overwrite=True
    )
    _subtract_latency(clock.time_s, latency_bounds)
    exchanges = _clock_exchanges(pings, nearest_samples, clock, metadata, origin_ns)
    late = int(np.count_nonzero(clock.late))
    keep, repeated_numbers, sample_number = numbering.keep_mask, 0, numbering.numbers
    if keep is not None:
        repeated_numbers = int(np.count_nonzero(~keep & ~clock.late))
        sample_number = sample_number[keep]
        clock = replace(
            clock,
            time_s=clock.time_s[keep],
            segment=clock.segment[keep],
            late=clock.late[keep],
        )
        for name in ("status", "temperature", "gyro"):
            setattr(raw, name, getattr(raw, name)[keep])
    good = _usable_samples(raw)
    repeated, accel_valid = (
        _count_status(raw.status, bit) for bit in (ImuStatus.REPEATED, ImuStatus.ACCEL_VALID)
    )
    accel_scale = positive_number(metadata, "accel_scale_m_s2")
    accel = None
    if accel_scale and accel_valid > 0.5 * good.size:
        accel = CountColumn(
            _LazyField(recording, board, "accel", keep),
            accel_scale,
            valid=_valid_rows(raw.status, ImuStatus.ACCEL_VALID),
        )
    samples = GyroSamples(
        board=board,
        metadata=metadata,
        origin_ns=origin_ns,
        time_s=clock.time_s,
        host_s=CountColumn(_LazyField(recording, board, "host_time", keep, origin_ns), 1e-9),
        number=sample_number,
        segment=clock.segment,
        rate_rad_s=CountColumn(raw.gyro, scale),
        usable=good,
        accel_m_s2=accel,
        temperature_degc=_temperature_column(raw, metadata),
        quantum_rad_s=max(scale, positive_number(metadata, "gyro_rounding_rad_s") or 0.0),
        clock=clock,
        latency_bounds=latency_bounds,
        lost=numbering.lost,
        repeated=repeated + repeated_numbers,
        late=late,
        exchanges=exchanges,
    )
    if not _MIN_PERIOD_S <= samples.period_s <= _MAX_PERIOD_S:
        raise InputError(
            f"the timestamps of board {board} in the recording {recording.path.name} do not give "
            "a sample rate",
            NO_SAMPLE_RATE.for_link(samples.link),
        )
    return samples


def _seconds_in_place(time_ns: IntArray, origin_ns: int) -> FloatArray:
    """Return times in s since the origin, stored in the memory of the times in ns."""
    time_s: FloatArray = time_ns.view(np.float64)
    for start in range(0, time_ns.size, PIECE_SAMPLES):
        rows = slice(start, start + PIECE_SAMPLES)
        time_s[rows] = (time_ns[rows] - origin_ns) * 1e-9
    return time_s


def _map_board_clock(
    ticks: IntArray,
    host_s: FloatArray,
    sequence: CounterArray,
    metadata: Mapping[str, str],
    sequence_bits: int | None,
) -> ClockMap:
    """Map device time; a source with one time column uses it for both clocks, in ns."""
    tick_hz = positive_number(metadata, "tick_hz")
    is_imported = metadata.get("link") == FILE_LINK
    if tick_hz is None or (is_imported and not np.any(np.diff(ticks))):
        times_s = (
            host_s
            if is_imported
            else evenly_spaced(sequence, times_without_stalls(sequence, host_s))
        )
        ticks, tick_hz = np.rint(times_s * 1e9).astype(np.int64), 1e9
    bits = int(positive_number(metadata, "counter_bits") or 64)
    return map_clock(
        ticks, host_s, tick_hz, bits, sequence, sequence_bits=sequence_bits, overwrite=True
    )


def _read_pings(recording: Recording, board: str, origin_ns: int) -> PingExchanges | None:
    raw = recording.clock_pings(BoardId(board))
    if not raw.size:
        return None
    return PingExchanges(
        host_send_s=np.asarray((times_ns(raw["host_send"]) - origin_ns) * 1e-9, np.float64),
        host_receive_s=np.asarray((times_ns(raw["host_receive"]) - origin_ns) * 1e-9, np.float64),
        device_receive=raw["device_receive"].astype(np.int64),
        device_send=raw["device_send"].astype(np.int64),
    )


def _read_latency_bounds(
    pings: PingExchanges | None,
    nearest_samples: NearestSamples | None,
    clock: ClockMap,
    metadata: Mapping[str, str],
) -> LatencyBounds | None:
    """Return the bounds of the link's minimum latency from the pings."""
    tick_hz = positive_number(metadata, "tick_hz")
    if tick_hz is None or pings is None or nearest_samples is None:
        return None
    bits = int(positive_number(metadata, "counter_bits") or 64)
    return estimate_latency_bounds(pings, nearest_samples, clock, tick_hz, bits)


def _clock_exchanges(
    pings: PingExchanges | None,
    nearest_samples: NearestSamples | None,
    clock: ClockMap,
    metadata: Mapping[str, str],
    origin_ns: int,
) -> ClockExchanges | None:
    """Return the reception times of the pings, on the time base of the samples."""
    tick_hz = positive_number(metadata, "tick_hz")
    if tick_hz is None or pings is None or nearest_samples is None or clock.segment_count != 1:
        return None
    bits = int(positive_number(metadata, "counter_bits") or 64)
    dated, time_s = ping_reception_times(pings, nearest_samples, clock, tick_hz, bits)
    asked_ns = np.rint(pings.host_send_s[dated] * 1e9).astype(np.int64) + origin_ns
    return ClockExchanges(asked_ns, time_s, origin_ns)


def _subtract_latency(time_s: FloatArray, latency_bounds: LatencyBounds | None) -> None:
    """Subtract the minimum latency from the times, in place."""
    if latency_bounds is not None:
        for start in range(0, time_s.size, PIECE_SAMPLES):
            piece = time_s[start : start + PIECE_SAMPLES]
            piece -= latency_bounds.midpoint_at(piece)


def _usable_samples(raw: ImuColumns) -> BoolArray:
    """Return the mask of samples that are neither saturated nor repeated."""
    good = np.empty(raw.status.size, dtype=np.bool_)
    wider_than_16_bits = raw.gyro.dtype != np.int16
    sixteen_bit = not wider_than_16_bits or int(np.abs(raw.gyro).max()) <= FULL_SCALE_CODE + 1
    for start in range(0, good.size, PIECE_SAMPLES):
        rows = slice(start, start + PIECE_SAMPLES)
        good[rows] = raw.status[rows] & UNUSABLE_STATUS == 0
        gyro = raw.gyro[rows]
        if sixteen_bit and (
            int(gyro.max()) >= FULL_SCALE_CODE or int(gyro.min()) <= -FULL_SCALE_CODE
        ):
            good[rows] &= ((gyro < FULL_SCALE_CODE) & (gyro > -FULL_SCALE_CODE)).all(axis=1)
    return good


def _count_status(status: CounterArray, bit: int) -> int:
    pieces = (
        status[start : start + PIECE_SAMPLES] for start in range(0, status.size, PIECE_SAMPLES)
    )
    return sum(int(np.count_nonzero(piece & int(bit))) for piece in pieces)


@dataclass(frozen=True, slots=True, eq=False)
class _LazyField:
    """Reads one field of the samples at its first use."""

    recording: Recording
    board: str
    name: str
    keep: BoolArray | None
    zero_value: int = 0  # subtracted from the values

    def __call__(self) -> CountArray:
        values = self.recording.imu_field(BoardId(self.board), self.name)
        values -= values.dtype.type(self.zero_value)
        return values if self.keep is None else values[self.keep]


def _temperature_column(raw: ImuColumns, metadata: Mapping[str, str]) -> CountColumn | None:
    """Return the temperatures in degC, if the recording specifies their scale.

    Without an offset only differences are valid; then `has_absolute_temperature` is False.
    """
    try:
        scale = float(metadata["temperature_scale_c"])
        offset = float(metadata.get("temperature_offset_c", "0.0"))
    except (KeyError, ValueError):
        return None
    if not (np.isfinite(scale) and np.isfinite(offset)):
        return None
    if not _count_status(raw.status, ImuStatus.TEMPERATURE_VALID):
        return None
    valid = _valid_rows(raw.status, ImuStatus.TEMPERATURE_VALID)
    return CountColumn(raw.temperature, scale, offset, valid)


def _valid_rows(status: CounterArray, bit: int) -> BoolArray | None:
    """Return the mask of the samples with a status bit, None if all have it."""
    if _count_status(status, bit) == status.size:
        return None
    return np.asarray(status & int(bit) != 0)
