"""How many samples a second a calibration is applied to: arrays, a table, a recording.

Beside imucal's own way of applying one, and the plain formula in numpy, in the same run. A
sample is three axes. CPU time of one core, one BLAS thread, the best of several repeats, so
that what else the machine does counts little. The bar is 50 million samples a second for
arrays of counts.

Run: python tests/bench/bench_apply.py [--samples 4000000] [--repeat 5]
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy

import numpy as np

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.writer import RecordingWriter
from gyrorig_solver import Calibration
from gyrorig_solver.apply.corrected_recording import apply_to_recording
from gyrorig_solver.apply.corrected_table import TableColumns, apply_to_table

GOLDEN = Path(__file__).resolve().parents[1] / "unit" / "output" / "golden" / "good.yaml"
LEAST_M_PER_S = 50.0
TABLE_ROWS = 300_000
RECORDED_S, RATE_HZ = 300, 800
BOARD = BoardId("GY80-0007")


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def rate(count: int, work: Callable[[], object], repeat: int) -> float:
    """Return samples a second of CPU time, the best of several."""
    best = float("inf")
    for _ in range(repeat):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return count / best


def arrays(calibration: Calibration, samples: int, repeat: int) -> float:
    """Print the table of arrays; return the rate of counts in, float64 out."""
    rng = np.random.default_rng(1)
    counts = rng.integers(-20000, 20000, size=(samples, 3), dtype=np.int16)
    matrix, offset = calibration.correction.affine_form()
    inverse = matrix.T
    scale = calibration.scale_of("counts")
    say("| arrays | in | out | million samples a second |\n|---|---|---|---:|")
    measured = 0.0
    for kind in (np.int16, np.int32, np.float64):
        given = counts.astype(kind)
        for out_kind in (np.float64, np.float32):
            out = np.empty((samples, 3), dtype=out_kind)
            per_s = rate(samples, lambda g=given, o=out: calibration.rates(g, out=o), repeat)  # type: ignore[misc]
            if kind is np.int16 and out_kind is np.float64:
                measured = per_s
            say(
                f"| Calibration.rates | {kind.__name__} | {out_kind.__name__} | {per_s / 1e6:.0f} |"
            )
    fresh = rate(samples, lambda: calibration.rates(counts), repeat)
    say(f"| Calibration.rates, memory of its own | int16 | float64 | {fresh / 1e6:.0f} |")
    plain = rate(samples, lambda: (counts * scale) @ inverse + offset, repeat)
    say(f"| numpy, the plain formula | int16 | float64 | {plain / 1e6:.1f} |")
    peer = imucal(counts[: samples // 4].astype(np.float64), repeat)
    if peer is not None:
        say(f"| imucal, calibrate (an accelerometer too) | float64 | float64 | {peer / 1e6:.1f} |")
    return measured


def imucal(rates: np.ndarray, repeat: int) -> float | None:
    """Return imucal's samples a second for the gyro and an accelerometer, None without it."""
    try:
        from imucal import FerrarisCalibrationInfo  # type: ignore[import-untyped] # noqa: PLC0415
    except ImportError:
        return None
    eye = np.eye(3)
    info = FerrarisCalibrationInfo(
        K_a=eye, R_a=eye, b_a=np.zeros(3), K_g=eye, R_g=eye, K_ga=0.0 * eye, b_g=np.zeros(3),
        from_acc_unit="m/s^2", from_gyr_unit="deg/s", acc_unit="m/s^2", gyr_unit="deg/s",
    )  # fmt: skip
    return rate(
        len(rates), lambda: info.calibrate(rates, rates, "m/s^2", "deg/s"), max(1, repeat // 2)
    )


def table(calibration: Calibration, folder: Path) -> None:
    """Print how fast a table is."""
    counts = np.random.default_rng(2).integers(-20000, 20000, size=(TABLE_ROWS, 3))
    with (folder / "in.csv").open("w") as file:
        file.write("t,gx,gy,gz\n")
        np.savetxt(file, np.column_stack([np.arange(TABLE_ROWS), counts]), "%d", ",")
    columns = TableColumns(("gx", "gy", "gz"))

    def work() -> None:
        (folder / "out.csv").unlink(missing_ok=True)
        apply_to_table(calibration, folder / "in.csv", folder / "out.csv", columns)

    per_s = rate(TABLE_ROWS, work, 2)
    say(f"\nA table of {TABLE_ROWS} rows: {per_s / 1e6:.2f} million rows a second")


def recording(calibration: Calibration, folder: Path) -> None:
    """Print how fast a recording is, read, mapped, applied, copied and written."""
    count = RECORDED_S * RATE_HZ
    counts = np.random.default_rng(3).integers(-3000, 3000, size=(count, 3))
    board = {"uid": "u", "sensor": "L3G4200D", "link": "serial", "tick_hz": "1000000.0"}
    board |= {"gyro_scale_rad_s": repr(calibration.nominal_scale_rad_s), "counter_bits": "64"}
    metadata = {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}
    taken_ns = np.rint(np.arange(count) * 1e9 / RATE_HZ).astype(np.int64)
    late_ns = np.random.default_rng(4).exponential(2e5, count).astype(np.int64)
    arrived_ns = np.maximum.accumulate(1_790_000_000_000_000_000 + taken_ns + late_ns)
    writer = RecordingWriter(
        folder / "in.mcap", {"gyrorig": metadata, f"gyrorig.board.{BOARD}": board}
    )
    for first in range(0, count, RATE_HZ):
        rows = slice(first, first + RATE_HZ)
        writer.write_imu_array(
            BOARD,
            host_time_ns=arrived_ns[rows],
            publish_time_ns=None,
            device_time=taken_ns[rows] // 1000,
            sequence=np.arange(count)[rows],
            status=np.zeros(count, dtype=int)[rows],
            temperature=np.zeros(count, dtype=int)[rows],
            gyro=counts[rows],
        )
        writer.flush()
    source = writer.close()

    def work() -> None:
        (folder / "out.mcap").unlink(missing_ok=True)
        apply_to_recording(calibration, source, folder / "out.mcap")

    per_s = rate(count, work, 3)
    sizes = [path.stat().st_size / 1e6 for path in (source, folder / "out.mcap")]
    say(
        f"A recording of {RECORDED_S} s at {RATE_HZ} Hz: {per_s / 1e6:.2f} million samples a "
        f"second, {per_s / RATE_HZ:.0f} times as fast as it was recorded; {sizes[0]:.1f} MB become "
        f"{sizes[1]:.1f}"
    )


def main() -> int:
    """Print all of it; 1 where the bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=4_000_000)
    parser.add_argument("--repeat", type=int, default=5)
    asked = parser.parse_args()
    calibration = Calibration.load(GOLDEN)
    measured = arrays(calibration, asked.samples, asked.repeat)
    with tempfile.TemporaryDirectory() as name:
        table(calibration, Path(name))
        recording(calibration, Path(name))
    if measured < LEAST_M_PER_S * 1e6:
        say(f"missed: {measured / 1e6:.0f} of {LEAST_M_PER_S:.0f} million samples a second")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
