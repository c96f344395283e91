"""The GY-80 sketch, compiled for this machine, with models of its chips behind it.

What is compiled is the sketch's every line but the few under `__AVR__`; those are built by
`test_firmware_avr`.
"""

import subprocess
from itertools import pairwise
from pathlib import Path

import pytest

from gyrorig_protocol.board import (
    Ack,
    Batch,
    BoardFrame,
    FrameEvent,
    FrameParser,
    Hello,
    HelloRequest,
    Sample,
    SampleFlag,
    Set,
    Slow,
    TimeReply,
    TimeRequest,
)

PERIOD_US = 1e6 / 210.0  # the model's, where 200 Hz are nominal
DRDY = SampleFlag.STAMPED_AT_DATA_READY


class Sketch:
    """Runs of the sketch on one EEPROM."""

    def __init__(self, program: Path, eeprom: Path) -> None:
        self._program, self._eeprom = program, eeprom

    def run(
        self, seconds: float = 2.0, stall_us: int = 0, fail_every: int = 0, sent: bytes = b""
    ) -> list[BoardFrame]:
        numbers = str(seconds), str(stall_us), str(fail_every)
        command: list[str | Path] = [self._program, *numbers, self._eeprom, sent.hex()]
        process = subprocess.run(command, capture_output=True, check=False)
        assert process.returncode == 0, process.stderr.decode()
        cut = process.stdout[: process.stdout.rindex(b"\0") + 1]
        frames = []
        for event in FrameParser().feed(cut, 0):
            assert isinstance(event, FrameEvent)
            frames.append(event.frame)
        return frames


@pytest.fixture
def gy80(sketch: Path, tmp_path: Path) -> Sketch:
    return Sketch(sketch, tmp_path / "eeprom")


def samples_of(frames: list[BoardFrame]) -> list[Sample]:
    return [frame for frame in frames if isinstance(frame, Sample)]


def test_the_board_identifies_itself_and_counts_its_starts(gy80: Sketch) -> None:
    boots = [next(f for f in gy80.run(0.2) if isinstance(f, Hello)) for _ in range(3)]
    assert [hello.boot for hello in boots] == [1, 2, 3]
    assert len({hello.uid for hello in boots}) == 1
    assert len(boots[0].uid) == 10
    gyro, accel, air = boots[0].sensors
    assert (gyro.who, gyro.full_scale, gyro.rate_hz, gyro.bandwidth_hz) == (0xD3, 500, 100, 25)
    assert (gyro.per_count, accel.per_count, air.per_count) == (0.0175, 1 / 256, 0.1)


def test_the_longest_hello_is_one_frame(sketch: Path, tmp_path: Path) -> None:
    eeprom = tmp_path / "eeprom"
    uid, boots = bytes(range(0xF0, 0xF5)), (65534).to_bytes(2, "little")
    eeprom.write_bytes((b"G1" + uid + boots).ljust(1024, b"\xff"))
    longest = Set(rate_hz=100, bandwidth_hz=12.5, full_scale_dps=250).encode()
    frames = Sketch(sketch, eeprom).run(1.0, sent=longest + HelloRequest().encode())
    hello = [f for f in frames if isinstance(f, Hello)][-1]
    assert (hello.boot, hello.uid, hello.sensors[0].bandwidth_hz) == (65535, uid.hex(), 12.5)
    assert len(hello.sensors) == 3


def test_every_sample_has_the_time_of_its_edge(gy80: Sketch) -> None:
    frames = gy80.run()
    samples = samples_of(frames)
    assert len(samples) == pytest.approx(2.0 * 105, abs=3)
    assert [s.sequence for s in samples] == [s.gyro[0] for s in samples] == [*range(len(samples))]
    assert all(s.flags == DRDY for s in samples)
    assert all((s.gyro[1], s.accel) == (-s.gyro[0], (1, -2, 256)) for s in samples)
    assert {s.temperature for s in samples[150:]} == {150}  # the data sheet's example
    for before, after in pairwise(samples):
        assert before.device_time is not None
        assert after.device_time is not None
        assert after.device_time - before.device_time == pytest.approx(1e6 / 105, abs=5)
    slow = [f for f in frames if isinstance(f, Slow)][-1]
    assert (slow.temperature, slow.air_temperature_decidegc) == (-7, 150)
    assert slow.sensor_overruns == slow.frames_dropped == slow.bus_errors == 0


def test_the_fifo_keeps_samples_while_the_loop_is_busy(gy80: Sketch) -> None:
    samples = samples_of(gy80.run(stall_us=250_000))  # 26 samples
    assert [s.sequence for s in samples] == [s.gyro[0] for s in samples] == [*range(len(samples))]
    derived = [s for s in samples if s.flags & SampleFlag.STAMP_FROM_FIFO]
    assert len(derived) == pytest.approx(25, abs=3)
    first = samples[0].device_time
    assert first is not None
    for sample in samples:  # the derived timestamps are those of the samples
        assert sample.device_time is not None
        expected = first + sample.gyro[0] * 1e6 / 105
        assert sample.device_time == pytest.approx(expected, abs=200)


def test_an_overrun_is_counted_and_numbers_skip_it(gy80: Sketch) -> None:
    frames = gy80.run(seconds=3.0, stall_us=800_000)  # 84 samples; the FIFO holds 32
    samples = samples_of(frames)
    slow = [f for f in frames if isinstance(f, Slow)][-1]
    lost = slow.sensor_overruns
    assert lost == pytest.approx(84 - 32, abs=2)
    off = {s.sequence - s.gyro[0] for s in samples}
    assert off <= {
        -2,
        -1,
        0,
        1,
        2,
    }  # by the clock, not by the chip
    (after,) = (s for s in samples if s.flags & SampleFlag.OVERRUN)
    before = next(s for s in reversed(samples) if s.sequence < after.sequence)
    assert after.sequence - before.sequence == lost + 1


def test_bus_errors_are_counted_and_harmless(gy80: Sketch) -> None:
    frames = gy80.run(seconds=2.0, fail_every=97)
    slow = [f for f in frames if isinstance(f, Slow)][-1]
    assert slow.bus_errors > 5
    assert len(samples_of(frames)) > 190


def test_settings_reach_the_gyro(gy80: Sketch) -> None:
    expected = Set(rate_hz=200.0, bandwidth_hz=60.0, full_scale_dps=250.0, batch=4, accel=False)
    frames = gy80.run(sent=b"\0" + expected.encode() + TimeRequest(5, 6).encode())
    ack = next(f for f in frames if isinstance(f, Ack))
    in_force = ack.rate_hz, ack.bandwidth_hz, ack.full_scale_dps, ack.batch, ack.accel
    assert in_force == (200.0, 50.0, 250.0, 4, False)
    assert any(isinstance(f, TimeReply) and f.nonce == 5 for f in frames)
    batches = [f for f in frames if isinstance(f, Batch)]
    assert len(batches) == pytest.approx(1.5 * 210 / 4, abs=3)
    for before, after in pairwise(batches):
        assert len(after.gyro) == 4
        assert after.sequence == before.sequence + 4
        assert after.device_time - before.device_time == pytest.approx(4 * PERIOD_US, abs=5)
        assert after.flags == DRDY | SampleFlag.CONFIGURATION_CHANGED
