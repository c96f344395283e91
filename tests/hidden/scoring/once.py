"""Power of the test of one cause at its detectable size, in a search for all causes.

A test of the cause alone detects one detectable size in 4 of 5 sessions, as one of 36 tests with
known instants, frequencies and time constants (`truth/detectable.py`). A search shares its false
alarms among all tests of the catalogue and must also find the instants, so each candidate position
is one more trial. `tests/hidden/multiplicity.py` measures the effective number of tests and trials
with simulated noise. The power of the chi-square test follows from them.

What to use when: `Multiplicity` is the measurement of one program; `compute_power` for a cause;
`compute_mean_power` for the mean over causes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from docs.markdown import table
from scipy.stats import chi2, ncx2
from tests.hidden.scoring.goals import SEARCH_FALSE_ALARMS
from tests.hidden.truth.detectable import compute_detectable, count_sizes


@dataclass(frozen=True, slots=True)
class Multiplicity:
    """Effective number of trials of a search in one session of a program."""

    program: str
    soak: bool
    tests: int  # causes at their locations, each counted
    effective_tests: float  # effective number of independent tests
    looks: dict[str, float]  # per cause: effective positions, frequencies, times


def read(path: Path) -> list[Multiplicity]:
    """Return the results of `multiplicity.py`."""
    return msgspec.json.decode(path.read_bytes(), type=list[Multiplicity])


def compute_power(
    cause: str, tests: float, looks: float, alarms: float = SEARCH_FALSE_ALARMS
) -> float:
    """Return the power of the test of a cause at one detectable size.

    Args:
        cause: of the catalogue.
        tests: effective number of tests that share the false alarms.
        looks: effective trials of the cause.
        alarms: false alarms of all tests per session.
    """
    sizes = count_sizes(cause)
    threshold = float(chi2.isf(alarms / (tests * looks), sizes))
    return float(ncx2.sf(threshold, sizes, compute_detectable(cause)))


def compute_mean_power(measured: Sequence[Multiplicity], causes: Iterable[str]) -> float:
    """Return the mean power over cases of one cause each, and over the measured programs."""
    each = [_compute_measured_power(measured, cause) for cause in causes]
    return float(np.mean(each)) if each else float("nan")


def table_text(measured: Sequence[Multiplicity]) -> str:
    """Return the table of trials and power, one row per cause."""
    names = sorted({name for multiplicity in measured for name in multiplicity.looks})
    rows = []
    for name in names:
        looks = [
            multiplicity.looks[name] for multiplicity in measured if name in multiplicity.looks
        ]
        rows.append(
            (f"`{name}`", str(count_sizes(name)), f"{np.median(looks):.1f}",
             f"{100.0 * _compute_measured_power(measured, name):.0f} %")
        )  # fmt: skip
    rows.append(("mean", "", "", f"{100.0 * compute_mean_power(measured, names):.1f} %"))
    return table(
        ("cause", "amplitudes", "effective number of trials", "power at 1x of a separate test"),
        rows,
    )


def tests_table(measured: Sequence[Multiplicity]) -> str:
    """Return the table of the effective numbers of tests."""
    rows = [
        (f"`{multiplicity.program}`" + (" with soak" if multiplicity.soak else ""),
         str(multiplicity.tests), f"{multiplicity.effective_tests:.0f}")
        for multiplicity in measured
    ]  # fmt: skip
    return table(("program", "tests in the search", "effective number of independent tests"), rows)


def _compute_measured_power(measured: Sequence[Multiplicity], cause: str) -> float:
    with_cause = [multiplicity for multiplicity in measured if cause in multiplicity.looks]
    tests = float(
        np.mean([multiplicity.effective_tests for multiplicity in with_cause or measured])
    )
    looks = (
        float(np.median([multiplicity.looks[cause] for multiplicity in with_cause]))
        if with_cause
        else 1.0
    )
    return compute_power(cause, tests, looks)
