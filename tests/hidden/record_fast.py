"""Record the sessions of the fast tier.

make.py drew the causes and sizes once. fast_tier.json contains one line per session. This program
only records the sessions, in a process without the solver. Tests start this program.

    python tests/hidden/record_fast.py --out FOLDER --lines FILE   record the sessions of FILE
    python tests/hidden/record_fast.py --sizes CORPUS... > lines   make lines from corpora
"""

import argparse
import json
import os
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.hidden.truth.outside import SHAPES
from tests.hidden.truth.session import RigDraw, make_settings, record
from tests.hidden.truth.shapes import make_shape_adder

from gyrorig_daemon.emulator.emulator_settings import InjectionRequest
from gyrorig_daemon.emulator.rig_truth import sample_rig_truth

ALL_PLACES = ("all", "x,y,z", "pan,tilt")  # places of causes without a separate place
Line = dict[str, Any]


def record_line(line: Line, path: Path) -> None:
    """Record the session of a line at `path`."""
    rig = RigDraw(
        int(line["seed"]),
        str(line.get("program", "survey-40")),
        float(line.get("soak_k", 0.0)),
        int(line.get("ptu_baud", 115200)),
        float(line.get("command_time_ms", 5.0)),
    )
    shape, size = line.get("shape"), line.get("size")
    extra_effects = (
        make_shape_adder(SHAPES[shape], float(size), make_settings(rig)) if shape and size else None
    )
    if line.get("cause"):
        place = str(line.get("place") or "")
        request = InjectionRequest(str(line["cause"]), place, None if size is None else float(size))
        rig = replace(rig, hide=(request,))
    truth = None
    if "rig_seed" in line:  # the rig of another session, with new noise
        truth = sample_rig_truth(make_settings(replace(rig, seed=int(line["rig_seed"]))))
    record(rig, path, truth, extra_effects)


def read_sized_lines(corpora: Iterable[Path]) -> list[Line]:
    """Return lines for the sessions of corpora with one hidden effect or none."""
    entries = []
    for corpus in corpora:
        for path in sorted(corpus.glob("*/answer.json"), key=lambda p: int(p.parent.name)):
            document = json.loads(path.read_text(encoding="utf-8"))
            line = {key: document[key] for key in ("seed", "kind", "program", "soak_k")}
            line |= document["rig"]
            for cause in document["causes"][:1]:
                kind, _, name = str(cause["cause"]).rpartition(":")
                place = "" if cause["place"] in ALL_PLACES else cause["place"]
                line |= {"shape" if kind else "cause": name, "place": place}
                line |= {"size": cause["size"]["value"], "times": cause["times_detectable"]}
            entries.append(line | {"groups": document.get("expected_groups") or []})
    return entries


def main() -> None:
    """Record the sessions, or print lines."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--lines", type=Path, help="sessions to record, JSON")
    parser.add_argument("--sizes", type=Path, nargs="+")
    arguments = parser.parse_args()
    if arguments.sizes:
        text = ",\n".join(json.dumps(line) for line in read_sized_lines(arguments.sizes))
        sys.stdout.write(f"[\n{text}\n]\n")
        return
    lines = json.loads(arguments.lines.read_text(encoding="utf-8"))
    arguments.out.mkdir(parents=True, exist_ok=True)
    for line in lines:
        name = str(line.get("name", line["seed"]))
        record_line(line, arguments.out / f"{name}.mcap")
        sys.stdout.write(f"{name}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
