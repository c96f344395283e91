"""Whether a fit that has not converged is ever presented as a result.

Each session is an emulated rig with 0 to 8 causes of usual sizes, under a motion program of 20 or
40 s, held in simulated time and solved with the search for causes. The fit whose values a solve
states is checked again here: the next full step from its end, and what that step changes in the
objective. Each row of the output is one session; sessions that are there are not run again.

Run: python tests/bench/bench_convergence.py --sessions 2000 --out rows.jsonl [--first SEED]
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from tests.hidden.truth.draws import SIZED
from tests.hidden.truth.session import BOARD, RigDraw, record
from tests.support.next_step import is_at_optimum, next_step

from gyrorig_daemon.emulator.emulator_settings import InjectionRequest
from gyrorig_daemon.emulator.injection import CAUSES
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.estimate.trust_region import NotConvergedError
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.criticised_fit import AUTO, fit_criticised

MAX_CAUSES = 8
PROGRAM_SHARES = {"short-20": 0.8, "quick": 0.2}
FOUND = ("converged", "refused", "failed")


def draw_session(seed: int) -> RigDraw:
    """Return the rig of a session: its causes, their places and sizes, and its program."""
    rng = np.random.default_rng([seed, 0x434F])
    names = rng.permutation(SIZED)[: int(rng.integers(0, MAX_CAUSES + 1))].tolist()
    program = str(rng.choice(list(PROGRAM_SHARES), p=list(PROGRAM_SHARES.values())))
    hidden = []
    for name in names:
        cause = CAUSES[name]
        has_place = bool(cause.components) and not cause.acts_on_all
        place = str(rng.choice(cause.components)) if has_place else ""
        size = float(cause.typical * np.exp(0.4 * rng.standard_normal()))
        size = float(np.clip(size, cause.sampled_min, cause.sampled_max))
        size = float(max(round(size), 1)) if cause.is_integer else size
        sign = float(rng.choice((-1.0, 1.0))) if cause.is_signed else 1.0
        hidden.append(InjectionRequest(name, place, sign * size))
    return RigDraw(seed, program, hide=tuple(hidden))


def run_session(seed: int, folder: Path) -> dict[str, Any]:
    """Record and solve one session; return its row."""
    draw = draw_session(seed)
    row: dict[str, Any] = {"seed": seed, "program": draw.program}
    row["causes"] = [request.cause for request in draw.hide]
    path = folder / f"{seed}.mcap"
    begin_s = time.process_time()
    try:
        record(draw, path)
        row["record_s"] = round(time.process_time() - begin_s, 2)
        begin_s = time.process_time()
        criticised = fit_criticised(load_board([read_recording(path)], BoardId(BOARD)), (AUTO,))
    except NotConvergedError as refusal:
        row |= {"found": "refused", "moving": refusal.moving}
    except (InputError, ArithmeticError, np.linalg.LinAlgError) as fault:
        row |= {"found": "failed", "reason": f"{type(fault).__name__}: {fault}"}
    else:
        solution, explanation = criticised.solution, criticised.explanation
        row |= {"found": "converged", "flag": solution is None or solution.converged}
        if explanation is not None and explanation.fit_explanation is not None:
            row["base_flag"] = explanation.fit_explanation.solution_base.converged
            row["named"] = [cause.cause for cause in explanation.findings.causes]
            row["left_out"] = list(explanation.fit_explanation.remarks)
        if solution is not None:
            row |= next_step(solution)
    finally:
        path.unlink(missing_ok=True)
    row["solve_s"] = round(time.process_time() - begin_s, 2)
    return row


def is_unconverged_result(row: dict[str, Any]) -> bool:
    """Return whether a session states values of a fit that is not at its optimum."""
    if row["found"] != "converged":
        return False
    return not row["flag"] or not is_at_optimum(row)


def summary(rows: list[dict[str, Any]]) -> str:
    """Return the counts, and each session that breaks the rule."""
    counts = Counter(row["found"] for row in rows)
    off = [row for row in rows if is_unconverged_result(row)]
    lines = [f"{len(rows)} sessions: " + ", ".join(f"{counts[k]} {k}" for k in FOUND)]
    raised = sum(row.get("flag", True) for row in rows)
    lines.append(f"results from a fit with the flag down: {len(rows) - raised}")
    lines.append(f"results from a fit that the second check rejects: {len(off)}")
    lines += [f"  {json.dumps(row)}" for row in off]
    moving = Counter(row["moving"] for row in rows if row["found"] == "refused")
    lines += [f"refused, {name} still moves: {count}" for name, count in moving.most_common()]
    lines += [f"  failed: {row['seed']}: {row['reason']}" for row in rows if row.get("reason")]
    return "\n".join(lines)


def main() -> int:
    """Run the sessions that are missing and print the counts; 1 where the rule is broken."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sessions", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    lines = asked.out.read_text(encoding="utf-8").splitlines() if asked.out.exists() else []
    rows = [json.loads(line) for line in lines]
    finished = {row["seed"] for row in rows}
    with tempfile.TemporaryDirectory() as name, asked.out.open("a", encoding="utf-8") as file:
        for seed in range(asked.first, asked.first + asked.sessions):
            if seed not in finished:
                rows.append(run_session(seed, Path(name)))
                file.write(json.dumps(rows[-1]) + "\n")
                file.flush()
    print(summary(rows))  # noqa: T201
    return int(any(is_unconverged_result(row) for row in rows))


if __name__ == "__main__":
    sys.exit(main())
