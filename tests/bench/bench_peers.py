"""Other ways of calibrating a gyroscope beside ours, on the same data in one run.

Simulated, 75 s, in units of the Cramer-Rao bound of the known motion: pan at tilts of both
signs, and the paper's own cycle; once with the unit's angles given to all, once with its
answers only. imucal on its own kind of session. Then the recordings of others, held out, and
the CPU time of each on 75 s at 800 Hz, one BLAS thread.

A peer that is not installed is named and left out: none is needed by this project.

Run: python tests/bench/bench_peers.py [--seeds 20] [--repeat 7]
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy: the ratios are of one thread
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.measured.sessions import measured_folder
from tests.bench.peers import factor_graph, figures, measured, turns
from tests.bench.peers.recording import CROSS, SWEEPS

ALL, NO_ROLL = (0, 1, 2), (0, 2)
PAN_SWEEPS = "The motion consists of pan sweeps at positive and at negative tilts."
PAPER_CYCLE = (
    "The motion is the cycle that the paper uses: pan moves at tilt 0, and tilt moves at pan 0."
)


def say(text: str) -> None:
    """Print what is known so far; the whole takes minutes."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def simulated(seeds: int) -> None:
    """Print the tables of the simulated recordings."""
    say(f"\nThe standard uncertainty of each rms error is {figures.spread_percent(seeds):.0f} %.")
    for title, program, columns in (
        (PAN_SWEEPS, SWEEPS, ALL),
        (PAPER_CYCLE, CROSS, NO_ROLL),
    ):
        for known in (True, False):
            given = "the true angles" if known else "only the position replies"
            say(f"\n{title}")
            say(f"Every method uses {given} of the pan-tilt unit as its reference.")
            say(f"Each rms error is computed from {seeds} simulated runs.\n")
            errors, bounds = figures.runs(program, seeds, known, columns)
            say(figures.accuracy(errors, bounds, known))
            if columns != ALL and known:
                say("\nThe cycle of the paper does not determine the roll column of the gain.")
                say("The next table gives the result of each method for the roll column:\n")
                say(figures.hidden_column(errors))
    say("\nThe session has six rests and three full turns, as imucal expects.")
    say(f"Each rms error is computed from {seeds} simulated runs.\n")
    say(figures.turned(seeds))


def others() -> None:
    """Print the tables of the measured recordings, or why there are none."""
    try:
        data = measured_folder()
    except SystemExit as missing:
        say(f"\nleft out, measured recordings: {missing}")
        return
    with tempfile.TemporaryDirectory() as folder:
        rows = measured.imported(data, Path(folder))
        say("\nOn the motion-capture data (BROAD), each method is fitted to one trial and tested")
        say("on another trial of the same sensor unit. Each column heading names the fitted trial")
        say("and the tested trial (fitted → tested). Each cell gives the rms rotation error over")
        say("windows of 1 s.\n")
        say(measured.motion_capture(rows))
        say("\nOn the data with gravity as the reference (imu_tk_xsens), each method is fitted to")
        say("one half of the moves and tested on the other half. The gains in the rows with")
        say('"all moves" come from a fit to all moves.\n')
        say(measured.gravity(rows))
        if turns.imucal_installed():
            say("\nOn the data with turns by hand (imucal_ferraris), our solver is compared with")
            say("imucal.\n")
            say(measured.hand_turns(rows))


def main() -> int:
    """Run everything; the exit code."""
    parser = argparse.ArgumentParser(description="other ways of calibrating beside ours")
    parser.add_argument("--seeds", type=int, default=20, help="runs of each kind")
    parser.add_argument("--repeat", type=int, default=7, help="of each time; the median counts")
    asked = parser.parse_args()
    begun = time.monotonic()
    for name, is_installed in (
        (factor_graph.PACKAGE, factor_graph.installed()),
        ("imucal", turns.imucal_installed()),
    ):
        if not is_installed:
            say(f"left out, {name} is not installed here: pip install {name}")
    simulated(asked.seeds)
    others()
    say("\nThe last table gives the processor time for a recording of 75 s at 800 Hz.\n")
    say(figures.times(asked.repeat))
    say(f"\n{time.monotonic() - begun:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
