"""What a cause of its detectable size is found by, in a search that looks for all of them.

One detectable size is that which a test of the cause alone finds in 4 of 5 sessions, where it is
one of 36 tests and knows each instant, frequency and time constant (`truth/detectable.py`). A
search shares its false alarms among as many tests as the catalogue makes, and has to find the
instants: each place looked at is a chance to be wrong. How many looks and tests that comes to,
`tests/hidden/multiplicity.py` measures by drawing noise; how often the same test then finds the
same size is the chi-square's power.

What to use when: `Multiplicity` is what was measured of one program; `chance_once` for a cause;
`borne` for the mean over causes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from docs.markdown import table
from scipy.stats import chi2, ncx2
from tests.hidden.scoring.goals import FALSE_ALARMS
from tests.hidden.truth.detectable import detectable_of, sizes_of


@dataclass(frozen=True, slots=True)
class Multiplicity:
    """How many independent looks a search makes in one session of a program."""

    program: str
    soak: bool
    tests: int  # causes at their places, each counted
    effective_tests: float  # independent ones among them
    looks: dict[str, float]  # of each cause: independent places, frequencies, times


def read(path: Path) -> list[Multiplicity]:
    """Return what `multiplicity.py` wrote."""
    return msgspec.json.decode(path.read_bytes(), type=list[Multiplicity])


def chance_once(cause: str, tests: float, looks: float, alarms: float = FALSE_ALARMS) -> float:
    """Return how often the test of a cause finds one detectable size.

    Args:
        cause: of the catalogue.
        tests: independent ones that share the false alarms.
        looks: independent ones that the cause takes.
        alarms: false ones of all tests, a session.
    """
    sizes = sizes_of(cause)
    bar = float(chi2.isf(alarms / (tests * looks), sizes))
    return float(ncx2.sf(bar, sizes, detectable_of(cause)))


def borne(measured: Sequence[Multiplicity], causes: Iterable[str]) -> float:
    """Return the mean chance over cases, each of one cause, over the programs measured."""
    each = [_mean_chance(measured, cause) for cause in causes]
    return float(np.mean(each)) if each else float("nan")


def said(measured: Sequence[Multiplicity]) -> str:
    """Return the table of what the looks cost, cause by cause."""
    names = sorted({name for one in measured for name in one.looks})
    rows = []
    for name in names:
        looks = [one.looks[name] for one in measured if name in one.looks]
        rows.append(
            (f"`{name}`", str(sizes_of(name)), f"{np.median(looks):.1f}",
             f"{100.0 * _mean_chance(measured, name):.0f} %")
        )  # fmt: skip
    rows.append(("all, each as often", "", "", f"{100.0 * borne(measured, names):.1f} %"))
    return table(("cause", "sizes", "independent looks", "found at 1x by its own test"), rows)


def counted(measured: Sequence[Multiplicity]) -> str:
    """Return the table of what was measured in each session."""
    rows = [
        (f"`{one.program}`" + (" with soak" if one.soak else ""), str(one.tests),
         f"{one.effective_tests:.0f}")
        for one in measured
    ]  # fmt: skip
    return table(("program", "tests", "independent ones among them"), rows)


def _mean_chance(measured: Sequence[Multiplicity], cause: str) -> float:
    own = [one for one in measured if cause in one.looks]
    tests = float(np.mean([one.effective_tests for one in own or measured]))
    looks = float(np.median([one.looks[cause] for one in own])) if own else 1.0
    return chance_once(cause, tests, looks)
