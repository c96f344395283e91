"""Put the figures of the long tier into docs/discovery-scores.md, or check that they are there.

    python tests/hidden/write_scores.py            write every block and the picture
    python tests/hidden/write_scores.py --check    change nothing; 1 if a block differs

This script runs no session: `make hidden` does that and stores the results.
"""

import argparse
import sys
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.blocks import write_or_check
from docs.markdown import Block
from tests.hidden.scoring import complete, once, reliability, rigs, simulators, tables
from tests.hidden.scoring.kept import JudgedCases, read_judged_cases
from tests.hidden.scoring.picture import confusion_picture

DOCS = Path(__file__).resolve().parents[2] / "docs"
DOCUMENT = DOCS / "discovery-scores.md"
RESULTS = DOCS / "discovery" / "results.json"
INDEPENDENT = DOCS / "discovery" / "independent.json"
MULTIPLICITY = DOCS / "discovery" / "multiplicity.json"
COMPLETENESS = DOCS / "discovery" / "completeness.json"
PICTURE = DOCS / "img" / "confusion.svg"


@cache
def read_judged() -> JudgedCases:
    """Return the results of the last run of the long tier."""
    return read_judged_cases(RESULTS)


@cache
def read_independent() -> JudgedCases:
    """Return the results of the sessions of the second simulator."""
    return read_judged_cases(INDEPENDENT)


@cache
def measured() -> list[once.Multiplicity]:
    """Return the effective number of trials of a search, as `multiplicity.py` measured it."""
    return once.read(MULTIPLICITY)


def picture() -> str:
    """Return the confusion matrix as SVG."""
    return confusion_picture(read_judged().outcomes)


BLOCKS: dict[str, Block] = {
    "cases": lambda: tables.cases(read_judged().outcomes),
    "reached": lambda: tables.reached(read_judged().outcomes),
    "goals": lambda: tables.goals(
        read_judged().outcomes, read_judged().gaps, read_judged().bounds, measured()
    ),
    "independent": lambda: simulators.compare_simulators(
        read_judged().outcomes, read_independent().outcomes
    ),
    "nulls": lambda: tables.nulls(read_judged().outcomes),
    "looks": lambda: once.counted(measured()),
    "once": lambda: once.table_text(measured()),
    "causes": lambda: tables.causes(read_judged().outcomes),
    "confused": lambda: tables.confused(read_judged().outcomes),
    "inseparable": lambda: tables.inseparable(read_judged().bounds),
    "shapes": lambda: tables.shapes(read_judged().outcomes),
    "blind": lambda: tables.blind(read_judged().outcomes),
    "rigs": lambda: rigs.rigs_table(read_judged().outcomes),
    "many": lambda: tables.many(read_judged().outcomes),
    "gaps": lambda: tables.gaps(read_judged().gaps),
    "complete": lambda: complete.table_text(complete.read(COMPLETENESS)),
    "reliability": lambda: reliability.table_text(
        [each for outcome in read_judged().outcomes for each in outcome.beliefs]
    ),
    "covered": lambda: tables.covered(read_judged().outcomes),
    "harm": lambda: tables.harm(read_judged().outcomes),
    "seconds": lambda: tables.seconds(read_judged().outcomes),
}


def main() -> int:
    """Write or check page and picture; the exit code."""
    parser = argparse.ArgumentParser(description="figures of docs/discovery-scores.md")
    parser.add_argument("--check", action="store_true", help="change nothing, 1 if it differs")
    options = parser.parse_args()
    if not options.check:
        PICTURE.write_text(picture(), encoding="utf-8")
    return write_or_check(DOCUMENT, BLOCKS, options.check, "python tests/hidden/write_scores.py")


if __name__ == "__main__":
    sys.exit(main())
