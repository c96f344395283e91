"""Emulated board on a serial line: samples at its own rate, clock frames, replies.

Theory of operation. Samples are computed in blocks in advance (see `physics.imu`). Each one
becomes a frame that is ready when data-ready has been timestamped and the sensor has been read.
Other frames wait in a heap by the time at which they are ready. The line sends whichever is ready
first; timestamps of the transmission are taken when the first byte leaves.
"""

import heapq
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.board.board_configuration import (
    acknowledge,
    apply_set,
    hello_frame,
    reconfigure_imu,
)
from gyrorig_daemon.emulator.board.emulated_protocol import find_emulated_protocol
from gyrorig_daemon.emulator.board.sample_encoder import (
    Frame,
    SampleEncoder,
    bmp085_raw,
    inject_line_faults,
    out_temp_raw,
    sample_rows,
)
from gyrorig_daemon.emulator.emulated_line import ReceiveLine, byte_ns
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_daemon.emulator.physics.device_clock import DeviceClock
from gyrorig_daemon.emulator.physics.effects.rig_hooks import BoardHooks
from gyrorig_daemon.emulator.physics.imu import BiasPath, ImuModel, ImuTruth, SampleBlock
from gyrorig_daemon.emulator.physics.stage_motion import Stage
from gyrorig_daemon.emulator.rig_truth import BoardTruth
from gyrorig_protocol.board import BoardFrame, FrameEvent
from gyrorig_protocol.board.board_frames import HelloRequest, Slow, TimeReply, TimeRequest
from gyrorig_protocol.board.json_frames import Set

FloatArray = NDArray[np.float64]

# Six bytes of gyro and six of accelerometer over I2C at 400 kHz, 0.21 ms each.
BUS_READ_NS = 420_000
_ANSWER_NS = 200_000  # period of the firmware's input loop
_BOOT = 12
_SUPPLY_MV = 3300

FrameBuilder = Callable[[int], bytes]  # from the time of the first byte


def _constant_frame(data: bytes) -> FrameBuilder:
    """Return a builder that gives the same bytes at any time."""
    return lambda _start_ns: data


class EmulatedBoard:
    """A GY-80 board; see `device.EmulatedDevice`."""

    def __init__(
        self,
        settings: BoardSettings,
        truth: BoardTruth,
        stage: Stage,
        origin_ns: int,
        rng: np.random.Generator,
        hooks: BoardHooks | None = None,
    ) -> None:
        """Power the board up at `origin_ns`; `hooks` are the effects on it."""
        self._hooks = hooks or BoardHooks()
        self.settings = settings
        self.truth = truth
        self._stage = stage
        self._origin_ns = origin_ns
        self._resets_ns = tuple(origin_ns + round(s * 1e9) for s in settings.faults.reset_at_s)
        imu_rng, clock_rng, self._stamp_rng, self._slow_rng, self._spare_rng = rng.spawn(5)
        self.clock = DeviceClock(truth.clock, origin_ns, clock_rng, self._resets_ns)
        self._in = ReceiveLine(settings.baud)
        self._byte_ns = byte_ns(settings.baud)
        self._stamp_early_ns = round(truth.stamp_early_s * 1e9)
        self._free_ns = origin_ns
        self._protocol = find_emulated_protocol(settings.format)
        self._parser = self._protocol.make_parser()
        self._frames: deque[Frame] = deque()
        self._other_frames: list[tuple[int, int, FrameBuilder]] = []
        self._order = 0
        self._next_frame: tuple[int, bytes, bool] | None = None
        self._configuration_changed = False
        self._pending_sets: deque[tuple[int, Set]] = deque()
        self._samples_before_model = 0  # samples before the sensor was last configured
        self._frame_count = 0
        self._saturations = 0
        self._block: SampleBlock | None = None
        self._bias_path = BiasPath()
        self._configure(truth.imu, 0.0, imu_rng)
        self._next_block()
        self._announce()

    def receive(self, data: bytes, at_ns: int) -> None:
        """Accept bytes that arrive from `at_ns` on."""
        arrivals = self._in.arrivals(len(data), at_ns)
        if self._parser is None or self.settings.faults.silent:
            return
        for byte, arrived_ns in zip(data, arrivals, strict=True):
            if self._is_resetting(arrived_ns):
                self._parser.reset()
                continue
            for event in self._parser.feed(bytes([byte]), arrived_ns):
                if isinstance(event, FrameEvent):
                    self._answer(event.frame, arrived_ns)

    def next_output_ns(self) -> int | None:
        """Return when the next frame will have left the line."""
        frame = self._peek_next_frame()
        return None if frame is None else frame[0]

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the frames that left the line up to a time."""
        sent = []
        while (frame := self._peek_next_frame()) is not None and frame[0] <= until_ns:
            end_ns, data, sample = frame
            if sample:
                self._frames.popleft()
                self._sent += 1
            else:
                heapq.heappop(self._other_frames)
            self._free_ns = end_ns
            self._next_frame = None
            if data:
                sent.append((end_ns, data))
        return sent

    def mean_bias_rad_s(self, start_ns: int, end_ns: int) -> FloatArray:
        """Return the mean true bias over a time, with its wander, (3,)."""
        first, last = ((ns - self._origin_ns) * 1e-9 for ns in (start_ns, end_ns))
        mean = self._bias_path.mean(first, last)
        return self.truth.imu.bias_rad_s if mean is None else mean

    def _peek_next_frame(self) -> tuple[int, bytes, bool] | None:
        """Return when the next frame has left, its bytes, and whether it contains samples."""
        if self.settings.faults.silent:
            return None
        refreshed = self._imu.recompute_if_moved()
        if refreshed is not None:
            self._load(refreshed, self._sent)
            self._next_frame = None
        if self._next_frame is None:
            if not self._frames:
                self._next_block()
            sample = not self._other_frames or self._frames[0][0] <= self._other_frames[0][0]
            ready_ns = self._frames[0][0] if sample else self._other_frames[0][0]
            start_ns = max(ready_ns, self._free_ns)
            data = self._frames[0][1] if sample else self._other_frames[0][2](start_ns)
            if not sample and self._is_resetting(start_ns):
                data = b""  # the board has been reset before the reply
            self._next_frame = (start_ns + len(data) * self._byte_ns, data, sample)
        return self._next_frame

    # Samples

    def _configure(self, imu: ImuTruth, start_s: float, rng: np.random.Generator) -> None:
        """Start the sensor; its first sample is ready one period later."""
        self._encoder = SampleEncoder(self.settings, self._configuration_changed)
        step = self._encoder.samples_per_frame
        self._imu = ImuModel(imu, self._stage, start_s, rng, step, self._hooks)

    def _reconfigure(self, block_end_ns: int) -> None:
        """Execute the SETs received before the end of the block, and acknowledge them."""
        while self._pending_sets and self._pending_sets[0][0] <= block_end_ns:
            new_settings = apply_set(self.settings, self._pending_sets.popleft()[1])
            if new_settings != self.settings:
                block = self._current()
                self._samples_before_model += block.first + len(block.time_s)
                imu = reconfigure_imu(self._imu.truth, self.settings, new_settings)
                self.settings, self._configuration_changed = new_settings, True
                self._configure(imu, float(block.time_s[-1]), self._spare_rng.spawn(1)[0])
            ack = self._encode(acknowledge(new_settings))
            self._queue_frame(block_end_ns + _ANSWER_NS, _constant_frame(ack))

    def _next_block(self) -> None:
        if self._block is not None:  # all of its samples have been sent
            self._saturations += int(self._block.saturated.sum())
            self._reconfigure(self._origin_ns + round(float(self._block.time_s[-1]) * 1e9))
        block = self._imu.next_block()
        count = len(block.time_s)
        self._stamp_late_ns = self._stamp_rng.exponential(
            self.truth.stamp_jitter_s * 1e9, count
        ).astype(np.int64)
        self._first_frame = self._frame_count + 1
        self._frame_count += count // self._encoder.samples_per_frame
        self._lost = self._sample_lost_frames(count // self._encoder.samples_per_frame)
        self._bias_path.add(float(block.time_s[0]), block.bias_rad_s)
        self._load(block, 0)

    def _load(self, block: SampleBlock, sent: int) -> None:
        """Queue the frames of a block, without the first `sent` ones."""
        self._block = block
        self._sent = sent
        ready_ns = (self._origin_ns + np.rint(block.time_s * 1e9)).astype(np.int64)
        stamped_ns = (ready_ns + self._stamp_late_ns).tolist()
        step = self._encoder.samples_per_frame
        rows = sample_rows(block)
        frames: list[Frame] = []
        for row in range(0, len(stamped_ns), step):
            if self._lost[row // step]:
                continue
            last_ns = stamped_ns[row + step - 1]
            number = self._samples_before_model + block.first + row
            boot_ns = self.clock.last_reset_ns(last_ns)
            if boot_ns is not None:
                if self._is_resetting(last_ns):
                    continue
                number = (
                    block.first + row - self._imu.samples_before((boot_ns - self._origin_ns) * 1e-9)
                )
            stamp = self.clock.ticks(last_ns - self._stamp_early_ns)
            data = self._encoder.encode(rows, row, step, number, stamp)
            frames.append((last_ns + BUS_READ_NS, data))
        faulty = inject_line_faults(self.settings.faults, self._first_frame, frames)
        # Without frames there is still a time at which the next block starts.
        self._frames = deque((faulty or [(stamped_ns[-1] + BUS_READ_NS, b"")])[sent:])

    def _sample_lost_frames(self, frames: int) -> NDArray[np.bool_]:
        """Return which frames of the next block are lost, (frames,)."""
        lost_samples = self._hooks.lost
        return (
            np.zeros(frames, dtype=np.bool_) if lost_samples is None else lost_samples.draw(frames)
        )

    def _current(self) -> SampleBlock:
        if self._block is None:
            raise RuntimeError("a board always has a block")
        return self._block

    # Everything else

    def _announce(self) -> None:
        """Queue HELLO at each start, and the first clock frame."""
        self._queue_frame(self._origin_ns, self._hello)
        for reset_ns in self._resets_ns:
            self._queue_frame(
                reset_ns + round(self.settings.faults.reset_silence_s * 1e9), self._hello
            )
        if self.settings.slow_hz > 0.0:
            self._schedule_slow(self._origin_ns)

    def _queue_frame(self, ready_ns: int, build: FrameBuilder) -> None:
        heapq.heappush(self._other_frames, (ready_ns, self._order, build))
        self._order += 1
        self._next_frame = None

    def _schedule_slow(self, after_ns: int) -> None:
        """Queue SLOW at a random phase, so that it does not beat with the host's polls."""
        wait_s = self._slow_rng.uniform(0.5, 1.5) / self.settings.slow_hz
        ready_ns = after_ns + round(wait_s * 1e9)
        planned = False

        def build(start_ns: int) -> bytes:
            nonlocal planned
            if not planned:
                planned = True
                self._schedule_slow(ready_ns)
            return self._slow(start_ns)

        self._queue_frame(ready_ns, build)

    def _slow(self, start_ns: int) -> bytes:
        block = self._current()
        temperature = float(block.temperature_degc[0])
        elapsed_s = (start_ns - self._origin_ns) * 1e-9 - float(block.time_s[0])
        count = self._samples_before_model + block.first + int(elapsed_s * self._imu.truth.odr_hz)
        slow = Slow(
            device_time=self.clock.ticks(start_ns),
            boot=self._boot(start_ns),
            sequence=max(count, 0),
            sensor_overruns=0,
            frames_dropped=0,
            bus_errors=0,
            saturations=self._saturations,
            temperature=out_temp_raw(temperature),
            air_temperature_decidegc=bmp085_raw(temperature),
            supply_mv=_SUPPLY_MV,
        )
        return self._encode(slow)

    def _is_resetting(self, at_ns: int) -> bool:
        """Return whether the board is restarting, when it neither receives nor sends."""
        started_ns = self.clock.last_reset_ns(at_ns)
        if started_ns is None:
            return False
        return at_ns < started_ns + round(self.settings.faults.reset_silence_s * 1e9)

    def _boot(self, at_ns: int) -> int:
        return _BOOT + sum(reset_ns <= at_ns for reset_ns in self._resets_ns)

    def _hello(self, start_ns: int) -> bytes:
        return self._encode(hello_frame(self.settings, self._boot(start_ns)))

    def _encode(self, frame: BoardFrame) -> bytes:
        return self._protocol.encode(frame, self.settings)

    def _answer(self, frame: object, arrived_ns: int) -> None:
        if isinstance(frame, TimeRequest):
            nonce, stamp = frame.nonce, frame.host_stamp
            received = self.clock.ticks(arrived_ns)
            self._queue_frame(
                arrived_ns + _ANSWER_NS,
                lambda ns: self._encode(TimeReply(nonce, stamp, received, self.clock.ticks(ns))),
            )
        elif isinstance(frame, HelloRequest):
            self._queue_frame(arrived_ns + _ANSWER_NS, self._hello)
        elif isinstance(frame, Set):
            self._pending_sets.append((arrived_ns, frame))
