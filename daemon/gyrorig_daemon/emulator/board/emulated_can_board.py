"""Emulated board on a CAN bus: the same sensor and clock, other frames.

A sample is an ACCEL and a GYRO frame. Ten times per second a STATUS frame precedes them; HEALTH
replaces a serial board's SLOW. SYNC is latched when its last bit is on the bus, plus the delay of
the interrupt. The checksum of the bus keeps damaged frames from everybody, so that of the faults
only drops, duplicates, swaps, silence and resets apply to a CAN board.
"""

from dataclasses import replace

import numpy as np

from gyrorig_daemon.emulator.board.board_configuration import hello_frame
from gyrorig_daemon.emulator.board.emulated_board import EmulatedBoard
from gyrorig_daemon.emulator.board.sample_encoder import (
    SampleEncoder,
    SampleRows,
    bmp085_raw,
    out_temp_raw,
)
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_daemon.emulator.physics.effects.rig_hooks import BoardHooks
from gyrorig_daemon.emulator.physics.imu import ImuTruth, SampleBlock
from gyrorig_daemon.emulator.physics.stage_motion import Stage
from gyrorig_daemon.emulator.rig_truth import BoardTruth
from gyrorig_protocol.can import (
    SYNC_IDENTIFIER,
    CanFrame,
    FrameType,
    accel_frame,
    gyro_frame,
    health_frame,
    hello_frames,
    latch_frame,
    pack_frames,
    status_frame,
)

STATUS_HZ = 10.0
_LATCH_DELAY_NS = 5_000.0  # mean interrupt delay, assumed
_LATCH_READY_NS = 50_000  # until the firmware has built the LATCH frame
_REQUEST = int(FrameType.REQUEST) << 7


class CanSampleEncoder(SampleEncoder):
    """Encodes one sample as CAN frames, packed."""

    def __init__(self, settings: BoardSettings, changed: bool, node: int, boot: int) -> None:
        """Encode the samples of `node` after start number `boot`."""
        super().__init__(replace(settings, batch=1), changed)
        self._boot = boot
        self._has_started = True  # STATUS precedes the first sample after a start
        self._node = node
        self._every = max(1, round(settings.odr_hz / STATUS_HZ))

    def use_boot(self, boot: int) -> None:
        """Set the start number for the following samples."""
        if boot != self._boot:
            self._boot, self._has_started = boot, True

    def encode(self, rows: SampleRows, first: int, count: int, sequence: int, stamp: int) -> bytes:
        """See `SampleEncoder.encode`."""
        frames: list[CanFrame] = []
        if self._has_started or sequence % self._every == 0:
            self._has_started = False
            frames.append(status_frame(self._node, stamp, sequence, self._boot))
        if self._settings.accel:
            frames.append(accel_frame(self._node, rows.accel[first], stamp))
        frames.append(gyro_frame(self._node, rows.gyro[first], stamp))
        return pack_frames(frames)


class EmulatedCanBoard(EmulatedBoard):
    """A GY-80 with a CAN controller; its frames are ready when `take_output` gives them."""

    protocol_name = "gcb1"  # as `format` in a rig file

    def __init__(
        self,
        settings: BoardSettings,
        truth: BoardTruth,
        stage: Stage,
        origin_ns: int,
        rng: np.random.Generator,
        hooks: BoardHooks | None = None,
    ) -> None:
        """Power the board up at `origin_ns`; see `EmulatedBoard`."""
        faults = replace(settings.faults, flip_bit_every=0, garbage_every=0, garbage=False)
        settings = replace(settings, faults=faults, format="gcb1", batch=1)
        self._latch_rng = rng.spawn(1)[0]
        super().__init__(settings, truth, stage, origin_ns, rng, hooks)
        self._byte_ns = 0  # the bus takes the time

    def receive_frame(self, frame: CanFrame, edge_ns: int) -> None:
        """Accept a frame of the host, complete on the bus at `edge_ns`."""
        if self.settings.faults.silent or self._is_resetting(edge_ns):
            return
        if frame.identifier == SYNC_IDENTIFIER and len(frame.data) == 1:
            latched_ns = edge_ns + round(self._latch_rng.exponential(_LATCH_DELAY_NS))
            latch = latch_frame(
                self.settings.node,
                frame.data[0],
                self._boot(edge_ns),
                self.clock.ticks(latched_ns),
            )
            self._queue_frame(edge_ns + _LATCH_READY_NS, lambda _start_ns: pack_frames([latch]))
        elif frame.identifier in (_REQUEST, _REQUEST | self.settings.node) and frame.data == b"\1":
            self._queue_frame(edge_ns + _LATCH_READY_NS, self._hello)

    def receive(self, data: bytes, at_ns: int) -> None:
        """Ignore bytes: a CAN board receives frames through its bus."""

    def _configure(self, imu: ImuTruth, start_s: float, rng: np.random.Generator) -> None:
        super()._configure(imu, start_s, rng)
        boot = self._boot(self._origin_ns)
        self._encoder = CanSampleEncoder(
            self.settings, self._configuration_changed, self.settings.node, boot
        )

    def _load(self, block: SampleBlock, sent: int) -> None:
        first_ns = self._origin_ns + round(float(block.time_s[0]) * 1e9)
        if isinstance(self._encoder, CanSampleEncoder):
            self._encoder.use_boot(self._boot(first_ns))
        super()._load(block, sent)

    def _slow(self, start_ns: int) -> bytes:
        temperature = float(self._current().temperature_degc[0])
        frame = health_frame(
            self.settings.node,
            out_temp_raw(temperature),
            bmp085_raw(temperature),
            (0, 0, 0, self._saturations),
        )
        return pack_frames([frame])

    def _hello(self, start_ns: int) -> bytes:
        text = hello_frame(self.settings, self._boot(start_ns)).encode_payload()[1:]
        return pack_frames(hello_frames(self.settings.node, text))
