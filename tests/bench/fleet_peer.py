"""Calibrate recordings without this project: with the public MCAP reader and SciPy.

The packages mcap and mcap-ros2-support decode every message into an object. The script
interpolates and differentiates the position replies of the unit, and smooths the samples and the
reference in the same way. A fit with a numeric Jacobian gives scale, skew, rotation, bias and
time offset. The script reads one file after the other, and prints one line per recording.

Run: python tests/bench/fleet_peer.py SPOOL
"""

import json
import os
import sys
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.ndimage import gaussian_filter1d
from tests.bench.peers.methods import fit_numeric
from tests.bench.peers.recording import SMOOTH_S, Table, stage_rate_rad_s

FloatArray = np.ndarray


def read_table(path: Path) -> Table:
    """Read one recording message by message."""
    counts: list[tuple[float, float, float, float]] = []
    replies: list[tuple[float, float, float]] = []
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        scale, rate_hz = 1.0, 100.0
        for metadata in reader.iter_metadata():
            if metadata.name.startswith("gyrorig.board."):
                scale = float(metadata.metadata["gyro_scale_rad_s"])
                rate_hz = float(metadata.metadata["odr_hz"])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            time_s = message.publish_time * 1e-9
            if channel.topic.endswith("/imu_raw"):
                x, y, z = decoded.gyro
                counts.append((time_s, x, y, z))
            elif channel.topic == "/ptu/position":
                replies.append((time_s, decoded.pan, decoded.tilt))
    samples, positions = np.array(sorted(counts)), np.array(sorted(replies))
    first_s = samples[0, 0]
    time_s, reply_s = samples[:, 0] - first_s, positions[:, 0] - first_s
    raw = samples[:, 1:] * scale
    width = SMOOTH_S * rate_hz
    angle = [np.interp(time_s, reply_s, positions[:, axis]) for axis in (1, 2)]
    rate = [gaussian_filter1d(angles, width, order=1) * rate_hz for angles in angle]
    stage = stage_rate_rad_s(gaussian_filter1d(angle[1], width), rate[0], rate[1])
    use = np.ones(time_s.size, dtype=np.bool_)
    measured = gaussian_filter1d(raw, width, axis=0)
    return Table(time_s, rate_hz, raw, measured, stage, ~use, use, angle[0], angle[1])


def main(spool: Path) -> int:
    """Calibrate every recording of a folder, and print one line per recording."""
    for path in sorted(spool.glob("*.mcap")):
        start_s = time.process_time()
        table = read_table(path)
        read_s = time.process_time() - start_s
        value = fit_numeric(table)[0]
        took = {"read_s": read_s, "cpu_s": time.process_time() - start_s}
        sys.stdout.write(json.dumps({"name": path.name, **took, "value": list(value)}) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
