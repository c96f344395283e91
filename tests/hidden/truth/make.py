"""Make a corpus of sessions with hidden effects, one folder per seed.

    CORPUS/<seed>/recording.mcap   the only file that the solver gets
                 /answer.json      the hidden effects, for the scorer only
                 /sealed.txt       SHA-256 of the answer; the program writes it before the recording
                 /held.mcap        in some folders: the same rig under another program
                 /held.npz         rates of held.mcap without noise
                 /rates.npz        of a ladder: rates of the recording without noise, for the bound

The program does not change a seed with a recording. A stopped run can therefore continue.

Run: python tests/hidden/truth/make.py --out CORPUS --first SEED --count N [--tier mixed]
"""

import argparse
import os
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.hidden.truth.answer import make_answer
from tests.hidden.truth.decoys import add_idle_channel, make_hot_truth
from tests.hidden.truth.draws import (
    TIERS,
    Session,
    correct_size,
    draw_session,
    make_requests,
    update_visibility,
)
from tests.hidden.truth.session import BOARD, ORIGIN_NS, RecordedSession, make_settings, record
from tests.hidden.truth.sizing import COUNTED, IN_VARIANCE, Sizer
from tests.support.sealed_answer import seal

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.noise_free_rates import RigTwin, write_rates
from gyrorig_daemon.emulator.rig_truth import RigTruth, sample_rig_truth

_MAX_TRIES = 4
SKIPPED = "skipped.txt"  # seeds of a ladder without a possible session


def make_case(folder: Path, session: Session) -> str:
    """Record a session, seal its answer, and move the recording into place; return the seal."""
    folder.mkdir(parents=True, exist_ok=True)
    raw = folder / "recording.part"
    session, recorded, sizer = _record_session(session, raw)
    document = make_answer(session, recorded, sizer)
    if session.second_rig is not None:
        _record_second(folder, session, recorded.rig.truth)
    if session.rung is not None and session.items[0].name not in (*COUNTED, *IN_VARIANCE):
        rates = {BOARD: sizer.simulate_rates(session.items[0].request)}
        write_rates(folder / "rates.npz", rates, recorded.course.moves_s)
    sealed = seal(folder, document)
    if session.decoy == "idle_channel":
        add_idle_channel(raw, session.rig.seed)
    raw.replace(folder / "recording.mcap")
    return sealed


def _record_session(session: Session, raw: Path) -> tuple[Session, RecordedSession, Sizer]:
    """Record a session; correct the size of a ladder until the recorded session meets its rung.

    The visibility of an effect at the edges of the motion depends on the exact begin of each move.
    """
    for _ in range(_MAX_TRIES):
        rig = replace(session.rig, hide=make_requests(session.items))
        truth = make_hot_truth(make_settings(rig)) if session.decoy == "temperature" else None
        recorded = record(rig, raw, truth, session.extra_effects)
        sizer = Sizer(make_settings(session.rig), recorded.course)
        session = update_visibility(sizer, session)
        corrected = correct_size(sizer, session)
        if corrected is None:
            break
        session = corrected
    return session, recorded, sizer


def _record_second(folder: Path, session: Session, truth: RigTruth) -> None:
    """Record the same rig and effects under another program and with other noise."""
    if session.second_rig is None:
        raise ValueError("this session has no second one")
    second_rig = replace(session.second_rig, hide=make_requests(session.items))
    recorded = record(second_rig, folder / "held.mcap", truth, session.extra_effects)
    plain_truth = sample_rig_truth(make_settings(session.rig))
    course = recorded.course
    settings = recorded.rig.settings
    twin = RigTwin(settings, ORIGIN_NS, course.commands, course.end_ns, plain_truth)
    hidden_rig = EmulatedRig(settings, ORIGIN_NS, truth, session.extra_effects)
    write_rates(folder / "held.npz", twin.rates(hidden_rig), course.moves_s)


def run(namespace: argparse.Namespace) -> int:
    """Make the missing sessions; return their number."""
    out: Path = namespace.out
    out.mkdir(parents=True, exist_ok=True)
    shard, shard_count = (int(word) for word in namespace.shard.split("/"))
    skipped_path = out / SKIPPED
    skipped_seeds = set(skipped_path.read_text().split()) if skipped_path.exists() else set()
    made, start_s = 0, time.monotonic()
    for seed in range(namespace.first, namespace.first + namespace.count):
        folder = out / str(seed)
        if (seed - namespace.first) % shard_count != shard - 1 or str(seed) in skipped_seeds:
            continue
        if (folder / "recording.mcap").exists():
            continue
        session = draw_session(
            seed, namespace.tier, namespace.rungs, namespace.base or namespace.first
        )
        if session is None:
            with skipped_path.open("a") as file:
                file.write(f"{seed}\n")
            continue
        if folder.exists():
            shutil.rmtree(folder)  # a stop left it incomplete
        sealed = make_case(folder, session)
        made += 1
        each_s = (time.monotonic() - start_s) / made
        sys.stderr.write(f"{seed} {session.rig.program} sealed {sealed}, {each_s:.1f} s each\n")
    return made


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and make a corpus."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--first", type=int, required=True, help="first seed")
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--tier", choices=TIERS, default="mixed")
    parser.add_argument("--base", type=int, help="first seed of a ladder; default: --first")
    parser.add_argument("--rungs", type=float, nargs="+", default=[1.0, 2.0, 3.0])
    parser.add_argument(
        "--shard", default="1/1", metavar="K/N", help="make only every N-th session, from K"
    )
    sys.stdout.write(f"{run(parser.parse_args(arguments))} made\n")


if __name__ == "__main__":
    main()
