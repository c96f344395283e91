"""Write the numbers of the measured sets to docs/measured-data.md, or check them.

    python docs/measured/write.py            write every block
    python docs/measured/write.py --check    change nothing; 1 if a block differs

The script imports, checks, solves and explains the six sets with the commands of the page, in a
temporary folder; this takes two minutes. The measurements are not part of this repository:
$GYRORIG_DATA is their folder, by default shared/data next to the checkout.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.blocks import write_or_check
from docs.markdown import Block
from docs.measured import (
    attitude_sets,
    cross_validation,
    explained,
    gravity_sets,
    held_out_moves,
    tables,
    turn_sets,
)
from docs.measured.sessions import COMMANDS, MeasuredSets, find_measured_folder, run_all

DOCUMENT = Path(__file__).resolve().parents[1] / "measured-data.md"
TABLES: dict[str, Callable[[MeasuredSets], str]] = {
    "exit-codes": tables.exit_codes,
    "broad-found": attitude_sets.broad_results,
    "broad-held-out": cross_validation.rotation_errors,
    "broad-factors": cross_validation.factors,
    "broad-summary": cross_validation.summary,
    "broad-bands": cross_validation.bands,
    "broad-bias": attitude_sets.broad_bias,
    "broad-gains": attitude_sets.broad_gains,
    "broad-doubts": attitude_sets.broad_reasons,
    "xsens-found": gravity_sets.xsens_results,
    "xsens-held-out": held_out_moves.move_errors,
    "xsens-gains": gravity_sets.xsens_gains,
    "xsens-bias": gravity_sets.xsens_bias,
    "xsens-doubts": gravity_sets.xsens_reasons,
    "ferraris-found": turn_sets.ferraris_results,
    "ferraris-gains": turn_sets.ferraris_gains,
    "ferraris-bias": turn_sets.ferraris_bias,
    "ferraris-doubts": turn_sets.ferraris_reasons,
    "serial-found": turn_sets.serial_results,
    "serial-sums": turn_sets.serial_sums,
    "serial-refused": turn_sets.serial_refusals,
    "serial-untold": turn_sets.serial_unobservable,
    "raw-counts-found": gravity_sets.raw_counts_results,
    "raw-counts-untold": gravity_sets.raw_counts_unobservable,
    "raw-counts-doubts": gravity_sets.raw_counts_reasons,
    "raw-counts-beside": gravity_sets.raw_counts_comparison,
    "car-found": attitude_sets.car_results,
    "car-doubts": attitude_sets.car_reasons,
    "car-refused": attitude_sets.car_refusals,
    "explained-causes": explained.causes,
    "explained-gains": explained.gains,
    "explained-smoothing": explained.smoothing,
    "explained-moving": explained.bias_in_motion,
    "explained-untold": explained.not_testable,
}


def make_blocks(measured: MeasuredSets) -> dict[str, Block]:
    """Return every block of the page, for one run of the commands."""
    lines = {f"{name}-commands": partial(tables.commands, measured.runs[name]) for name in COMMANDS}
    return {**lines, **{name: partial(make_table, measured) for name, make_table in TABLES.items()}}


def main() -> int:
    """Write or check the document; return the exit code."""
    parser = argparse.ArgumentParser(description="Write the numbers of docs/measured-data.md.")
    parser.add_argument(
        "--check", action="store_true", help="change nothing; exit code 1 if a block differs"
    )
    options = parser.parse_args()
    data = find_measured_folder()
    with tempfile.TemporaryDirectory() as folder:
        blocks = make_blocks(run_all(data, Path(folder)))
        return write_or_check(DOCUMENT, blocks, options.check, "python docs/measured/write.py")


if __name__ == "__main__":
    sys.exit(main())
