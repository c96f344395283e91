"""Make a corpus of sessions with something hidden in them, one folder a seed.

    CORPUS/<seed>/recording.mcap   all that a finder gets
                 /answer.json      what is hidden; for the scorer alone
                 /sealed.txt       SHA-256 of the answer, written and printed first
                 /held.mcap        for some: the same rig again, under another program,
                 /held.npz         and its rates without noise
                 /rates.npz        of a ladder: what it would be without noise, for the bound

A seed whose recording is there is left alone: a run can go on where it was stopped.

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

from tests.hidden.truth.answer import answer_of
from tests.hidden.truth.decoys import hot_truth, with_idle_channel
from tests.hidden.truth.draws import TIERS, Session, drawn, on_rung, orders_of, seen_by
from tests.hidden.truth.session import BOARD, ORIGIN_NS, RecordedSession, record, settings_of
from tests.hidden.truth.sizing import COUNTED, IN_VARIANCE, Sizer
from tests.support.sealed_answer import seal

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.noise_free_rates import RigTwin, write_rates
from gyrorig_daemon.emulator.rig_truth import RigTruth, sample_rig_truth

_TRIES = 4
SKIPPED = "skipped.txt"  # seeds whose session cannot be, in a ladder


def make(folder: Path, session: Session) -> str:
    """Hold a session, seal its answer, and put the recording there last; return the seal."""
    folder.mkdir(parents=True, exist_ok=True)
    raw = folder / "recording.part"
    session, recorded, sizer = _fitting(session, raw)
    document = answer_of(session, recorded, sizer)
    if session.held is not None:
        _hold(folder, session, recorded.rig.truth)
    if session.rung is not None and session.items[0].name not in (*COUNTED, *IN_VARIANCE):
        rates = {BOARD: sizer.rates(session.items[0].order)}
        write_rates(folder / "rates.npz", rates, recorded.course.moves_s)
    sealed = seal(folder, document)
    if session.decoy == "idle_channel":
        with_idle_channel(raw, session.rig.seed)
    raw.replace(folder / "recording.mcap")
    return sealed


def _fitting(session: Session, raw: Path) -> tuple[Session, RecordedSession, Sizer]:
    """Hold a session, with a ladder's rung met by the session as it was.

    How visible an effect on the edges of the motion is depends on how the samples fall on
    them, and so on when exactly each move began.
    """
    for _ in range(_TRIES):
        rig = replace(session.rig, hide=orders_of(session.items))
        truth = hot_truth(settings_of(rig)) if session.decoy == "temperature" else None
        recorded = record(rig, raw, truth, session.more)
        sizer = Sizer(settings_of(session.rig), recorded.course)
        session = seen_by(sizer, session)
        better = on_rung(sizer, session)
        if better is None:
            break
        session = better
    return session, recorded, sizer


def _hold(folder: Path, session: Session, truth: RigTruth) -> None:
    """Record the same rig, with the same in it, under another program and other noise."""
    if session.held is None:
        raise ValueError("this session has no second one")
    held = replace(session.held, hide=orders_of(session.items))
    recorded = record(held, folder / "held.mcap", truth, session.more)
    plain = sample_rig_truth(settings_of(session.rig))
    course = recorded.course
    settings = recorded.rig.settings
    twins = RigTwin(settings, ORIGIN_NS, course.orders, course.until_ns, plain)
    like = EmulatedRig(settings, ORIGIN_NS, truth, session.more)
    write_rates(folder / "held.npz", twins.rates(like), course.moves_s)


def run(namespace: argparse.Namespace) -> int:
    """Make what is not there yet; return how many."""
    out: Path = namespace.out
    out.mkdir(parents=True, exist_ok=True)
    of, many = (int(word) for word in namespace.shard.split("/"))
    skipped = out / SKIPPED
    left_out = set(skipped.read_text().split()) if skipped.exists() else set()
    made, begun_s = 0, time.monotonic()
    for seed in range(namespace.first, namespace.first + namespace.count):
        folder = out / str(seed)
        if (seed - namespace.first) % many != of - 1 or str(seed) in left_out:
            continue
        if (folder / "recording.mcap").exists():
            continue
        session = drawn(seed, namespace.tier, namespace.rungs, namespace.base or namespace.first)
        if session is None:
            with skipped.open("a") as file:
                file.write(f"{seed}\n")
            continue
        if folder.exists():
            shutil.rmtree(folder)  # left half made
        sealed = make(folder, session)
        made += 1
        rate_s = (time.monotonic() - begun_s) / made
        sys.stderr.write(f"{seed} {session.rig.program} sealed {sealed}, {rate_s:.1f} s each\n")
    return made


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and make a corpus."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--first", type=int, required=True, help="first seed")
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--tier", choices=TIERS, default="mixed")
    parser.add_argument("--base", type=int, help="where a ladder's round begins; else --first")
    parser.add_argument("--rungs", type=float, nargs="+", default=[1.0, 2.0, 3.0])
    parser.add_argument("--shard", default="1/1", metavar="K/N", help="only every N-th, from K")
    sys.stdout.write(f"{run(parser.parse_args(arguments))} made\n")


if __name__ == "__main__":
    main()
