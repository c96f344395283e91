"""Another maker's IMU on a CAN bus: it only sends, in the signals of its DBC file or preset."""

import math
import struct
from typing import Literal

import numpy as np

from gyrorig_daemon.emulator.board.emulated_can_board import EmulatedCanBoard
from gyrorig_daemon.emulator.board.sample_encoder import SampleEncoder, SampleRows
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_daemon.emulator.physics.imu import ImuTruth
from gyrorig_daemon.emulator.rig_truth import ACCEL_COUNTS_PER_G, DEG, mdps_per_count
from gyrorig_protocol.can import (
    CanFrame,
    FrameFlag,
    ResolvedSignalMap,
    pack_frames,
    resolve_signals,
)
from gyrorig_protocol.can.dbc import DbcSignal
from gyrorig_protocol.can.signal_map import ResolvedSignal
from gyrorig_protocol.errors import UsageError

STANDARD_GRAVITY_M_S2 = 9.80665  # CGPM 1901
_FRAME_BYTES = 8
_EXTENDED_BIT = 1 << 31
_US_PER_S = 1_000_000


class SignalEncoder(SampleEncoder):
    """Encodes one sample as the frames of a signal map, packed; those with rates are last."""

    def __init__(self, settings: BoardSettings, changed: bool, signal_map: ResolvedSignalMap):
        """Encode with a map."""
        super().__init__(settings, changed)
        self._map = signal_map
        rate_keys = {signal.key for signal in signal_map.gyro if signal is not None}
        self._keys = sorted(signal_map.needed_bytes, key=lambda key: key in rate_keys)
        self._gyro_rad_s = mdps_per_count(settings) * 1e-3 * DEG

    def encode(self, rows: SampleRows, first: int, count: int, sequence: int, stamp: int) -> bytes:
        """See `SampleEncoder.encode`."""
        del count
        signal_map = self._map
        payloads = {
            key: bytearray(max(_FRAME_BYTES, size)) for key, size in signal_map.needed_bytes.items()
        }
        for signal, value in zip(signal_map.gyro, rows.gyro[first], strict=True):
            counts = value * self._gyro_rad_s / signal_map.gyro_scale_rad_s
            _put_counts(payloads, signal, counts)
        if signal_map.accel is not None and signal_map.accel_scale_m_s2:
            per_count = STANDARD_GRAVITY_M_S2 / ACCEL_COUNTS_PER_G / signal_map.accel_scale_m_s2
            for signal, value in zip(signal_map.accel, rows.accel[first], strict=True):
                _put_counts(payloads, signal, value * per_count)
        if signal_map.temperature is not None and signal_map.temperature_scale_c:
            degc = rows.temperature_degc[first]
            _put_counts(payloads, signal_map.temperature, degc / signal_map.temperature_scale_c)
        if signal_map.time is not None and signal_map.tick_hz:
            ticks = round(stamp * signal_map.tick_hz / _US_PER_S)
            _put_unsigned(payloads, signal_map.time, ticks)
        if signal_map.counter is not None:
            _put_unsigned(payloads, signal_map.counter, sequence)
        return pack_frames([self._frame(key, bytes(payloads[key])) for key in self._keys])

    def _frame(self, key: int, data: bytes) -> CanFrame:
        address = self._map.source_address
        identifier = key & ~_EXTENDED_BIT
        if address is not None:
            identifier = identifier & ~0xFF | address
        return CanFrame(identifier, data, FrameFlag.EXTENDED if key & _EXTENDED_BIT else 0)


class EmulatedSignalBoard(EmulatedCanBoard):
    """An IMU with the physics of the emulated board, and the frames of a signal map."""

    protocol_name = "signals"

    def receive_frame(self, frame: CanFrame, edge_ns: int) -> None:
        """Ignore a frame: the IMU understands none."""

    def _configure(self, imu: ImuTruth, start_s: float, rng: np.random.Generator) -> None:
        super()._configure(imu, start_s, rng)
        signals = self.settings.signals
        if signals is None:
            raise UsageError(
                f"board {self.settings.name} has no signals", "add the key `signals` to the board"
            )
        signal_map = resolve_signals(signals, self.settings.name)
        self._encoder = SignalEncoder(self.settings, self._configuration_changed, signal_map)

    def _announce(self) -> None:
        """Send nothing but samples."""


CAN_BOARD = EmulatedSignalBoard


def _put_counts(
    payloads: dict[int, bytearray], resolved: ResolvedSignal | None, counts: float
) -> None:
    """Write a value in counts as the raw value of its signal, within the range of its bits."""
    if resolved is None:
        return
    signal = resolved.signal
    raw = (counts - resolved.offset) / resolved.factor
    if not signal.is_float:
        low = -(1 << (signal.bit_length - 1)) if signal.is_signed else 0
        high = low + (1 << signal.bit_length) - 1
        if signal.maximum > signal.minimum:
            edges = sorted((value - signal.offset) / signal.factor for value in _range(signal))
            low, high = max(low, math.ceil(edges[0])), min(high, math.floor(edges[1]))
        raw = min(max(round(raw), low), high)
    _put_raw(payloads[resolved.key], signal, raw)


def _range(signal: DbcSignal) -> tuple[float, float]:
    return signal.minimum, signal.maximum


def _put_unsigned(payloads: dict[int, bytearray], resolved: ResolvedSignal, value: int) -> None:
    _put_raw(payloads[resolved.key], resolved.signal, value)


def _put_raw(data: bytearray, signal: DbcSignal, raw: float) -> None:
    """Write the bits of a raw value; see `DbcSignal.raw_value`."""
    if signal.is_float:
        packed = struct.pack("<f" if signal.bit_length == 32 else "<d", raw)
        bits = int.from_bytes(packed, "little")
    else:
        bits = int(raw) & ((1 << signal.bit_length) - 1)
    order: Literal["little", "big"] = "little" if signal.is_intel else "big"
    shift = signal.start_bit
    if not signal.is_intel:
        top = signal.start_bit // 8 * 8 + 7 - signal.start_bit % 8
        shift = 8 * len(data) - top - signal.bit_length
    number = int.from_bytes(data, order) | bits << shift
    data[:] = number.to_bytes(len(data), order)
