"""Make a corpus of sessions of the independent simulator, one folder for each seed.

    CORPUS/<seed>/recording.mcap   the only file that the solver gets
                 /answer.json      the hidden effects, for the scorer only
                 /sealed.txt       SHA-256 of the answer

The program does not change a seed with a recording. A stopped run can therefore continue.

Run: python tests/hidden/independent/make.py --out CORPUS --first SEED --count N [--tier ladder]
"""

import argparse
import os
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.bench.rigs.recording_file import write_recording
from tests.hidden.independent.answer import make_answer
from tests.hidden.independent.draws import RUNGS, TIERS, Session, draw_session
from tests.hidden.independent.parts import FILTERS
from tests.hidden.independent.stream import simulate_recording
from tests.support.sealed_answer import seal


def make_case(folder: Path, session: Session) -> str:
    """Simulate a session, seal its answer, and write the recording last; return the seal."""
    folder.mkdir(parents=True, exist_ok=True)
    made = simulate_recording(
        session.scene, session.program, session.hidden_causes, session.hidden_effect
    )
    sealed = seal(folder, make_answer(session, made))
    unfinished = folder / "recording.part"
    write_recording(made.rig, unfinished)
    unfinished.replace(folder / "recording.mcap")
    return sealed


def run(namespace: argparse.Namespace) -> int:
    """Make the missing sessions; return their number."""
    out: Path = namespace.out
    out.mkdir(parents=True, exist_ok=True)
    shard, shard_count = (int(word) for word in namespace.shard.split("/"))
    made, start_s = 0, time.monotonic()
    for seed in range(namespace.first, namespace.first + namespace.count):
        folder = out / str(seed)
        if (seed - namespace.first) % shard_count != shard - 1 or (
            folder / "recording.mcap"
        ).exists():
            continue
        if folder.exists():
            shutil.rmtree(folder)  # a stop left it incomplete
        session = draw_session(
            seed, namespace.tier, namespace.rungs, namespace.program, namespace.filters
        )
        sealed = make_case(folder, session)
        made += 1
        each_s = (time.monotonic() - start_s) / made
        sys.stderr.write(f"{seed} {session.program.name} sealed {sealed}, {each_s:.1f} s each\n")
    return made


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and make a corpus."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--first", type=int, required=True, help="first seed")
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--tier", choices=TIERS, default="ladder")
    parser.add_argument("--rungs", type=float, nargs="+", default=list(RUNGS))
    parser.add_argument("--program", default="", help="program instead of a random one")
    parser.add_argument(
        "--filters", choices=FILTERS, default="mild", help="low-pass filters of the sensors"
    )
    parser.add_argument(
        "--shard", default="1/1", metavar="K/N", help="make only every N-th session, from K"
    )
    sys.stdout.write(f"{run(parser.parse_args(arguments))} made\n")


if __name__ == "__main__":
    main()
