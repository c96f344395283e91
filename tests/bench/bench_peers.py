"""Compare other methods that calibrate a gyroscope with ours, on the same data in one run.

The simulated recordings have 75 s. Their errors are in units of the Cramer-Rao bound of the known
motion. The motions are pan sweeps at tilts of both signs, and the cycle of the paper. Each method
uses first the true angles of the unit, and then only its position replies. imucal gets a session
of turns by hand. The bench then tests the methods on measured recordings of others, and measures
the CPU time of each method for 75 s at 800 Hz with one BLAS thread.

This project does not need the peers. The bench reports a peer that is not installed, and omits it.

Run: python tests/bench/bench_peers.py [--seeds 20] [--repeat 7]
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy: all times are for one thread
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.measured.sessions import find_measured_folder
from tests.bench.peers import factor_graph, figures, measured, turns
from tests.bench.peers.recording import CROSS, SWEEPS

ALL, NO_ROLL = (0, 1, 2), (0, 2)
PAN_SWEEPS = "The motion consists of pan sweeps at positive and at negative tilts."
PAPER_CYCLE = (
    "The motion is the cycle that the paper uses: pan moves at tilt 0, and tilt moves at pan 0."
)


def print_line(text: str) -> None:
    """Print a line at once, because the bench takes minutes."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def print_simulated_tables(seeds: int) -> None:
    """Print the tables of the simulated recordings."""
    uncertainty_percent = figures.rms_uncertainty_percent(seeds)
    print_line(f"\nThe standard uncertainty of each rms error is {uncertainty_percent:.0f} %.")
    for title, program, columns in (
        (PAN_SWEEPS, SWEEPS, ALL),
        (PAPER_CYCLE, CROSS, NO_ROLL),
    ):
        for known in (True, False):
            given = "the true angles" if known else "only the position replies"
            print_line(f"\n{title}")
            print_line(f"Every method uses {given} of the pan-tilt unit as its reference.")
            print_line(f"Each rms error is computed from {seeds} simulated runs.\n")
            errors, bounds = figures.run_methods(program, seeds, known, columns)
            print_line(figures.format_accuracy(errors, bounds, known))
            if columns != ALL and known:
                print_line(
                    "\nThe cycle of the paper does not determine the roll column of the gain."
                )
                print_line("The next table gives the result of each method for the roll column:\n")
                print_line(figures.format_hidden_column(errors))
    print_line("\nThe session has six rests and three full turns, as imucal expects.")
    print_line(f"Each rms error is computed from {seeds} simulated runs.\n")
    print_line(figures.measure_turn_errors(seeds))


def print_measured_tables() -> None:
    """Print the tables of the measured recordings, or the reason without them."""
    try:
        data = find_measured_folder()
    except SystemExit as missing:
        print_line(f"\nomitted: measured recordings: {missing}")
        return
    with tempfile.TemporaryDirectory() as folder:
        rows = measured.import_sets(data, Path(folder))
        print_line(
            "\nOn the motion-capture data (BROAD), each method is fitted to one trial and tested"
        )
        print_line(
            "on another trial of the same sensor unit. Each column heading names the fitted trial"
        )
        print_line(
            "and the tested trial (fitted → tested). Each cell gives the rms rotation error over"
        )
        print_line("windows of 1 s.\n")
        print_line(measured.compare_motion_capture(rows))
        print_line(
            "\nOn the data with gravity as the reference (imu_tk_xsens), each method is fitted to"
        )
        print_line("one half of the moves and tested on the other half. The gains in the rows with")
        print_line('"all moves" come from a fit to all moves.\n')
        print_line(measured.compare_gravity(rows))
        if turns.imucal_installed():
            print_line(
                "\nOn the data with turns by hand (imucal_ferraris), our solver is compared with"
            )
            print_line("imucal.\n")
            print_line(measured.compare_hand_turns(rows))


def main() -> int:
    """Print all tables; return the exit status."""
    parser = argparse.ArgumentParser(description="compare other calibration methods with ours")
    parser.add_argument("--seeds", type=int, default=20, help="number of runs of each kind")
    parser.add_argument(
        "--repeat",
        type=int,
        default=7,
        help="repetitions of each time measurement; the bench prints the median",
    )
    options = parser.parse_args()
    start_s = time.monotonic()
    for name, is_installed in (
        (factor_graph.PACKAGE, factor_graph.is_installed()),
        ("imucal", turns.imucal_installed()),
    ):
        if not is_installed:
            print_line(f"omitted: {name} is not installed: pip install {name}")
    print_simulated_tables(options.seeds)
    print_measured_tables()
    print_line("\nThe last table gives the processor time for a recording of 75 s at 800 Hz.\n")
    print_line(figures.measure_times(options.repeat))
    print_line(f"\n{time.monotonic() - start_s:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
