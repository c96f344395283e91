"""One board's gyro samples on the capture clock, on a uniform grid of sample numbers."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import ImuStatus
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.clocks import ClockMap, map_clock
from gyrorig_solver.clocks.pings import LinkFloor, Pings, link_floor
from gyrorig_solver.clocks.unwrap import unwrap_sequence

NOT_GOOD = ImuStatus.SATURATED | ImuStatus.REPEATED
FULL_CODE = 32767  # a 16-bit part at the end of its range, whatever its status bit says


@dataclass(frozen=True, slots=True, eq=False)
class GyroSamples:
    """What one recording holds of one board. Times in s since `origin_ns`."""

    board: str
    metadata: Mapping[str, str]
    origin_ns: int
    time_s: FloatArray  # (n,), not decreasing inside a segment
    host_s: FloatArray  # (n,), arrival
    number: IntArray  # (n,), sample count since the segment's first, gaps left open
    segment: IntArray  # (n,), counts restarts of the board and steps of its clock
    rate_rad_s: FloatArray  # (n, 3), counts times nominal scale, sensor frame
    good: BoolArray  # (n,), False where saturated or repeated
    accel_m_s2: FloatArray | None  # (n, 3)
    temperature_degc: FloatArray | None  # (n,), nan where a sample has none
    quantum_rad_s: float
    clock: ClockMap
    floor: LinkFloor | None  # the link's least latency, taken out of `time_s` where known
    lost: int  # missing by the board's own counter
    repeated: int
    late: int

    @property
    def period_s(self) -> float:
        """The sample period by the capture clock, the longest segment's."""
        best = int(np.argmax(np.bincount(self.segment)))
        inside = self.segment == best
        t, k = self.time_s[inside], self.number[inside]
        return float((t[-1] - t[0]) / max(1, k[-1] - k[0]))

    @property
    def bandwidth_hz(self) -> float | None:
        """The configured low-pass, None where the recording does not say."""
        return number(self.metadata, "bandwidth_hz")


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
        raise InputError(f"metadata {key} is {text[:40]!r}", "it must be a positive number")
    return value


def load_samples(recording: Recording, board: str) -> GyroSamples:
    """Return one board's samples with their times on the capture clock.

    Raises:
        InputError: the board is not in the recording, has too few samples, or its
            metadata lack the nominal scale.
    """
    if board not in recording.board_ids:
        there = ", ".join(recording.board_ids) or "none"
        raise InputError(f"no board {board!r} in {recording.path.name}", f"boards in it: {there}")
    metadata = recording.metadata.get(f"gyrorig.board.{board}", {})
    scale = number(metadata, "gyro_scale_rad_s")
    if scale is None:
        raise InputError(
            f"board {board} has no gyro_scale_rad_s", "the scale of a count is unknown"
        )
    raw = recording.imu(BoardId(board))
    if raw.size < 16:
        raise InputError(f"board {board} has {raw.size} samples", "record for longer")
    host_ns = times_ns(raw["host_time"])
    origin_ns = int(host_ns[0])
    host_s: FloatArray = np.asarray((host_ns - origin_ns) * 1e-9, dtype=np.float64)
    sequence = raw["sequence"].astype(np.int64)
    clock = _clock(raw["device_time"].astype(np.int64), host_s, sequence, metadata)
    keep, numbers, lost = _numbers(sequence, clock)
    floor = _floor(recording, board, raw["device_time"].astype(np.int64), host_s, clock)
    raw, host_s = raw[keep], host_s[keep]
    gyro = raw["gyro"].astype(np.float64)
    status = raw["status"]
    sixteen_bit = np.abs(gyro).max() <= FULL_CODE + 1
    full = (np.abs(gyro).max(axis=1) >= FULL_CODE) if sixteen_bit else np.zeros(len(raw), np.bool_)
    accel_scale = number(metadata, "accel_scale_m_s2")
    has_accel = bool(np.mean(status & ImuStatus.ACCEL_VALID != 0) > 0.5)
    return GyroSamples(
        board=board,
        metadata=metadata,
        origin_ns=origin_ns,
        time_s=_from_floor(clock.time_s[keep], floor),
        host_s=host_s,
        number=numbers,
        segment=clock.segment[keep],
        rate_rad_s=gyro * scale,
        good=(status & NOT_GOOD == 0) & ~full,
        accel_m_s2=raw["accel"].astype(np.float64) * accel_scale
        if has_accel and accel_scale
        else None,
        temperature_degc=_temperature(raw["temperature"], status, metadata),
        quantum_rad_s=scale,
        clock=clock,
        floor=floor,
        lost=lost,
        repeated=int(np.sum(status & ImuStatus.REPEATED != 0)) + int(np.sum(~keep & ~clock.late)),
        late=int(np.sum(clock.late)),
    )


def _clock(
    ticks: IntArray, host_s: FloatArray, sequence: IntArray, metadata: Mapping[str, str]
) -> ClockMap:
    """Map device time; a source with one time column has it as both, in nanoseconds."""
    tick_hz = number(metadata, "tick_hz")
    if tick_hz is None or (metadata.get("link") == "file" and not np.any(np.diff(ticks))):
        ticks, tick_hz = np.rint(host_s * 1e9).astype(np.int64), 1e9
    bits = int(number(metadata, "counter_bits") or 64)
    return map_clock(ticks, host_s, tick_hz, bits, sequence)


def _floor(
    recording: Recording, board: str, ticks: IntArray, host_s: FloatArray, clock: ClockMap
) -> LinkFloor | None:
    """Return what the board's pings say of the link's least latency."""
    metadata = recording.metadata.get(f"gyrorig.board.{board}", {})
    tick_hz = number(metadata, "tick_hz")
    if tick_hz is None or f"/board/{board}/clock" not in recording.topics:
        return None
    raw = recording.clock_pings(BoardId(board))
    origin_ns = int(times_ns(recording.imu(BoardId(board))["host_time"])[0])
    pings = Pings(
        host_send_s=np.asarray((times_ns(raw["host_send"]) - origin_ns) * 1e-9, np.float64),
        host_receive_s=np.asarray((times_ns(raw["host_receive"]) - origin_ns) * 1e-9, np.float64),
        device_receive=raw["device_receive"].astype(np.int64),
        device_send=raw["device_send"].astype(np.int64),
    )
    bits = int(number(metadata, "counter_bits") or 64)
    return link_floor(pings, ticks, host_s, clock, tick_hz, bits)


def _from_floor(time_s: FloatArray, floor: LinkFloor | None) -> FloatArray:
    return time_s if floor is None else time_s - floor.middle_at(time_s)


def _numbers(sequence: IntArray, clock: ClockMap) -> tuple[BoolArray, IntArray, int]:
    """Return which samples to keep, their numbers, and how many are missing.

    Each segment is sorted by number; the same number twice is a repeat and the first
    stays. Where the counter stands still (a source without one) the order counts.
    """
    keep = np.ones(sequence.size, dtype=np.bool_)
    numbers = np.zeros(sequence.size, dtype=np.int64)
    lost = 0
    for k in range(clock.segments):
        inside = np.flatnonzero(clock.segment == k)
        period = float(np.median(np.diff(clock.time_s[inside]))) if inside.size > 1 else 1.0
        expected = (clock.time_s[inside] - clock.time_s[inside[0]]) / max(period, 1e-9)
        if inside.size > 1 and not np.any(np.diff(sequence[inside])):
            numbers[inside] = np.arange(inside.size)
            continue
        count = unwrap_sequence(sequence[inside], expected)
        _, first = np.unique(count, return_index=True)
        alone = np.zeros(inside.size, dtype=np.bool_)
        alone[first] = True
        in_order = alone & (count >= np.maximum.accumulate(np.where(alone, count, count.min())))
        keep[inside[~in_order]] = False
        numbers[inside] = count - count.min()
        lost += int(count.max() - count.min() + 1 - first.size)
    return keep, numbers[keep], lost


def _temperature(raw: IntArray, status: IntArray, metadata: Mapping[str, str]) -> FloatArray | None:
    """Return degrees Celsius where the recording says how to read the raw value."""
    try:
        scale = float(metadata["temperature_scale_c"])
        offset = float(metadata["temperature_offset_c"])
    except (KeyError, ValueError):
        return None
    if not (np.isfinite(scale) and np.isfinite(offset)):
        return None
    valid = status & ImuStatus.TEMPERATURE_VALID != 0
    if not valid.any():
        return None
    return np.where(valid, raw.astype(np.float64) * scale + offset, np.nan)
