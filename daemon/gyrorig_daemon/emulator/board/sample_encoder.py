"""Encoder of the emulated firmware's samples, alone or in batches; and faults of the line.

Temperatures. A sample contains the BMP085's air temperature in 0.1 degC. SLOW also contains the
gyro's OUT_TEMP, which decreases by one count per degree (L3G4200D) from an arbitrary zero.
"""

import hashlib
from dataclasses import dataclass

from gyrorig_daemon.emulator.board.emulated_protocol import find_emulated_protocol
from gyrorig_daemon.emulator.emulator_settings import BoardFaults, BoardSettings
from gyrorig_daemon.emulator.physics.imu import SampleBlock
from gyrorig_protocol.board.board_frames import Batch, Sample, SampleFlag, Triple

Frame = tuple[int, bytes]  # ready_ns, bytes

_OUT_TEMP_ZERO_DEGC = 50.0
_SATURATED = int(SampleFlag.SATURATED)  # combining enum flags takes 1 us each


def out_temp_raw(temperature_degc: float) -> int:
    """Return the gyro's OUT_TEMP: -1 degC per count."""
    return round(_OUT_TEMP_ZERO_DEGC - temperature_degc)


def bmp085_raw(temperature_degc: float) -> int:
    """Return the pressure sensor's temperature in 0.1 degC."""
    return round(temperature_degc * 10.0)


@dataclass(frozen=True, slots=True)
class SampleRows:
    """The samples of a block as plain numbers, because numpy takes long for one row."""

    gyro: list[Triple]
    accel: list[Triple]
    temperature_degc: list[float]
    saturated: list[bool]


def sample_rows(block: SampleBlock) -> SampleRows:
    """Return the samples of a block as plain numbers."""
    return SampleRows(
        [(x, y, z) for x, y, z in block.gyro.tolist()],
        [(x, y, z) for x, y, z in block.accel.tolist()],
        block.temperature_degc.tolist(),
        block.saturated.tolist(),
    )


class SampleEncoder:
    """Encodes samples by a configuration."""

    def __init__(self, settings: BoardSettings, changed: bool) -> None:
        """`changed` flags every sample as taken after a change of the configuration."""
        self._settings = settings
        self._flags = int(SampleFlag.STAMPED_AT_DATA_READY)
        if changed:
            self._flags |= int(SampleFlag.CONFIGURATION_CHANGED)
        self._protocol = find_emulated_protocol(settings.format)
        self.samples_per_frame = settings.batch if self._protocol.has_batches else 1

    def encode(self, rows: SampleRows, first: int, count: int, sequence: int, stamp: int) -> bytes:
        """Return the bytes of `count` samples of a block from its row `first` on.

        Args:
            rows: raw counts.
            first: row of the first sample.
            count: how many.
            sequence: number of the first sample, not wrapped.
            stamp: board ticks of the last sample, not wrapped.
        """
        end = first + count
        temperature = bmp085_raw(rows.temperature_degc[end - 1])
        gyro = rows.gyro[first:end]
        accel = rows.accel[first:end] if self._settings.accel else None
        ticks = stamp & 0xFFFF_FFFF
        flags = self._flags
        if any(rows.saturated[first:end]):
            flags |= _SATURATED
        number = sequence & 0xFFFF
        frame: Batch | Sample
        if self.samples_per_frame > 1:
            accel_rows = tuple(accel) if accel else None
            frame = Batch(flags, number, ticks, tuple(gyro), accel_rows, temperature)
        else:
            frame = Sample(flags, number, ticks, gyro[0], accel[0] if accel else None, temperature)
        return self._protocol.encode(frame, self._settings)


def inject_line_faults(faults: BoardFaults, first: int, frames: list[Frame]) -> list[Frame]:
    """Return frames as a faulty line delivers them.

    Args:
        faults: kinds and periods.
        first: number of the first frame since power-up, from 1.
        frames: in order.
    """
    result: list[Frame] = []
    for number, (ready_ns, data) in enumerate(frames, first):
        if faults.garbage:
            result.append((ready_ns, pseudo_random_bytes(number, len(data))))
            continue
        data_sent = data
        if _is_nth(faults.flip_bit_every, number):
            bit = number * 2654435761 % (len(data) * 8)
            flipped = bytearray(data)
            flipped[bit // 8] ^= 1 << bit % 8
            data_sent = bytes(flipped)
        if _is_nth(faults.garbage_every, number):
            data_sent = pseudo_random_bytes(number, 9) + data_sent
        if _is_nth(faults.swap_frames_every, number) and result:
            previous_ns, previous = result[-1]
            result[-1] = (previous_ns, data_sent)
            data_sent = previous
        if not _is_nth(faults.drop_frame_every, number):
            result.append((ready_ns, data_sent))
        if _is_nth(faults.duplicate_frame_every, number):
            result.append((ready_ns, data_sent))
    return result


def pseudo_random_bytes(number: int, size: int) -> bytes:
    """Return pseudo-random bytes, reproducible by number."""
    return hashlib.shake_128(number.to_bytes(8, "little")).digest(size)


def _is_nth(period: int, number: int) -> bool:
    return period > 0 and number % period == 0
