"""Sixteen boards on one unit, fitted together against each by itself: what it gains and costs.

Sessions of `config/rig-sixteen.yaml` in simulated time, eight boards on serial ports, eight on
CAN, with a unit that is asked fast and one that is asked slowly. Each board is fitted alone
and all together; both are held against the truth: the calibrations, how far the times of the
boards of a bus are from each other, and with `--cause` the size of what the unit hides.

Run: python tests/bench/bench_many_boards.py [--sessions 2] [--cause s_curve:0.03]
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.injection import parse_injection
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_daemon.session.session import record_session
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import SessionEnvironment
from gyrorig_protocol.documents import dump_yaml, parse_yaml
from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import parse_program
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.estimate import FittedTerm, GyroFit
from gyrorig_solver.model import FACTOR_NAMES, factorise
from gyrorig_solver.pipeline import solve_recordings
from gyrorig_solver.pipeline.board_results import BoardExplanation
from gyrorig_solver.pipeline.criticised_fit import JointFit, solve_jointly
from gyrorig_solver.pipeline.explain_board import explain_unit_boards
from gyrorig_solver.pipeline.joint_data import load_jointly

ROOT = Path(__file__).resolve().parents[2]
ORIGIN_NS = 5_000_000_000
# baud of the unit's line, and how long its controller thinks about a command, ms
UNITS = {"asked fast": (115200, 5.0), "asked slowly": (9600, 100.0)}
GROUPS = ("scale", "nonorthogonality", "misalignment")


@dataclass(frozen=True)
class JointComparison:
    """One session: alone first, together second."""

    std: np.ndarray  # (2, boards, 9)
    error: np.ndarray  # (2, boards, 9)
    cpu_s: tuple[float, float]
    together: int
    apart_s: tuple[float, float]  # between the times of boards of a bus, rms
    cause: np.ndarray  # (2, boards, values), of the hidden one: value
    cause_std: np.ndarray


def session(
    seed: int, baud: int, command_time_ms: float, folder: Path, hide: Sequence[str] = ()
) -> JointComparison:
    """Record and solve one session both ways."""
    path, rig, end_ns = _recorded(seed, baud, command_time_ms, folder, hide)
    truth = {name: board.imu.gain for name, board in rig.truth.boards.items()}
    recording = read_recording(path)
    boards = recording.board_ids
    joint_data = load_jointly([recording], boards)
    explained = explain_unit_boards(joint_data) if hide else {}
    named = {
        str(board): explanation.findings.fitted_terms
        for board, explanation in explained.items()
        if isinstance(explanation, BoardExplanation)
    }
    begun_s = time.process_time()
    alone = {
        board: solve_recordings([recording], board, named_terms=_own_terms(named.get(board, ())))
        for board in boards
    }
    half_s = time.process_time()
    together = solve_jointly(load_jointly([recording], boards), named_terms=named)
    cpu_s = half_s - begun_s, time.process_time() - half_s
    std, error = np.zeros((2, len(boards), 9)), np.zeros((2, len(boards), 9))
    taken = 0
    for n, board in enumerate(boards):
        true = factorise(truth[board]).as_vector()
        for way, fit in enumerate((alone[board], _fit(together[board]))):
            std[way, n] = [fit.std[name] for name in FACTOR_NAMES]
            error[way, n] = [fit.value(name) for name in FACTOR_NAMES] - true
        taken += int(_fit(together[board]).sharing.fitted_together is not None)
    on_bus = [board for board in boards if board.startswith("C")]
    apart_s = (
        _apart_s(recording, rig, end_ns, {b: load_samples(recording, b) for b in on_bus}),
        _apart_s(recording, rig, end_ns, _shared_samples(recording, on_bus)),
    )
    values = np.array(
        [
            [_causes(fit) for fit in fits]
            for fits in (alone.values(), [_fit(together[b]) for b in boards])
        ]
    )
    return JointComparison(std, error, cpu_s, taken, apart_s, values[..., 0], values[..., 1])


def _own_terms(named: Sequence[FittedTerm]) -> list[FittedTerm]:
    """Return causes as one board knows them, not told of the others."""
    return [replace(cause, other_boards_prior=None) for cause in named]


def _causes(fit: GyroFit) -> np.ndarray:
    """Return the values of the causes fitted to a board and their deviations, (values, 2)."""
    pairs = [np.column_stack([cause.value, cause.std]) for cause in fit.causes]
    return np.concatenate(pairs) if pairs else np.zeros((0, 2))


def _apart_s(
    recording: Recording,
    rig: EmulatedRig,
    end_ns: int,
    samples: Mapping[str, GyroSamples],
) -> float:
    """Return how far the times of boards of one bus are from each other, by the true clocks."""
    late: dict[int, list[np.ndarray]] = {}
    first = max(
        float(board_samples.time_s[0]) + board_samples.origin_ns * 1e-9
        for board_samples in samples.values()
    )
    last = min(
        float(board_samples.time_s[-1]) + board_samples.origin_ns * 1e-9
        for board_samples in samples.values()
    )
    grid_s = np.linspace(first, last, 400)
    start_ns = min(board_samples.origin_ns for board_samples in samples.values())
    for board, board_samples in samples.items():
        clock = rig.boards[board].clock
        ticks = recording.imu_columns(BoardId(board_samples.board)).device_time.astype(np.float64)
        ticks = np.unwrap(ticks, period=2.0**32)[-board_samples.time_s.size :]
        knots_ns = ORIGIN_NS + np.arange(0, end_ns - ORIGIN_NS + 100_000_000, 50_000_000)
        seconds = np.array([clock.seconds(int(at)) for at in knots_ns])
        shown = seconds * clock.truth.tick_hz + clock.truth.start_ticks
        # The counter may have wrapped before the first sample.
        ticks += 2.0**32 * np.round((shown.mean() - ticks.mean()) / 2.0**32)
        true_s = np.interp(ticks, shown, (knots_ns - ORIGIN_NS) * 1e-9)
        error_s = board_samples.time_s + (board_samples.origin_ns - start_ns) * 1e-9 - true_s
        at_s = np.interp(grid_s - board_samples.origin_ns * 1e-9, board_samples.time_s, error_s)
        late.setdefault(_bus(board), []).append(at_s)
    squares = [(np.array(each) - np.mean(each, axis=0)) ** 2 for each in late.values()]
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def _bus(board: str) -> int:
    """Return which of the rig's two buses a board of `rig-sixteen` is on."""
    return (int(board[1:]) - 1) // 4


def _shared_samples(recording: Recording, boards: Sequence[str]) -> dict[str, GyroSamples]:
    """Return the samples of boards on one bus, on their common time base."""
    loaded = load_jointly([recording], boards).boards
    return {board: data.samples[0] for board, data in loaded.items()}


def _fit(joint_fit: JointFit | GyrorigError) -> GyroFit:
    if isinstance(joint_fit, GyrorigError):
        raise joint_fit
    return joint_fit.fit


def _recorded(
    seed: int, baud: int, command_time_ms: float, folder: Path, hide: Sequence[str]
) -> tuple[Path, EmulatedRig, int]:
    document = parse_yaml((ROOT / "config" / "rig-sixteen.yaml").read_bytes(), "rig.yaml")
    document["ptu"]["baud"] = baud
    document["emulator"]["command_time_ms"] = command_time_ms
    config_text = dump_yaml(document).encode()
    config = parse_rig(config_text, "rig.yaml")
    program_text = (ROOT / "config" / "programs" / "quick.yaml").read_bytes()
    settings = replace(
        emulated_rig_settings(config, seed),
        injections=tuple(parse_injection(text) for text in hide),
    )
    rig = EmulatedRig(settings, ORIGIN_NS)
    hub = VirtualHub(rig)
    capture = CaptureClock(1_767_232_800_000_000_000 + 10**12 * seed, hub.now_ns())

    def read_host() -> HostClocks:
        now_ns = hub.now_ns()
        return HostClocks(now_ns, now_ns, capture.utc_ns(now_ns), 0.0, 0.0, 0)

    around = SessionEnvironment(
        capture, read_host, threaded_writer=False, host="emulated", seed=seed
    )
    order = SessionRequest(
        config=config,
        config_text=config_text,
        program=parse_program(program_text, "quick.yaml"),
        program_text=program_text,
        out_dir=folder,
        session=f"s{seed}",
    )
    path = record_session(hub, order, around)
    return path, rig, hub.now_ns()


def result_lines(comparisons: Sequence[JointComparison]) -> list[str]:
    """Return the figures in words."""
    std = np.concatenate([comparison.std for comparison in comparisons], axis=1)
    error = np.concatenate([comparison.error for comparison in comparisons], axis=1)
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
    us = (
        np.sqrt(np.mean(np.square([comparison.apart_s for comparison in comparisons]), axis=0))
        * 1e6
    )
    lines.append(f"  times of a bus' boards apart by {us[0]:.2f} us alone, {us[1]:.2f} us together")
    lines += _cause_lines(comparisons)
    cpu = np.sum([comparison.cpu_s for comparison in comparisons], axis=0) / len(comparisons)
    lines.append(
        f"  {cpu[0]:.2f} s of CPU alone, {cpu[1]:.2f} s together, "
        f"{comparisons[0].std.shape[1]} boards; "
        f"took part: {', '.join(str(comparison.together) for comparison in comparisons)}"
    )
    return lines


def _cause_lines(comparisons: Sequence[JointComparison]) -> list[str]:
    """Return how well the hidden cause's sizes are known, where all sessions named the same."""
    sizes = {comparison.cause.shape for comparison in comparisons}
    if len(sizes) != 1 or not comparisons[0].cause.shape[-1]:
        return []
    lines = []
    for way, name in enumerate(("alone", "together")):
        values = np.array([comparison.cause[way] for comparison in comparisons])
        std = np.array([comparison.cause_std[way] for comparison in comparisons])
        apart = np.ptp(values, axis=1).mean(axis=0)
        lines.append(
            f"  the cause, {name}: {np.round(values.mean(axis=(0, 1)), 6)}, deviation "
            f"{np.round(std.mean(axis=(0, 1)), 6)}, boards apart {np.round(apart, 6)}"
        )
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 where the joint fit knows less or says too much."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sessions", type=int, default=2, help="of each unit")
    parser.add_argument("--seed", type=int, default=900)
    parser.add_argument(
        "--cause", default="", help="hidden in the unit, as `emulate --hide` has it"
    )
    options = parser.parse_args(arguments)
    worse = False
    for name, (baud, command_time_ms) in UNITS.items():
        comparisons = []
        for n in range(options.sessions):
            with tempfile.TemporaryDirectory() as folder:
                comparisons.append(session(
                    options.seed + n, baud, command_time_ms, Path(folder),
                    [options.cause] if options.cause else [],
                ))  # fmt: skip
        sys.stdout.write(
            f"{name}, {len(comparisons)} sessions\n" + "\n".join(result_lines(comparisons)) + "\n"
        )
        sys.stdout.flush()
        std = np.concatenate([comparison.std for comparison in comparisons], axis=1)
        worse |= bool(np.mean(std[1] / std[0]) > 1.02)
    return int(worse)


if __name__ == "__main__":
    sys.exit(main())
