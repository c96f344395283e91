"""How fast the reader is, against the stock decoder and against the floor.

One file of a million board samples and 50,000 positions, interleaved as a recording
has them, read in one run by three readers:

- ours: `read_recording`, every sample's fields in arrays;
- stock: `mcap` with `mcap-ros2-support`, every message decoded;
- floor: the same chunks only unpacked and checked, which no reader can do without.

Run: python tests/bench/bench_reader.py [--positions 50000] [--repeat 5]
"""

import argparse
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.mcap.mcap_summary import read_summary
from gyrorig_protocol.recording.mcap.record_scan import scan_records
from gyrorig_protocol.recording.messages import PTU_POSITION_TOPIC, PtuPosition, imu_raw_topic
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import times_ns
from gyrorig_protocol.recording.writer import RecordingWriter

BOARD = BoardId("BENCH-1")
START_NS = 1_790_000_000_000_000_000
SAMPLES_PER_POSITION = 20  # 800 Hz and 40 Hz
GOAL_STOCK, GOAL_FLOOR = 50.0, 2.0


def write_file(path: Path, positions: int) -> None:
    """A recording with the noise of a real board, so that it packs like one."""
    random = np.random.default_rng(1)
    total = positions * SAMPLES_PER_POSITION
    step_ns = 1_250_000
    count = np.arange(total)
    host_ns = START_NS + count * step_ns + random.integers(0, 200_000, total)
    gyro = random.normal(0, 30, (total, 3)).astype(np.int64)
    accel = random.normal((0, 0, 4096), 20, (total, 3)).astype(np.int64)
    metadata = {
        "gyrorig": {"session": "bench", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}
    }
    with RecordingWriter(path, metadata) as writer:
        for k in range(positions):
            part = slice(k * SAMPLES_PER_POSITION, (k + 1) * SAMPLES_PER_POSITION)
            writer.write_imu_array(
                BOARD,
                host_time_ns=host_ns[part],
                publish_time_ns=None,
                device_time=count[part] * 1250,
                sequence=count[part],
                status=np.full(SAMPLES_PER_POSITION, 0x104),
                temperature=np.full(SAMPLES_PER_POSITION, 21),
                gyro=gyro[part],
                accel=accel[part],
            )
            reply_ns = int(host_ns[part][-1])
            angle = k * 1e-4
            position = PtuPosition(
                reply_ns - 3_000_000, reply_ns - 700_000, reply_ns, k, -k, angle, -angle, 0, k, 3
            )
            writer.write(PTU_POSITION_TOPIC, position)
            writer.tick(reply_ns)


def ours(path: Path) -> int:
    """Read all, and touch what a solver touches."""
    recording = read_recording(path)
    samples, positions = recording.imu(BOARD), recording.ptu_positions()
    if not recording.is_complete:
        raise SystemExit(f"losses in a whole file: {recording.losses}")
    return len(samples) + len(positions)


def floor(path: Path) -> int:
    """Unpack and check the chunks, and nothing else."""
    data = memoryview(path.read_bytes())
    unpacker = zstandard.ZstdDecompressor()
    count = 0
    for chunk in scan_records(data, read_summary(data)).chunks:
        content = unpacker.decompress(data[chunk.data_start : chunk.data_end])
        if zlib.crc32(content) != chunk.crc:
            raise SystemExit("a wrong checksum")
        count += chunk.indexed_messages or 0
    return count


def stock(path: Path) -> int:
    """Decode every message with the stock reader."""
    count = 0
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _ in reader.iter_decoded_messages(log_time_order=False):
            count += 1
    return count


def clock(read: Callable[[Path], int], path: Path, repeat: int, expected: int) -> float:
    """The best time of `repeat`, in seconds of this process's CPU."""
    best = float("inf")
    for _ in range(repeat):
        begin = time.process_time()
        result = read(path)
        best = min(best, time.process_time() - begin)
        if result != expected:
            raise SystemExit(f"{read.__name__} found {result} messages, not {expected}")
    return best


def main() -> int:
    """Run the three readers and print one table; exit code 1 when a goal is missed."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--positions", type=int, default=50_000)
    arguments.add_argument("--repeat", type=int, default=5)
    given = arguments.parse_args()
    total = given.positions * (SAMPLES_PER_POSITION + 1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.mcap"
        write_file(path, given.positions)
        megabytes = path.stat().st_size / 1e6
        floor_s = clock(floor, path, given.repeat, total)
        ours_s = clock(ours, path, given.repeat, total)
        stock_s = clock(stock, path, 1, total)
        begin = time.process_time()
        recording = read_recording(path)
        gyro = np.ascontiguousarray(recording.imu(BOARD)["gyro"])
        stamps = times_ns(recording.imu(BOARD)["host_time"])
        solver_s = time.process_time() - begin
        begin = time.process_time()
        digest = recording.sha256
        digest_s = time.process_time() - begin
    print(f"{total} messages ({imu_raw_topic(BOARD)}, {PTU_POSITION_TOPIC}), {megabytes:.1f} MB")  # noqa: T201
    for name, seconds in (("ours", ours_s), ("stock", stock_s), ("floor", floor_s)):
        print(f"{name:6} {seconds:8.3f} s CPU {total / seconds / 1e3:9.0f} k msg/s")  # noqa: T201
    print(f"with contiguous rates {gyro.shape} and stamps {stamps.shape}: {solver_s:.3f} s")  # noqa: T201
    print(f"sha256 {digest[:12]}..., only when asked for: {digest_s:.3f} s")  # noqa: T201
    print(f"ours / stock: {stock_s / ours_s:.1f} times as fast (goal {GOAL_STOCK:.0f})")  # noqa: T201
    print(f"ours / floor: {ours_s / floor_s:.2f} times its time (goal {GOAL_FLOOR:.0f})")  # noqa: T201
    return int(stock_s / ours_s < GOAL_STOCK or ours_s / floor_s > GOAL_FLOOR)


if __name__ == "__main__":
    sys.exit(main())
