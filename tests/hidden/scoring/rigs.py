"""Table of rigs with all persistent causes at once.

What to use when: `rigs_table` for the block of docs/discovery-scores.md.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from docs.markdown import table
from tests.hidden.scoring.goals import DETECTABLE
from tests.hidden.scoring.outcome import Fate, Outcome
from tests.hidden.scoring.shares import Share


def rigs_table(outcomes: Sequence[Outcome]) -> str:
    """Return the results for rigs with all persistent causes, each cause by its name."""
    chosen = [outcome for outcome in outcomes if outcome.kind == "rig"]
    if not chosen:
        return "None measured."
    fates: dict[str, list[Fate]] = {}
    for outcome in chosen:
        for fate in outcome.fates:
            fates.setdefault(fate.cause, []).append(fate)
    wrong = Counter(name for outcome in chosen for names in outcome.extra for name in names)
    rows = []
    for cause, group in sorted(fates.items()):
        seen = [fate for fate in group if fate.times >= DETECTABLE]
        times = [fate.times for fate in group]
        rows.append(
            (f"`{cause}`", f"{np.median(times):.1f}x ({min(times):.1f}x to {max(times):.1f}x)",
             str(Share(sum(fate.stated for fate in seen), len(seen))), str(wrong.pop(cause, 0)))
        )  # fmt: skip
    rows += [(f"`{name}`", "not hidden", "", str(count)) for name, count in wrong.most_common()]
    head = ("cause", "sizes: median (range)", "recall where detectable alone", "stated wrongly")
    return table(head, rows)
