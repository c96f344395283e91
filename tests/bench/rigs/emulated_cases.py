"""Six recordings of the emulated rig, each with one cause that a calibration may not show.

Each lasts about 300 s with a board at 100 Hz and the unit polled at 115200 baud. The unit of the
last case is configured with base speed 0 and has 3.5 deg/s.
"""

import json
import math
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from tests.bench.accuracy.board import NAMES, factors
from tests.bench.rigs.trial import K_95, read_calibration, sigmas, solve_by_program

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = ROOT / "config" / "programs" / "planned-300.yaml"
RIG = ROOT / "config" / "rig.yaml"
ONE_STEP_DEG_S = 185.142857 / 3600.0  # the smallest base speed that a unit takes is one step
BASE_SPEED_RAD_S = math.radians(3.5)


@dataclass(frozen=True, slots=True)
class EmulatedCase:
    """One cause, as `gyrorigd record --hide` takes it."""

    name: str
    causes: tuple[str, ...]
    seed: int
    base_speed_deg_s: float = 3.0


CASES = (
    EmulatedCase("perpendicularity", ("axis_nonorthogonality@tilt:0.0026",), 11),
    EmulatedCase("saturation", ("saturation@z:1.7",), 12),
    EmulatedCase("cubic scale factor", ("scale_cubic@z:0.001",), 13),
    EmulatedCase("base compliance", ("base_compliance@pan:0.00005",), 14),
    EmulatedCase("eccentricity", ("eccentricity@pan:0.00087",), 15),
    EmulatedCase(
        "base speed",
        tuple(f"base_speed_jump@{axis}:{BASE_SPEED_RAD_S:.6f}" for axis in ("pan", "tilt")),
        16,
        ONE_STEP_DEG_S,
    ),
)


def record_case(case: EmulatedCase, folder: Path, program: Path = PROGRAM) -> Path:
    """Record one case with the daemon of this tree; return the recording.

    The true values stand in `truth.json` beside it. A recording that is there is kept.
    """
    made = sorted(folder.glob("*.mcap"))
    if made:
        return made[0]
    folder.mkdir(parents=True, exist_ok=True)
    document = yaml.safe_load(program.read_text(encoding="utf-8"))
    document["settings"]["base_speed_deg_s"] = case.base_speed_deg_s
    program_path = folder / "program.yaml"
    program_path.write_text(yaml.safe_dump(document), encoding="utf-8")
    command = [str(Path(sys.executable).with_name("gyrorigd")), "record", "--simulated-time"]
    command += ["--config", str(RIG), "--program", str(program_path), "--out", str(folder)]
    command += ["--truth", str(folder / "truth.json"), "--seed", str(case.seed)]
    for cause in case.causes:
        command += ["--hide", cause]
    subprocess.run(command, check=True, capture_output=True)
    return next(folder.glob("*.mcap"))


def true_parameters(path: Path) -> list[float]:
    """Return the true parameters of the emulator's document in the order of `NAMES`."""
    (board,) = json.loads(path.read_text(encoding="utf-8"))["boards"].values()
    delay_s = board["tau_s"] + math.sqrt(2.0) / (2.0 * math.pi * board["low_pass"]["cutoff_hz"])
    gain = factors(np.array(board["STM"], dtype=np.float64))
    return [*board["mean_bias_rad_s"], *gain.tolist(), delay_s]


def judge_case(
    case: EmulatedCase, folder: Path, program: str, options: tuple[str, ...]
) -> dict[str, Any]:
    """Record a case where it is missing, solve it with a `gyrorig` program, and compare."""
    recording = record_case(case, folder / "recordings" / case.name.replace(" ", "-"))
    out = folder / "out" / case.name.replace(" ", "-")
    code, output = solve_by_program(program, options)(recording, out)
    written = sorted(out.glob("*/v*.yaml"), key=lambda path: path.stat().st_mtime)
    written = [path for path in written if path.stem.removeprefix("v").isdigit()]
    row: dict[str, Any] = {"case": case.name, "exit_code": code}
    if not written:
        return row | {"failed": output.strip()[-200:]}
    row |= read_calibration(written[-1])
    return row | {"truth": true_parameters(recording.with_name("truth.json"))}


def case_line(row: dict[str, Any]) -> str:
    """Return one line of the table."""
    if "failed" in row:
        return f"| {row['case']} | - | {row['failed']} | - | - | - |"
    named = ", ".join(dict.fromkeys([*row["named"], *row["terms"]])) or "-"
    outside = int(np.sum(np.abs(sigmas(row, "std")) > K_95))
    cells = [row["case"], row["verdict"], _largest(row, "std"), f"{outside} of 13"]
    return "| " + " | ".join([*cells, _largest(row, "total"), named]) + " |"


def _largest(row: dict[str, Any], stated: str) -> str:
    z = np.abs(sigmas(row, stated))
    if not np.any(np.isfinite(z)):
        return "-"
    return f"{np.nanmax(z):.1f}, `{NAMES[int(np.nanargmax(z))]}`"
