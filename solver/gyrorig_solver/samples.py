"""One board's gyro samples on the capture clock, on a uniform grid of sample numbers.

What to use when: `load_samples` for a board of a recording. Of the samples, use
`rate_rad_s` and the like where recordings are short, and `gyro.counts` with `gyro.scale`
(or `gyro.values(rows)`) where hours must fit: see `GyroSamples`.
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
from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.clocks import ClockMap, map_clock
from gyrorig_solver.clocks.faults import CounterArray
from gyrorig_solver.clocks.numbering import number_samples
from gyrorig_solver.clocks.pings import LinkFloor, Nearest, Pings, asked_s, floor_of
from gyrorig_solver.clocks.shared import Exchanges
from gyrorig_solver.clocks.unwrap import PIECE
from gyrorig_solver.columns import Column, CountArray, Physical, column_of

NOT_GOOD = int(ImuStatus.SATURATED | ImuStatus.REPEATED)
FULL_CODE = 32767  # a 16-bit part at the end of its range, whatever its status bit says


@dataclass(frozen=True, eq=False, kw_only=True)
class GyroSamples:
    """What one recording holds of one board. Times in s since `origin_ns`.

    A loaded recording's rates, accelerations and temperatures stay counts until they are
    asked for. `rate_rad_s` makes all of them at once, 24 bytes a sample; `gyro.counts` are
    there already, at 6 bytes a sample, and `gyro.values(rows)` makes some. Arrivals and
    accelerations are read from the file when they are first asked for.
    """

    board: str
    metadata: Mapping[str, str]
    origin_ns: int
    time_s: FloatArray  # (n,), not decreasing inside a segment
    host_s: Physical[FloatArray] = Physical()  # noqa: RUF009 - a descriptor; (n,), arrival
    number: CounterArray  # (n,), sample count since the segment's first, gaps left open
    segment: IntArray  # (n,), counts restarts of the board and steps of its clock
    # (n, 3), counts times nominal scale, sensor frame
    rate_rad_s: Physical[FloatArray] = Physical()  # noqa: RUF009
    good: BoolArray  # (n,), False where saturated or repeated
    accel_m_s2: Physical[FloatArray | None] = Physical()  # noqa: RUF009 - (n, 3)
    # (n,), nan where a sample has none
    temperature_degc: Physical[FloatArray | None] = Physical()  # noqa: RUF009
    quantum_rad_s: float
    clock: ClockMap  # its arrays are those of the samples kept, its times `time_s`
    floor: LinkFloor | None  # the link's least latency, taken out of `time_s` where known
    lost: int  # missing by the board's own counter
    repeated: int
    late: int
    exchanges: Exchanges | None = None  # with the host; None where the clock began anew

    @property
    def gyro(self) -> Column:
        """The rates as counts, rad/s in `scale`; counts of 16 bits where they fit."""
        found = column_of(self, "rate_rad_s")
        if found is None:
            raise AssertionError("samples without rates")
        return found

    @property
    def counts(self) -> CountArray:
        """The rates as sent, shape (n, 3)."""
        return self.gyro.counts

    @property
    def temperature(self) -> Column | None:
        """The temperatures as counts, None where there are none."""
        return column_of(self, "temperature_degc")

    @property
    def absolute_degc(self) -> bool:
        """Whether the temperatures count from 0 degC, not only from each other."""
        return "temperature_offset_c" in self.metadata

    @property
    def period_s(self) -> float:
        """The sample period by the capture clock, the longest segment's."""
        edges = np.searchsorted(self.segment, np.arange(int(self.segment[-1]) + 2))
        best = int(np.argmax(np.diff(edges)))
        first, last = edges[best], edges[best + 1] - 1
        passed = int(self.number[last]) - int(self.number[first])
        return float((self.time_s[last] - self.time_s[first]) / max(1, passed))

    def stretches(self, longest_gap: int) -> list[slice]:
        """Return the stretches of one segment in which no more samples are missing in a row.

        Found piece by piece: a comparison of all neighbours at once takes 500 MB with 8 h
        at 800 Hz.

        Args:
            longest_gap: steps of the sample number that do not end a stretch.
        """
        size = self.number.size
        bounds = [0]
        for start in range(0, size - 1, PIECE):
            rows = slice(start, start + PIECE + 1)
            cut = np.diff(self.number[rows].astype(np.int64)) > longest_gap
            cut |= self.segment[rows][1:] != self.segment[rows][:-1]
            bounds += (start + 1 + np.flatnonzero(cut)).tolist()
        return [slice(a, b) for a, b in pairwise([*bounds, size])]

    @property
    def bandwidth_hz(self) -> float | None:
        """The configured low-pass, None where the recording does not say."""
        return number(self.metadata, "bandwidth_hz")


def mean_degc(samples: Sequence[GyroSamples]) -> float | None:
    """Return the mean temperature of one board's recordings, None where none has any."""
    there = [s.temperature_degc for s in samples]
    known = [t[np.isfinite(t)] for t in there if t is not None]
    return float(np.mean(np.concatenate(known))) if any(t.size for t in known) else None


def number(metadata: Mapping[str, str], key: str) -> float | None:
    """Return a metadata entry as a positive finite number, None where there is none.

    Raises:
        InputError: the entry is there and is no such number.
    """
    text = metadata.get(key)
    if text is None or text == "":
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or value <= 0.0:
        raise InputError(
            f"the recording says {key} {text[:40]!r}, which is no positive number",
            "correct it in the rig file, or the map of gyrorig import, and make it again",
        )
    return value


def load_samples(recording: Recording, board: str) -> GyroSamples:
    """Return one board's samples with their times on the capture clock.

    Raises:
        InputError: the board is not in the recording, has too few samples, or its
            metadata lack the nominal scale.
    """
    if board not in recording.board_ids:
        there = ", ".join(recording.board_ids) or "none"
        raise InputError(
            f"no board {board!r} in {recording.path.name}", f"name one that is in it: {there}"
        )
    metadata = recording.metadata.get(f"gyrorig.board.{board}", {})
    scale = number(metadata, "gyro_scale_rad_s")
    if scale is None:
        raise InputError(
            f"{recording.path.name} does not say what a count of {board} is worth",
            "record or import it again with gyro_scale_rad_s among the board's facts",
        )
    raw = recording.imu_columns(BoardId(board))
    if raw.sequence.size < 16:
        raise InputError(
            f"board {board} has {raw.sequence.size} samples, and 16 are the least",
            "record for longer; `gyrorigd doctor` says whether it sends",
        )
    origin_ns = int(raw.host_time_ns[0])
    host_s = _seconds(raw.host_time_ns, origin_ns)
    pings = _pings(recording, board, origin_ns)
    nearest = Nearest.of(pings, raw.device_time, host_s) if pings else None
    clock = _clock(raw.device_time, host_s, raw.sequence, metadata)
    floor = _floor(pings, nearest, clock, metadata)
    numbered = number_samples(raw.sequence, clock.time_s, clock.segment, overwrite=True)
    _take_off(clock.time_s, floor)
    exchanges = _exchanges(pings, nearest, clock, metadata, origin_ns)
    late = int(np.count_nonzero(clock.late))
    keep, twice, sample_number = numbered.keep, 0, numbered.number
    if keep is not None:
        twice = int(np.count_nonzero(~keep & ~clock.late))
        sample_number = sample_number[keep]
        clock = replace(
            clock,
            time_s=clock.time_s[keep],
            segment=clock.segment[keep],
            late=clock.late[keep],
        )
        for name in ("status", "temperature", "gyro"):
            setattr(raw, name, getattr(raw, name)[keep])
    good = _good(raw)
    repeated, accel_valid = (
        _count(raw.status, bit) for bit in (ImuStatus.REPEATED, ImuStatus.ACCEL_VALID)
    )
    accel_scale = number(metadata, "accel_scale_m_s2")
    accel = None
    if accel_scale and accel_valid > 0.5 * good.size:
        accel = Column(_Later(recording, board, "accel", keep), accel_scale)
    return GyroSamples(
        board=board,
        metadata=metadata,
        origin_ns=origin_ns,
        time_s=clock.time_s,
        host_s=Column(_Later(recording, board, "host_time", keep, origin_ns), 1e-9),
        number=sample_number,
        segment=clock.segment,
        rate_rad_s=Column(raw.gyro, scale),
        good=good,
        accel_m_s2=accel,
        temperature_degc=_temperature(raw, metadata),
        quantum_rad_s=scale,
        clock=clock,
        floor=floor,
        lost=numbered.lost,
        repeated=repeated + twice,
        late=late,
        exchanges=exchanges,
    )


def _seconds(time_ns: IntArray, origin_ns: int) -> FloatArray:
    """Return times in s since the origin, in the memory of the times in ns."""
    time_s: FloatArray = time_ns.view(np.float64)
    for start in range(0, time_ns.size, PIECE):
        rows = slice(start, start + PIECE)
        time_s[rows] = (time_ns[rows] - origin_ns) * 1e-9
    return time_s


def _clock(
    ticks: IntArray, host_s: FloatArray, sequence: CounterArray, metadata: Mapping[str, str]
) -> ClockMap:
    """Map device time; a source with one time column has it as both, in nanoseconds."""
    tick_hz = number(metadata, "tick_hz")
    if tick_hz is None or (metadata.get("link") == "file" and not np.any(np.diff(ticks))):
        ticks, tick_hz = np.rint(host_s * 1e9).astype(np.int64), 1e9
    bits = int(number(metadata, "counter_bits") or 64)
    return map_clock(ticks, host_s, tick_hz, bits, sequence, overwrite=True)


def _pings(recording: Recording, board: str, origin_ns: int) -> Pings | None:
    """Return the board's clock exchanges, None without any."""
    raw = recording.clock_pings(BoardId(board))
    if not raw.size:
        return None
    return Pings(
        host_send_s=np.asarray((times_ns(raw["host_send"]) - origin_ns) * 1e-9, np.float64),
        host_receive_s=np.asarray((times_ns(raw["host_receive"]) - origin_ns) * 1e-9, np.float64),
        device_receive=raw["device_receive"].astype(np.int64),
        device_send=raw["device_send"].astype(np.int64),
    )


def _floor(
    pings: Pings | None, nearest: Nearest | None, clock: ClockMap, metadata: Mapping[str, str]
) -> LinkFloor | None:
    """Return what the board's pings say of the link's least latency."""
    tick_hz = number(metadata, "tick_hz")
    if tick_hz is None or pings is None or nearest is None:
        return None
    bits = int(number(metadata, "counter_bits") or 64)
    return floor_of(pings, nearest, clock, tick_hz, bits)


def _exchanges(
    pings: Pings | None,
    nearest: Nearest | None,
    clock: ClockMap,
    metadata: Mapping[str, str],
    origin_ns: int,
) -> Exchanges | None:
    """Return when the board took its pings, by the times of its samples."""
    tick_hz = number(metadata, "tick_hz")
    if tick_hz is None or pings is None or nearest is None or clock.segments != 1:
        return None
    bits = int(number(metadata, "counter_bits") or 64)
    known, time_s = asked_s(pings, nearest, clock, tick_hz, bits)
    asked_ns = np.rint(pings.host_send_s[known] * 1e9).astype(np.int64) + origin_ns
    return Exchanges(asked_ns, time_s, origin_ns)


def _take_off(time_s: FloatArray, floor: LinkFloor | None) -> None:
    """Make times of arrivals' floors times of samples, in place."""
    if floor is not None:
        for start in range(0, time_s.size, PIECE):
            piece = time_s[start : start + PIECE]
            piece -= floor.middle_at(piece)


def _good(raw: ImuColumns) -> BoolArray:
    """Return which samples are neither saturated nor repeated."""
    good = np.empty(raw.status.size, dtype=np.bool_)
    wide = raw.gyro.dtype != np.int16
    sixteen_bit = not wide or int(np.abs(raw.gyro).max()) <= FULL_CODE + 1
    for start in range(0, good.size, PIECE):
        rows = slice(start, start + PIECE)
        good[rows] = raw.status[rows] & NOT_GOOD == 0
        gyro = raw.gyro[rows]
        if sixteen_bit and (int(gyro.max()) >= FULL_CODE or int(gyro.min()) <= -FULL_CODE):
            good[rows] &= ((gyro < FULL_CODE) & (gyro > -FULL_CODE)).all(axis=1)
    return good


def _count(status: CounterArray, bit: int) -> int:
    """Return how many samples have a status bit."""
    pieces = (status[start : start + PIECE] for start in range(0, status.size, PIECE))
    return sum(int(np.count_nonzero(piece & int(bit))) for piece in pieces)


@dataclass(frozen=True, slots=True, eq=False)
class _Later:
    """Reads one field of a board's samples when it is asked for."""

    recording: Recording
    board: str
    name: str
    keep: BoolArray | None
    zero: int = 0  # what counts as 0

    def __call__(self) -> CountArray:
        found = self.recording.imu_field(BoardId(self.board), self.name)
        found -= found.dtype.type(self.zero)
        return found if self.keep is None else found[self.keep]


def _temperature(raw: ImuColumns, metadata: Mapping[str, str]) -> Column | None:
    """Return degrees Celsius where the recording says how to read the raw value.

    Without an offset they count from anywhere: differences hold, `absolute_degc` is False.
    """
    try:
        scale = float(metadata["temperature_scale_c"])
        offset = float(metadata.get("temperature_offset_c", "0.0"))
    except (KeyError, ValueError):
        return None
    if not (np.isfinite(scale) and np.isfinite(offset)):
        return None
    bit = int(ImuStatus.TEMPERATURE_VALID)
    there = _count(raw.status, bit)
    if not there:
        return None
    valid = None if there == raw.status.size else np.asarray(raw.status & bit != 0)
    return Column(raw.temperature, scale, offset, valid)
