"""Record the sessions of the fast tier: causes and sizes as the truth's own sizing found them.

fast_tier.json holds what make.py drew and sized once, a line a session; here they are only
recorded, all in one process that no finder is in. Tests start this as a program.

    python tests/hidden/record_fast.py --out FOLDER --lines FILE   record them
    python tests/hidden/record_fast.py --sizes CORPUS... > lines   lines from make.py's corpora
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
from tests.hidden.truth.session import RigDraw, record, settings_of
from tests.hidden.truth.shapes import hanger

from gyrorig_daemon.emulator.emulator_settings import InjectionRequest
from gyrorig_daemon.emulator.rig_truth import sample_rig_truth

EVERYWHERE = ("all", "x,y,z", "pan,tilt")  # said of causes that have no place of their own
Line = dict[str, Any]


def hold(line: Line, path: Path) -> None:
    """Record one session at `path`."""
    rig = RigDraw(
        int(line["seed"]),
        str(line.get("program", "survey-40")),
        float(line.get("soak_k", 0.0)),
        int(line.get("ptu_baud", 115200)),
        float(line.get("command_time_ms", 5.0)),
    )
    shape, size = line.get("shape"), line.get("size")
    more = hanger(SHAPES[shape], float(size), settings_of(rig)) if shape and size else None
    if line.get("cause"):
        place = str(line.get("place") or "")
        order = InjectionRequest(str(line["cause"]), place, None if size is None else float(size))
        rig = replace(rig, hide=(order,))
    truth = None
    if "rig_seed" in line:  # the rig of another session: only its noise is new
        truth = sample_rig_truth(settings_of(replace(rig, seed=int(line["rig_seed"]))))
    record(rig, path, truth, more)


def sized(corpora: Iterable[Path]) -> list[Line]:
    """Return lines for the sessions of corpora that hide one thing, or nothing."""
    entries = []
    for corpus in corpora:
        for path in sorted(corpus.glob("*/answer.json"), key=lambda p: int(p.parent.name)):
            document = json.loads(path.read_text(encoding="utf-8"))
            line = {key: document[key] for key in ("seed", "kind", "program", "soak_k")}
            line |= document["rig"]
            for cause in document["causes"][:1]:
                kind, _, name = str(cause["cause"]).rpartition(":")
                place = "" if cause["place"] in EVERYWHERE else cause["place"]
                line |= {"shape" if kind else "cause": name, "place": place}
                line |= {"size": cause["size"]["value"], "times": cause["times_detectable"]}
            entries.append(line | {"groups": document.get("expected_groups") or []})
    return entries


def main() -> None:
    """Record, or print lines."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--lines", type=Path, help="the sessions to record, JSON")
    parser.add_argument("--sizes", type=Path, nargs="+")
    arguments = parser.parse_args()
    if arguments.sizes:
        text = ",\n".join(json.dumps(line) for line in sized(arguments.sizes))
        sys.stdout.write(f"[\n{text}\n]\n")
        return
    every = json.loads(arguments.lines.read_text(encoding="utf-8"))
    arguments.out.mkdir(parents=True, exist_ok=True)
    for line in every:
        name = str(line.get("name", line["seed"]))
        hold(line, arguments.out / f"{name}.mcap")
        sys.stdout.write(f"{name}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
