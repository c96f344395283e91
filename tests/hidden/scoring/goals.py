"""Goals of the tests with hidden effects, set before the first run and only made stricter later.

What to use when: `GOALS` for the whole list in the order of the page; a single limit by name.
"""

from dataclasses import dataclass
from typing import Literal

NULLS, HIDDEN = 1000, 1000  # minimum number of sessions of the long tier
FALSE_ALARMS, FALSE_ALARMS_UPPER = 0.005, 0.01
SEARCH_FALSE_ALARMS = 0.01  # of all tests of a session, as the search is configured
SOLE_RIGHT, SOLE_RIGHT_SOAK = 0.99, 0.99
WRONG_NAMES, WRONG_NAMES_AMONG = 0, 1000
DETECTED_ONCE = 0.77  # at the minimum detectable size; theory 80 %
OUTSIDE_WRONG = 1.0 / 500.0
OUTSIDE_GROUP = 0.97
NEARLY_WRONG = 0.02
RECALL, PRECISION = 0.97, 0.99
RIG_RECALL, RIG_PRECISION, RIG_GAIN = 0.85, 0.98, 0.99
RIG_GAIN_SIGMA = 4.0  # total standard uncertainties of an entry of the gain
GAP_PER_VALUE, GAP_BEYOND = 0.5, 1.0  # nats short of the oracle: p/2 + 1
COVERED_LOW, COVERED_HIGH = 0.935, 0.975
COMPLETE_LEFT = 0.002  # of an effect's energy
EIGHT_CAUSES_S, PLAIN_S = 60.0, 2.0

# Sizes in minimum detectable sizes, and the tolerance of a size.
RUNGS = (1.0, 2.0, 3.0)
RUNG_WIDTH = 0.05
# Smallest sizes at which names must be right, and at which outside shapes must be detected.
NAMED_TIMES, OUTSIDE_TIMES = 2.0, 3.0
DETECTABLE = 1.0  # smallest size at which one cause of many counts as detectable

INTERVAL = 1.959963984540054  # deviations of a 95 % interval

# Tilt sag and tilt eccentricity are the same function of the angle, s sin(tilt + p), so that no
# measurement of rates can separate them. A stated set of these two counts as one name.
TWINS = (frozenset({"tilt_sag", "eccentricity"}),)

Sense = Literal["below", "above", "between", "shown"]


@dataclass(frozen=True, slots=True)
class Goal:
    """One line of the table."""

    number: int
    name: str  # of the figure in `compute_figures`
    words: str
    sense: Sense
    low: float | None = None
    high: float | None = None

    def is_met(self, value: float) -> bool:
        """Return whether a figure meets the goal."""
        above = self.low is None or value >= self.low
        below = self.high is None or value <= self.high
        return above and below


GOALS = (
    Goal(1, "false_alarms",
         "sessions without a hidden cause: false alarms", "below", high=FALSE_ALARMS),
    Goal(1, "false_alarms_upper", "upper 95 % limit of these false alarms", "below",
         high=FALSE_ALARMS_UPPER),
    Goal(2, "sole_right", "sole right name at 2x and 3x", "above", low=SOLE_RIGHT),
    Goal(2, "sole_right_soak", "sole right name at 2x and 3x, with a soak", "above",
         low=SOLE_RIGHT_SOAK),
    Goal(3, "wrong_names", "number of wrong sole names at 2x and more", "below",
         high=WRONG_NAMES),
    Goal(4, "detected_once", "detected at 1x", "above", low=DETECTED_ONCE),
    Goal(5, "outside_wrong", "shapes outside the catalogue, 3x and more: wrong sole name", "below",
         high=OUTSIDE_WRONG),
    Goal(5, "outside_group", "shapes outside the catalogue, 3x and more: right covariate", "above",
         low=OUTSIDE_GROUP),
    Goal(5, "nearly_wrong", "shapes similar to a cause, 3x and more: wrong sole name", "below",
         high=NEARLY_WRONG),
    Goal(6, "recall", "4 to 8 causes at once: recall", "above", low=RECALL),
    Goal(6, "precision", "4 to 8 causes at once: precision", "above", low=PRECISION),
    Goal(6, "rig_recall", "all 13 persistent causes at once: recall", "above", low=RIG_RECALL),
    Goal(6, "rig_precision", "all 13 persistent causes at once: precision", "above",
         low=RIG_PRECISION),
    Goal(6, "rig_gain", "all 13 persistent causes at once: every entry of the gain within four"
         " total standard uncertainties", "above", low=RIG_GAIN),
    Goal(7, "gap", "difference of the held-out gain from the oracle's, minus (p/2 + 1)", "below",
         high=0.0),
    Goal(8, "covered_causes", "coverage of 95 % intervals of named values", "between",
         COVERED_LOW, COVERED_HIGH),
    Goal(8, "covered_calibration", "coverage of 95 % intervals of the calibration", "between",
         COVERED_LOW, COVERED_HIGH),
    Goal(10, "harm_printed", "largest undetected bias is reported", "above", low=1.0),
)  # fmt: skip
