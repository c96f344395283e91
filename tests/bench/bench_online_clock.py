"""How well the online map dates samples and answers, against the emulator's truth.

Sessions of 75 s under simulated time; each sample's `publish_time` is compared with the
moment at which its device's clock really showed its stamp, and so is each BT answer's with
the moment of its counter. Beside it: the arrival (`log_time`), which is what a logger
without a map would use. Bias is the mean, wander the rms about it, from 10 s on.

Run: python tests/bench/bench_online_clock.py [--seeds 5] [--seconds 75]
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.config import RigConfig, parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.physics.device_clock import DeviceClock
from gyrorig_daemon.emulator.ptu import EmulatedPtu
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_daemon.session.session import record_session
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import SessionEnvironment
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import MotionProgram, Rest, Step
from gyrorig_protocol.recording.messages import PTU_POSITION_TOPIC, imu_raw_topic
from gyrorig_protocol.recording.reader import read_recording

ORIGIN_NS = 5_000_000_000
UTC_NS = 1_790_000_000_000_000_000
SETTLED_S = 10.0
GRID_NS = 1_000_000_000

RIG = """
rig: bench
ptu: {{port: emulated, baud: {ptu_baud}}}
boards: [{{id: B, port: emulated, baud: {baud}}}]
emulator: {{odr_hz: {odr}, bandwidth_hz: {bandwidth}, seed: {seed}}}
"""

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


def record(config: RigConfig, seconds: float, folder: Path) -> tuple[Path, EmulatedRig]:
    """Record a rest and return the recording and the rig behind it."""
    rig = EmulatedRig(emulated_rig_settings(config), ORIGIN_NS)
    hub = VirtualHub(rig)
    capture = CaptureClock(UTC_NS, ORIGIN_NS)
    program = MotionProgram("rest", (Step(rest=Rest(seconds, "static")),))
    order = SessionRequest(config, b"", program, b"", folder, f"s{config.emulator.seed}")

    def read_host() -> HostClocks:
        return HostClocks(hub.now_ns(), hub.now_ns(), capture.utc_ns(hub.now_ns()), 0.0, 0.0, 0)

    around = SessionEnvironment(capture, read_host, False, "bench", config.emulator.seed)
    return record_session(hub, order, around), rig


def true_ns(clock: DeviceClock, stamps: IntArray, arrival_ns: IntArray, bits: int) -> FloatArray:
    """Return when the clock showed each stamp: the inverse of its own knots."""
    grid_ns = np.arange(ORIGIN_NS, int(arrival_ns[-1]) + 3 * GRID_NS, GRID_NS)
    shown = np.array([clock.ticks(int(at)) for at in grid_ns], dtype=np.float64)
    shown_at_arrival = np.interp(arrival_ns, grid_ns, shown)
    wraps = np.round((shown_at_arrival - stamps) / 2.0**bits)
    ticks = stamps + wraps * 2.0**bits
    mapped_ns: FloatArray = np.interp(ticks, shown, grid_ns.astype(np.float64))
    return mapped_ns


def row(name: str, errors_us: FloatArray, arrival_us: FloatArray) -> str:
    """Return a line of the table."""
    wander = float(np.std(errors_us))
    p99 = float(np.percentile(np.abs(errors_us), 99))
    return (
        f"{name:34} {errors_us.mean():9.1f} {wander:8.2f} {p99:8.1f} "
        f"{np.abs(errors_us).max():8.1f} {arrival_us.mean():10.1f} {np.std(arrival_us):9.1f}"
    )


def errors(path: Path, rig: EmulatedRig, topic: str, clock: DeviceClock) -> list[FloatArray]:
    """Return the errors of publish_time and of log_time in us, after settling."""
    rows = read_recording(path).array(topic)
    offset_ns = UTC_NS - ORIGIN_NS
    arrival_ns = rows["log_time"].astype(np.int64) - offset_ns
    published_ns = rows["publish_time"].astype(np.int64) - offset_ns
    field = "controller_time" if topic == PTU_POSITION_TOPIC else "device_time"
    truth = true_ns(clock, rows[field].astype(np.int64), arrival_ns, 32)
    settled = arrival_ns > arrival_ns[0] + SETTLED_S * 1e9
    return [(times - truth)[settled] * 1e-3 for times in (published_ns, arrival_ns)]


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--seeds", type=int, default=5)
    arguments.add_argument("--seconds", type=float, default=75.0)
    given = arguments.parse_args()
    print(f"{'us':34} {'bias':>9} {'wander':>8} {'p99':>8} {'max':>8} {'arrival':>10} {'rms':>9}")  # noqa: T201
    for odr, baud, ptu_baud in ((100, 460800, 115200), (100, 115200, 9600), (800, 460800, 115200)):
        errors_by_device: dict[str, list[list[FloatArray]]] = {"board": [], "unit": []}
        for seed in range(given.seeds):
            text = RIG.format(
                odr=odr, bandwidth=50 if odr == 800 else 25, baud=baud, ptu_baud=ptu_baud, seed=seed
            )
            with tempfile.TemporaryDirectory() as folder:
                path, rig = record(parse_rig(text, "bench"), given.seconds, Path(folder))
                board = rig.boards["B"].clock
                errors_by_device["board"].append(
                    errors(path, rig, imu_raw_topic(BoardId("B")), board)
                )
                if isinstance(rig.ptu, EmulatedPtu):
                    unit = rig.ptu.unit.clock
                    errors_by_device["unit"].append(errors(path, rig, PTU_POSITION_TOPIC, unit))
        for name, seeds in errors_by_device.items():
            rate = f"{odr} Hz {baud}" if name == "board" else f"BT {ptu_baud}"
            label = f"{name} {rate}, {given.seeds} seeds"
            joined = [np.concatenate([each[at] for each in seeds]) for at in (0, 1)]
            print(row(label, joined[0], joined[1]))  # noqa: T201
            wander = float(np.mean([np.std(each[0]) for each in seeds]))
            print(f"{'  mean wander within a session':34} {'':9} {wander:8.2f}")  # noqa: T201


if __name__ == "__main__":
    main()
