"""The emulated board on a CAN bus: the same sensor and clock, other frames.

A sample is an ACCEL and a GYRO frame; ten times a second a STATUS goes before them; HEALTH
goes where a serial board sends SLOW. SYNC is latched when its last bit is on the bus, and a
moment later: the interrupt's delay. Damage on the line is the bus's own affair: its check
keeps such frames from everybody, so of the faults only drops, doubles, swaps, silence and
resets are a CAN board's.
"""

from dataclasses import replace

import numpy as np

from gyrorig_daemon.emulator.board.configuration import hello
from gyrorig_daemon.emulator.board.device import EmulatedBoard
from gyrorig_daemon.emulator.board.encode import SampleEncoder, bmp085_raw, out_temp_raw
from gyrorig_daemon.emulator.physics.effects.hooks import BoardHooks
from gyrorig_daemon.emulator.physics.imu import ImuTruth, SampleBlock
from gyrorig_daemon.emulator.physics.stage import Stage
from gyrorig_daemon.emulator.settings import BoardSettings
from gyrorig_daemon.emulator.truth import BoardTruth
from gyrorig_protocol.board.frames import Triple
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
_LATCH_DELAY_NS = 5_000.0  # mean of the interrupt's delay (reference: timesync.md section 4)
_LATCH_READY_NS = 50_000  # until the firmware's loop has worded the LATCH
_REQUEST = int(FrameType.REQUEST) << 7


class CanSampleEncoder(SampleEncoder):
    """Words one sample as the frames that a bus carries, packed."""

    def __init__(self, settings: BoardSettings, changed: bool, node: int, boot: int) -> None:
        """Word the samples of `node` after start number `boot`."""
        super().__init__(replace(settings, batch=1), changed)
        self._boot = boot
        self._has_started = True  # STATUS goes before the first sample after a start
        self._node = node
        self._every = max(1, round(settings.odr_hz / STATUS_HZ))

    def use_boot(self, boot: int) -> None:
        """The samples from here on are of this start."""
        if boot != self._boot:
            self._boot, self._has_started = boot, True

    def encode(
        self, block: SampleBlock, first: int, count: int, sequence: int, stamp: int
    ) -> bytes:
        """See `SampleEncoder.encode`."""
        frames: list[CanFrame] = []
        if self._has_started or sequence % self._every == 0:
            self._has_started = False
            frames.append(status_frame(self._node, stamp, sequence, self._boot))
        if self._settings.accel:
            frames.append(accel_frame(self._node, _triple(block.accel[first].tolist()), stamp))
        frames.append(gyro_frame(self._node, _triple(block.gyro[first].tolist()), stamp))
        return pack_frames(frames)


class EmulatedCanBoard(EmulatedBoard):
    """A GY-80 with a CAN controller; its frames are ready when `take_output` gives them."""

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
        self._byte_ns = 0  # the bus takes the time, not a line

    def hear(self, frame: CanFrame, edge_ns: int) -> None:
        """Take a frame of the host, complete on the bus at `edge_ns`."""
        if self.settings.faults.silent or self._is_down(edge_ns):
            return
        if frame.identifier == SYNC_IDENTIFIER and len(frame.data) == 1:
            latched_ns = edge_ns + round(self._latch_rng.exponential(_LATCH_DELAY_NS))
            latch = latch_frame(
                self.settings.node,
                frame.data[0],
                self._boot(edge_ns),
                self.clock.ticks(latched_ns),
            )
            self._later(edge_ns + _LATCH_READY_NS, lambda _start_ns: pack_frames([latch]))
        elif frame.identifier in (_REQUEST, _REQUEST | self.settings.node) and frame.data == b"\1":
            self._later(edge_ns + _LATCH_READY_NS, self._hello)

    def receive(self, data: bytes, at_ns: int) -> None:
        """Take nothing: a board hears frames, through its bus."""

    def _configure(self, imu: ImuTruth, start_s: float, rng: np.random.Generator) -> None:
        super()._configure(imu, start_s, rng)
        boot = self._boot(self._origin_ns)
        self._encoder = CanSampleEncoder(self.settings, self._changed, self.settings.node, boot)

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
        text = hello(self.settings, self._boot(start_ns)).payload()[1:]
        return pack_frames(hello_frames(self.settings.node, text))


def _triple(row: list[int]) -> Triple:
    return row[0], row[1], row[2]
