"""The figures of two simulators side by side: the emulated rig and the second simulator.

What to use when: `compare_simulators` for the block of docs/discovery-scores.md.
"""

from collections.abc import Sequence

from docs.markdown import table
from tests.hidden.scoring.figures import compute_figures
from tests.hidden.scoring.goals import GOALS
from tests.hidden.scoring.outcome import Outcome
from tests.hidden.scoring.tables import format_limit

COMPARED = (
    "false_alarms", "sole_right", "sole_right_soak", "wrong_names", "detected_once",
    "outside_wrong", "outside_group", "nearly_wrong", "recall", "precision", "covered_causes",
    "covered_calibration",
)  # fmt: skip


def compare_simulators(emulated: Sequence[Outcome], second: Sequence[Outcome]) -> str:
    """Return the figures of both simulators."""
    of_emulated, of_second = compute_figures(emulated), compute_figures(second)
    rows = [
        (goal.words, format_limit(goal), of_emulated[goal.name].words, of_second[goal.name].words)
        for goal in GOALS
        if goal.name in COMPARED
    ]
    return table(("figure", "limit", "emulated rig", "second simulator"), rows)
