"""Sixteen boards on one unit, fitted together against each by itself: what it gains and costs.

Sessions of `config/rig-sixteen.yaml` in simulated time, eight boards on serial ports, eight on
CAN, with a unit that is asked fast and one that is asked slowly. Each board is fitted alone
and all together; both are held against the truth.

Run: python tests/bench/bench_many_boards.py [--sessions 2]
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.description import SessionOrder
from gyrorig_daemon.emulated import rig_settings
from gyrorig_daemon.emulator.rig import EmulatedRig
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.links.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.session import Surroundings, record_session
from gyrorig_protocol.documents import dump_yaml, parse_yaml
from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.program import parse_program
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.model.gain import FACTOR_NAMES, factorise
from gyrorig_solver.solve import solve_on_one_unit, solve_recordings

ROOT = Path(__file__).resolve().parents[2]
ORIGIN_NS = 5_000_000_000
# baud of the unit's line, and how long its controller thinks about a command, ms
UNITS = {"asked fast": (115200, 5.0), "asked slowly": (9600, 100.0)}
GROUPS = ("scale", "nonorthogonality", "misalignment")


@dataclass(frozen=True)
class Compared:
    """One session: alone first, together second."""

    std: np.ndarray  # (2, boards, 9)
    error: np.ndarray  # (2, boards, 9)
    cpu_s: tuple[float, float]
    together: int


def session(seed: int, baud: int, command_time_ms: float, folder: Path) -> Compared:
    """Record and solve one session both ways."""
    path, truth = _recorded(seed, baud, command_time_ms, folder)
    recording = read_recording(path)
    boards = recording.board_ids
    begun_s = time.process_time()
    alone = {board: solve_recordings([recording], board) for board in boards}
    half_s = time.process_time()
    together = solve_on_one_unit([recording], boards)
    cpu_s = half_s - begun_s, time.process_time() - half_s
    std, error = np.zeros((2, len(boards), 9)), np.zeros((2, len(boards), 9))
    taken = 0
    for n, board in enumerate(boards):
        true = factorise(truth[board]).as_vector()
        for way, fit in enumerate((alone[board], _fit(together[board]))):
            std[way, n] = [fit.std[name] for name in FACTOR_NAMES]
            error[way, n] = [fit.value(name) for name in FACTOR_NAMES] - true
        taken += int("boards_together" in _fit(together[board]).extra)
    return Compared(std, error, cpu_s, taken)


def _fit(found: GyroFit | GyrorigError) -> GyroFit:
    if isinstance(found, GyrorigError):
        raise found
    return found


def _recorded(
    seed: int, baud: int, command_time_ms: float, folder: Path
) -> tuple[Path, dict[str, np.ndarray]]:
    document = parse_yaml((ROOT / "config" / "rig-sixteen.yaml").read_bytes(), "rig.yaml")
    document["ptu"]["baud"] = baud
    document["emulator"]["command_time_ms"] = command_time_ms
    config_text = dump_yaml(document).encode()
    config = parse_rig(config_text, "rig.yaml")
    program_text = (ROOT / "config" / "programs" / "quick.yaml").read_bytes()
    rig = EmulatedRig(rig_settings(config, seed), ORIGIN_NS)
    hub = VirtualHub(rig)
    capture = CaptureClock(1_767_232_800_000_000_000 + 10**12 * seed, hub.now_ns())

    def read_host() -> HostClocks:
        now_ns = hub.now_ns()
        return HostClocks(now_ns, now_ns, capture.utc_ns(now_ns), 0.0, 0.0, 0)

    around = Surroundings(capture, read_host, threaded_writer=False, host="emulated", seed=seed)
    order = SessionOrder(
        config=config,
        config_text=config_text,
        program=parse_program(program_text, "quick.yaml"),
        program_text=program_text,
        out_dir=folder,
        session=f"s{seed}",
    )
    path = record_session(hub, order, around)
    return path, {name: board.imu.gain for name, board in rig.truth.boards.items()}


def said(found: Sequence[Compared]) -> list[str]:
    """Return the figures in words."""
    std = np.concatenate([one.std for one in found], axis=1)
    error = np.concatenate([one.error for one in found], axis=1)
    z = error / std
    lines = []
    for group in GROUPS:
        at = [n for n, name in enumerate(FACTOR_NAMES) if name.startswith(group)]
        lines.append(
            f"  {group}: deviation together / alone {(std[1] / std[0])[:, at].mean():.3f}, error "
            f"{np.sqrt(np.mean(error[1][:, at] ** 2) / np.mean(error[0][:, at] ** 2)):.3f}"
        )
    for way, name in enumerate(("alone", "together")):
        inside = np.mean(np.abs(z[way]) < 1.96)
        lines.append(
            f"  {name}: {inside:.1%} of {z[way].size} values inside their 95 % interval, rms "
            f"{np.sqrt(np.mean(z[way] ** 2)):.3f} deviations"
        )
    cpu = np.sum([one.cpu_s for one in found], axis=0) / len(found)
    lines.append(
        f"  {cpu[0]:.2f} s of CPU alone, {cpu[1]:.2f} s together, {found[0].std.shape[1]} boards; "
        f"took part: {', '.join(str(one.together) for one in found)}"
    )
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 where the joint fit knows less or says too much."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sessions", type=int, default=2, help="of each unit")
    parser.add_argument("--seed", type=int, default=900)
    told = parser.parse_args(arguments)
    worse = False
    for name, (baud, command_time_ms) in UNITS.items():
        found = []
        for n in range(told.sessions):
            with tempfile.TemporaryDirectory() as folder:
                found.append(session(told.seed + n, baud, command_time_ms, Path(folder)))
        sys.stdout.write(f"{name}, {len(found)} sessions\n" + "\n".join(said(found)) + "\n")
        sys.stdout.flush()
        std = np.concatenate([one.std for one in found], axis=1)
        worse |= bool(np.mean(std[1] / std[0]) > 1.02)
    return int(worse)


if __name__ == "__main__":
    sys.exit(main())
