"""Write the numbers of the measured sets to docs/measured-data.md, or check them.

    python docs/measured/write.py            write every block
    python docs/measured/write.py --check    change nothing; 1 if a block differs

Imports, checks, solves and explains the six sets with the commands of the page, in a temporary
folder; this takes two minutes. The measurements are not part of this repository: $GYRORIG_DATA
is their folder, by default shared/data next to the checkout.
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
from docs.measured.sessions import COMMANDS, MeasuredSets, measured_folder, run_all

DOCUMENT = Path(__file__).resolve().parents[1] / "measured-data.md"
TABLES: dict[str, Callable[[MeasuredSets], str]] = {
    "exit-codes": tables.codes,
    "broad-found": attitude_sets.broad_found,
    "broad-held-out": cross_validation.held_out,
    "broad-factors": cross_validation.factors,
    "broad-summary": cross_validation.summary,
    "broad-bands": cross_validation.bands,
    "broad-bias": attitude_sets.broad_bias,
    "broad-gains": attitude_sets.broad_gains,
    "broad-doubts": attitude_sets.broad_doubts,
    "xsens-found": gravity_sets.xsens_found,
    "xsens-held-out": held_out_moves.held_out,
    "xsens-gains": gravity_sets.xsens_gains,
    "xsens-bias": gravity_sets.xsens_bias,
    "xsens-doubts": gravity_sets.xsens_doubts,
    "ferraris-found": turn_sets.ferraris_found,
    "ferraris-gains": turn_sets.ferraris_gains,
    "ferraris-bias": turn_sets.ferraris_bias,
    "ferraris-doubts": turn_sets.ferraris_doubts,
    "serial-found": turn_sets.serial_found,
    "serial-sums": turn_sets.serial_sums,
    "serial-refused": turn_sets.serial_refused,
    "serial-untold": turn_sets.serial_untold,
    "raw-counts-found": gravity_sets.raw_counts_found,
    "raw-counts-untold": gravity_sets.raw_counts_untold,
    "raw-counts-doubts": gravity_sets.raw_counts_doubts,
    "raw-counts-beside": gravity_sets.raw_counts_beside,
    "car-found": attitude_sets.car_found,
    "car-doubts": attitude_sets.car_doubts,
    "car-refused": attitude_sets.car_refused,
    "explained-causes": explained.causes,
    "explained-gains": explained.gains,
    "explained-smoothing": explained.smoothing,
    "explained-moving": explained.moving,
    "explained-untold": explained.untold,
}


def blocks(measured: MeasuredSets) -> dict[str, Block]:
    """Every block of the page, for one run of the commands."""
    lines = {f"{name}-commands": partial(tables.commands, measured.runs[name]) for name in COMMANDS}
    return {**lines, **{name: partial(made, measured) for name, made in TABLES.items()}}


def main() -> int:
    """Write or check the document; the exit code."""
    parser = argparse.ArgumentParser(description="numbers of docs/measured-data.md")
    parser.add_argument("--check", action="store_true", help="change nothing, 1 if it differs")
    asked = parser.parse_args()
    data = measured_folder()
    with tempfile.TemporaryDirectory() as folder:
        made = blocks(run_all(data, Path(folder)))
        return write_or_check(DOCUMENT, made, asked.check, "python docs/measured/write.py")


if __name__ == "__main__":
    sys.exit(main())
