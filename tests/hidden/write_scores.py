"""Write the figures of the long tier to docs/discovery-scores.md, or check them.

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
def read_multiplicity() -> list[once.Multiplicity]:
    """Return the effective numbers of trials of a search that `multiplicity.py` measured."""
    return once.read(MULTIPLICITY)


def make_picture() -> str:
    """Return the confusion matrix as SVG."""
    return confusion_picture(read_judged().outcomes)


BLOCKS: dict[str, Block] = {
    "cases": lambda: tables.cases(read_judged().outcomes),
    "reached": lambda: tables.session_counts(read_judged().outcomes),
    "goals": lambda: tables.goals(
        read_judged().outcomes, read_judged().gaps, read_judged().bounds, read_multiplicity()
    ),
    "independent": lambda: simulators.compare_simulators(
        read_judged().outcomes, read_independent().outcomes
    ),
    "nulls": lambda: tables.false_alarms(read_judged().outcomes),
    "looks": lambda: once.tests_table(read_multiplicity()),
    "once": lambda: once.table_text(read_multiplicity()),
    "causes": lambda: tables.causes(read_judged().outcomes),
    "confused": lambda: tables.wrong_names(read_judged().outcomes),
    "inseparable": lambda: tables.inseparable(read_judged().bounds),
    "shapes": lambda: tables.shapes(read_judged().outcomes),
    "blind": lambda: tables.unobservable(read_judged().outcomes),
    "rigs": lambda: rigs.rigs_table(read_judged().outcomes),
    "many": lambda: tables.several_causes(read_judged().outcomes),
    "gaps": lambda: tables.oracle_gaps(read_judged().gaps),
    "complete": lambda: complete.table_text(complete.read(COMPLETENESS)),
    "reliability": lambda: reliability.table_text(
        [each for outcome in read_judged().outcomes for each in outcome.beliefs]
    ),
    "covered": lambda: tables.coverage(read_judged().outcomes),
    "harm": lambda: tables.harm(read_judged().outcomes),
    "seconds": lambda: tables.durations(read_judged().outcomes),
}


def main() -> int:
    """Write the page and the picture, or check the page; return the exit code."""
    parser = argparse.ArgumentParser(description="Write the figures of docs/discovery-scores.md.")
    parser.add_argument(
        "--check", action="store_true", help="change nothing; exit code 1 if a block differs"
    )
    options = parser.parse_args()
    if not options.check:
        PICTURE.write_text(make_picture(), encoding="utf-8")
    return write_or_check(DOCUMENT, BLOCKS, options.check, "python tests/hidden/write_scores.py")


if __name__ == "__main__":
    sys.exit(main())
