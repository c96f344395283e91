"""The emulated board on its line: samples at its own rate, clock frames, answers.

Theory of operation. Samples are computed in blocks ahead of time (see `physics.imu`); each
becomes a frame that is ready when data-ready has been stamped and the bus been read. Other
frames wait in a heap by the time they are ready. The line takes whichever is ready first;
stamps that name the sending are taken as the first byte leaves.
"""

import heapq
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.board.configuration import (
    acknowledgement,
    effective,
    hello,
    reconfigured,
)
from gyrorig_daemon.emulator.board.encode import (
    Frame,
    SampleEncoder,
    bmp085_raw,
    out_temp_raw,
    with_faults,
)
from gyrorig_daemon.emulator.line import InLine, byte_ns
from gyrorig_daemon.emulator.physics.clock import DeviceClock
from gyrorig_daemon.emulator.physics.effects.hooks import BoardHooks
from gyrorig_daemon.emulator.physics.imu import BiasPath, ImuModel, ImuTruth, SampleBlock
from gyrorig_daemon.emulator.physics.stage import Stage
from gyrorig_daemon.emulator.settings import BoardSettings
from gyrorig_daemon.emulator.truth import BoardTruth
from gyrorig_protocol.board import FrameEvent, FrameParser
from gyrorig_protocol.board.frames import HelloRequest, Slow, TimeReply, TimeRequest
from gyrorig_protocol.board.hello import Set

FloatArray = NDArray[np.float64]

# Six bytes of gyro and six of accelerometer over I2C at 400 kHz, 0.21 ms each.
_BUS_READ_NS = 420_000
_ANSWER_NS = 200_000  # the firmware's loop looks at its input this often
_FIRMWARE = "1"  # short: a HELLO is one frame of at most 248 bytes
_BOOT = 12
_SUPPLY_MV = 3300

Build = Callable[[int], bytes]  # from the time of the first byte


def _said(data: bytes) -> Build:
    """Return what gives the same bytes whenever they are sent."""
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
        """Power the board up at `origin_ns`; `hooks` hold what is wrong with it."""
        self._hooks = hooks or BoardHooks()
        self.settings = settings
        self.truth = truth
        self._stage = stage
        self._origin_ns = origin_ns
        self._resets_ns = tuple(origin_ns + round(s * 1e9) for s in settings.faults.reset_at_s)
        imu_rng, clock_rng, self._stamp_rng, self._slow_rng, self._spare_rng = rng.spawn(5)
        self.clock = DeviceClock(truth.clock, origin_ns, clock_rng, self._resets_ns)
        self._in = InLine(settings.baud)
        self._byte_ns = byte_ns(settings.baud)
        self._free_ns = origin_ns
        self._parser = FrameParser()
        self._frames: deque[Frame] = deque()
        self._misc: list[tuple[int, int, Build]] = []
        self._order = 0
        self._head: tuple[int, bytes, bool] | None = None
        self._changed = False
        self._wanted: deque[tuple[int, Set]] = deque()
        self._before_model = 0  # samples before the sensor was last configured
        self._frame_count = 0
        self._saturations = 0
        self._block: SampleBlock | None = None
        self._bias_path = BiasPath()
        self._configure(truth.imu, 0.0, imu_rng)
        self._next_block()
        if settings.format == "gcb1":
            self._announce()

    def receive(self, data: bytes, at_ns: int) -> None:
        """Take bytes whose first one begins to arrive at `at_ns`."""
        arrivals = self._in.arrivals(len(data), at_ns)
        if self.settings.format != "gcb1" or self.settings.faults.silent:
            return
        for byte, arrived_ns in zip(data, arrivals, strict=True):
            if self._is_down(arrived_ns):
                self._parser = FrameParser()
                continue
            for event in self._parser.feed(bytes([byte]), arrived_ns):
                if isinstance(event, FrameEvent):
                    self._answer(event.frame, arrived_ns)

    def next_output_ns(self) -> int | None:
        """Return when the next frame will have left the line."""
        head = self._peek()
        return None if head is None else head[0]

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the frames that left the line up to a time."""
        taken = []
        while (head := self._peek()) is not None and head[0] <= until_ns:
            end_ns, data, sample = head
            if sample:
                self._frames.popleft()
                self._sent += 1
            else:
                heapq.heappop(self._misc)
            self._free_ns = end_ns
            self._head = None
            if data:
                taken.append((end_ns, data))
        return taken

    def mean_bias_rad_s(self, start_ns: int, end_ns: int) -> FloatArray:
        """Return the true bias, with its wander, averaged over a time, shape (3,)."""
        first, last = ((ns - self._origin_ns) * 1e-9 for ns in (start_ns, end_ns))
        mean = self._bias_path.mean(first, last)
        return self.truth.imu.bias_rad_s if mean is None else mean

    def _peek(self) -> tuple[int, bytes, bool] | None:
        """Return when the next frame will have left, its bytes, and whether it is a sample's."""
        if self.settings.faults.silent:
            return None
        refreshed = self._imu.refreshed()
        if refreshed is not None:
            self._load(refreshed, self._sent)
            self._head = None
        if self._head is None:
            if not self._frames:
                self._next_block()
            sample = not self._misc or self._frames[0][0] <= self._misc[0][0]
            ready_ns = self._frames[0][0] if sample else self._misc[0][0]
            start_ns = max(ready_ns, self._free_ns)
            data = self._frames[0][1] if sample else self._misc[0][2](start_ns)
            if not sample and self._is_down(start_ns):
                data = b""  # an answer that a reset overtook
            self._head = (start_ns + len(data) * self._byte_ns, data, sample)
        return self._head

    # Samples

    def _configure(self, imu: ImuTruth, start_s: float, rng: np.random.Generator) -> None:
        """Start the sensor; its first sample comes a period later."""
        self._encoder = SampleEncoder(self.settings, self._changed)
        step = self._encoder.samples_per_frame
        self._imu = ImuModel(imu, self._stage, start_s, rng, step, self._hooks)

    def _reconfigure(self, block_end_ns: int) -> None:
        """Do what SETs that came before the end of the block want, and acknowledge."""
        while self._wanted and self._wanted[0][0] <= block_end_ns:
            after = effective(self.settings, self._wanted.popleft()[1])
            if after != self.settings:
                block = self._current()
                self._before_model += block.first + len(block.time_s)
                imu = reconfigured(self._imu.truth, self.settings, after)
                self.settings, self._changed = after, True
                self._configure(imu, float(block.time_s[-1]), self._spare_rng.spawn(1)[0])
            ack = acknowledgement(after).encode()
            self._later(block_end_ns + _ANSWER_NS, _said(ack))

    def _next_block(self) -> None:
        if self._block is not None:  # final: every sample of it has been sent
            self._saturations += int(self._block.saturated.sum())
            self._reconfigure(self._origin_ns + round(float(self._block.time_s[-1]) * 1e9))
        block = self._imu.next_block()
        count = len(block.time_s)
        self._stamp_late_ns = self._stamp_rng.exponential(
            self.truth.stamp_jitter_s * 1e9, count
        ).astype(np.int64)
        self._first_frame = self._frame_count + 1
        self._frame_count += count // self._encoder.samples_per_frame
        self._lost = self._draw_lost(count // self._encoder.samples_per_frame)
        self._bias_path.add(float(block.time_s[0]), block.bias_rad_s)
        self._load(block, 0)

    def _load(self, block: SampleBlock, sent: int) -> None:
        """Queue the frames of a block, without the first `sent` ones."""
        self._block = block
        self._sent = sent
        ready_ns = (self._origin_ns + np.rint(block.time_s * 1e9)).astype(np.int64)
        stamped_ns = (ready_ns + self._stamp_late_ns).tolist()
        step = self._encoder.samples_per_frame
        frames: list[Frame] = []
        for row in range(0, len(stamped_ns), step):
            if self._lost[row // step]:
                continue
            last_ns = stamped_ns[row + step - 1]
            number = self._before_model + block.first + row
            boot_ns = self.clock.started_ns(last_ns)
            if boot_ns is not None:
                if self._is_down(last_ns):
                    continue
                number = (
                    block.first + row - self._imu.samples_before((boot_ns - self._origin_ns) * 1e-9)
                )
            data = self._encoder.encode(block, row, step, number, self.clock.ticks(last_ns))
            frames.append((last_ns + _BUS_READ_NS, data))
        faulty = with_faults(self.settings.faults, self._first_frame, frames)
        # With nothing to send there is still a time at which the next block begins.
        self._frames = deque((faulty or [(stamped_ns[-1] + _BUS_READ_NS, b"")])[sent:])

    def _draw_lost(self, frames: int) -> NDArray[np.bool_]:
        """Return which frames of the next block never come, (frames,)."""
        lost = self._hooks.lost
        return np.zeros(frames, dtype=np.bool_) if lost is None else lost.draw(frames)

    def _current(self) -> SampleBlock:
        if self._block is None:
            raise RuntimeError("a board has a block from the start")
        return self._block

    # Everything else

    def _announce(self) -> None:
        """HELLO at each start, and the first clock frame."""
        self._later(self._origin_ns, self._hello)
        for reset_ns in self._resets_ns:
            self._later(reset_ns + round(self.settings.faults.reset_silence_s * 1e9), self._hello)
        if self.settings.slow_hz > 0.0:
            self._plan_slow(self._origin_ns)

    def _later(self, ready_ns: int, build: Build) -> None:
        heapq.heappush(self._misc, (ready_ns, self._order, build))
        self._order += 1
        self._head = None

    def _plan_slow(self, after_ns: int) -> None:
        """At a random phase, so that it does not beat with the host's own rhythm."""
        wait_s = self._slow_rng.uniform(0.5, 1.5) / self.settings.slow_hz
        ready_ns = after_ns + round(wait_s * 1e9)
        planned = False

        def build(start_ns: int) -> bytes:
            nonlocal planned
            if not planned:
                planned = True
                self._plan_slow(ready_ns)
            return self._slow(start_ns)

        self._later(ready_ns, build)

    def _slow(self, start_ns: int) -> bytes:
        block = self._current()
        temperature = float(block.temperature_degc[0])
        elapsed_s = (start_ns - self._origin_ns) * 1e-9 - float(block.time_s[0])
        count = self._before_model + block.first + int(elapsed_s * self._imu.truth.odr_hz)
        return Slow(
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
        ).encode()

    def _is_down(self, at_ns: int) -> bool:
        """Return whether the board starts anew just then: deaf and dumb."""
        started_ns = self.clock.started_ns(at_ns)
        if started_ns is None:
            return False
        return at_ns < started_ns + round(self.settings.faults.reset_silence_s * 1e9)

    def _boot(self, at_ns: int) -> int:
        return _BOOT + sum(reset_ns <= at_ns for reset_ns in self._resets_ns)

    def _hello(self, start_ns: int) -> bytes:
        return hello(self.settings, self._boot(start_ns)).encode()

    def _answer(self, frame: object, arrived_ns: int) -> None:
        if isinstance(frame, TimeRequest):
            nonce, stamp = frame.nonce, frame.host_stamp
            received = self.clock.ticks(arrived_ns)
            self._later(
                arrived_ns + _ANSWER_NS,
                lambda ns: TimeReply(nonce, stamp, received, self.clock.ticks(ns)).encode(),
            )
        elif isinstance(frame, HelloRequest):
            self._later(arrived_ns + _ANSWER_NS, self._hello)
        elif isinstance(frame, Set):
            self._wanted.append((arrived_ns, frame))
