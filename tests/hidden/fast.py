"""Sessions of the fast tier: another process records them, and this process explains them.

What to use when: `Sessions` in a test module, once for all tests of the module.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.hidden.scoring.answers import Answer, HiddenCause
from tests.hidden.scoring.outcome import Outcome, judge_case
from tests.hidden.scoring.stated import StatedExplanation, explain_recording, make_line
from tests.hidden.scoring.variants import REAL, VARIANTS

HERE = Path(__file__).resolve().parent
SESSIONS = HERE / "fast_tier.json"
RECORDER = HERE / "record_fast.py"
Line = dict[str, Any]


def read_sessions() -> list[Line]:
    """Return the sessions of the fast tier, with their drawn causes and sizes."""
    lines: list[Line] = json.loads(SESSIONS.read_text(encoding="utf-8"))
    return lines


def get_name(line: Line) -> str:
    """Return the name of a session and of its recording."""
    return str(line.get("name", line["seed"]))


class Sessions:
    """Some sessions; each variant of the solver explains each of them once."""

    def __init__(self, folder: Path, lines: Sequence[Line]) -> None:
        """Start the recorder in another process: truth and solver share only files."""
        self.lines = list(lines)
        self._folder = folder
        self._recorded_names: set[str] = set()
        self._explanations: dict[tuple[str, str], StatedExplanation] = {}
        lines_path = folder / "lines.json"
        lines_path.write_text(json.dumps(self.lines), encoding="utf-8")
        command = [sys.executable, str(RECORDER), "--out", str(folder), "--lines", str(lines_path)]
        self._recorder = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def close(self) -> None:
        """End the recorder."""
        self._recorder.terminate()
        self._recorder.communicate()

    def wait_for_path(self, name: str) -> Path:
        """Wait for the recording of a session and return its path."""
        while name not in self._recorded_names:
            line_text = self._recorder.stdout.readline() if self._recorder.stdout else ""
            if not line_text:
                raise RuntimeError(f"{name} was not recorded")
            self._recorded_names.add(line_text.strip())
        return self._folder / f"{name}.mcap"

    def explain(self, line: Line, variant: str = REAL) -> StatedExplanation:
        """Return the explanation of a session by a variant, before the variant changes its line."""
        explain = VARIANTS[variant].explain
        key = get_name(line), "" if explain is VARIANTS[REAL].explain else variant
        if key not in self._explanations:
            self._explanations[key] = explain_recording(self.wait_for_path(get_name(line)), explain)
        return self._explanations[key]

    def judge(self, line: Line, variant: str = REAL) -> Outcome:
        """Return the outcome of a session for a variant of the solver."""
        stated = self.explain(line, variant)
        outcome_line = VARIANTS[variant].change_line(
            make_line(int(line["seed"]), variant, stated), stated
        )
        return judge_case(make_answer(line), outcome_line)


def make_answer(line: Line) -> Answer:
    """Return the answer to a line of the fast tier, in the form of the long tier."""
    cause = line.get("cause") or (f"{line['kind']}:{line['shape']}" if "shape" in line else None)
    times = float(line.get("times") or 1000.0)
    hidden = (
        () if cause is None else (HiddenCause(str(cause), line.get("place"), times, times, {}),)
    )
    return Answer(
        seed=int(line["seed"]),
        kind=str(line["kind"]),
        tier="fast",
        program=str(line.get("program", "survey-40")),
        soak_k=float(line.get("soak_k", 0.0)),
        decoy=None,
        causes=tuple(hidden),
        groups=tuple(line.get("groups", ())),
        allowed=(),
        near=None,
        calibration={},
        gain=(),
    )
