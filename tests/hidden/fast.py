"""The fast tier's sessions: recorded by another process, explained and judged in this one.

What to use when: `Sessions` in a test module, once for all of its tests.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.hidden.scoring.answers import Answer, HiddenCause
from tests.hidden.scoring.outcome import Outcome, outcome_of
from tests.hidden.scoring.stated import StatedExplanation, explained, line_of
from tests.hidden.scoring.variants import REAL, VARIANTS

HERE = Path(__file__).resolve().parent
SESSIONS = HERE / "fast_tier.json"
RECORDER = HERE / "record_fast.py"
Line = dict[str, Any]


def sessions() -> list[Line]:
    """Return the fast tier's sessions as the truth drew and sized them."""
    lines: list[Line] = json.loads(SESSIONS.read_text(encoding="utf-8"))
    return lines


def name_of(line: Line) -> str:
    """Return a session's name, which its recording has too."""
    return str(line.get("name", line["seed"]))


class Sessions:
    """Some sessions, each explained once by each finder."""

    def __init__(self, folder: Path, lines: Sequence[Line]) -> None:
        """Begin to record; truth and finder share files alone, and no process."""
        self.lines = list(lines)
        self._folder = folder
        self._recorded_names: set[str] = set()
        self._explained: dict[tuple[str, str], StatedExplanation] = {}
        lines_path = folder / "lines.json"
        lines_path.write_text(json.dumps(self.lines), encoding="utf-8")
        order = [sys.executable, str(RECORDER), "--out", str(folder), "--lines", str(lines_path)]
        self._recorder = subprocess.Popen(order, stdout=subprocess.PIPE, text=True)

    def close(self) -> None:
        """End the recorder, done or not."""
        self._recorder.terminate()
        self._recorder.communicate()

    def path(self, name: str) -> Path:
        """Return where a session's recording is, as soon as it is there."""
        while name not in self._recorded_names:
            line_text = self._recorder.stdout.readline() if self._recorder.stdout else ""
            if not line_text:
                raise RuntimeError(f"{name} was not recorded")
            self._recorded_names.add(line_text.strip())
        return self._folder / f"{name}.mcap"

    def stated(self, line: Line, variant: str = REAL) -> StatedExplanation:
        """Return what a finder says of a session, before any change of its words."""
        look = VARIANTS[variant].explain
        key = name_of(line), "" if look is VARIANTS[REAL].explain else variant
        if key not in self._explained:
            self._explained[key] = explained(self.path(name_of(line)), look)
        return self._explained[key]

    def outcome(self, line: Line, variant: str = REAL) -> Outcome:
        """Return a session's outcome with a finder."""
        stated = self.stated(line, variant)
        outcome_line = VARIANTS[variant].line_of(
            line_of(int(line["seed"]), variant, stated), stated
        )
        return outcome_of(answer_of(line), outcome_line)


def answer_of(line: Line) -> Answer:
    """Return what a line of the fast tier hides, as the long tier's answers say it."""
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
