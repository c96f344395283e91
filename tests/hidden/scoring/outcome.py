"""Outcome of one case: comparison of the stated and the hidden causes.

What to use when: `judge_case` for each case with an open answer; the figures count outcomes.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tests.hidden.scoring.answers import Answer
from tests.hidden.scoring.goals import INTERVAL, TWINS
from tests.hidden.scoring.reliability import Belief, collect_beliefs
from tests.hidden.scoring.true_values import convert_true_values

AMONG, WRONG, MISSED, REST = "among", "wrong", "missed", "rest"
CRASHED = "crashed"
CRASHED_LINE: Mapping[str, Any] = {
    "raw": [], "unexplained": [], "absent": [], "calibration": {}, "not_testable": [],
    "harm_printed": False, "seconds": 0.0,
}  # fmt: skip
GAIN = ("scale", "nonorthogonality", "misalignment")  # parameters of the gain, before the axis
AXIS_CAUSES = {"axis_swap", "sign_flip", "wrong_full_scale"}
LAG_CAUSES = {"clock_skew", "clock_step", "lost_samples"}
Name = str


@dataclass(frozen=True, slots=True)
class Fate:
    """Result for one hidden cause."""

    cause: str
    place: str | None
    times: float
    said: Name  # a sole name, `among` (in a stated set), `rest`, or `missed`

    @property
    def sole(self) -> bool:
        """Whether it is the only name of a stated set."""
        return self.said == self.cause

    @property
    def stated(self) -> bool:
        """Whether it is in a stated set."""
        return self.said in (self.cause, AMONG)


@dataclass(frozen=True, slots=True)
class Coverage:
    """One interval and the true value."""

    what: str
    sigma: float  # of the difference

    @property
    def inside(self) -> bool:
        """Whether the 95 % interval contains the true value."""
        return abs(self.sigma) <= INTERVAL


@dataclass(frozen=True, slots=True)
class Outcome:
    """The judged result of one case."""

    seed: int
    kind: str
    program: str
    soak: bool
    fates: tuple[Fate, ...]
    sets: tuple[tuple[str, ...], ...]  # stated sets, with the most probable name first
    rest: tuple[str, ...]  # covariates of the unexplained rest, the strongest first
    expected: tuple[str, ...]  # its true covariates
    covered_causes: tuple[Coverage, ...]
    covered_calibration: tuple[Coverage, ...]
    harm: tuple[str, float] | None  # cause with the largest bias at its detectable size
    harm_printed: bool
    said_blind: bool  # every hidden cause was reported as not testable
    decoy: str | None
    near: str | None
    allowed: tuple[str, ...]
    ladder: bool
    seconds: float
    beliefs: tuple[Belief, ...] = ()  # of sessions with one cause of the catalogue
    gain_sigma: float | None = None  # largest error of the gain, in total standard uncertainties

    @property
    def alarmed(self) -> bool:
        """Whether anything was reported."""
        return bool(self.sets or self.rest)

    @property
    def extra(self) -> tuple[tuple[str, ...], ...]:
        """The stated sets that contain no hidden cause."""
        true = {fate.cause for fate in self.fates}
        return tuple(names for names in self.sets if not true & set(names))

    @property
    def wrong_sole(self) -> bool:
        """Whether a sole name was stated that was not hidden."""
        return any(is_sole(names) for names in self.extra)

    @property
    def misled(self) -> bool:
        """Whether a wrong sole name was stated while a hidden cause is not in any set."""
        return self.wrong_sole and not all(fate.stated for fate in self.fates)


def is_sole(names: Sequence[str]) -> bool:
    """Return whether a stated set is one name; twins of the catalogue are one."""
    return len(names) == 1 or frozenset(names) in TWINS


def judge_case(answer: Answer, line: Mapping[str, Any]) -> Outcome:
    """Judge one case. A crash counts as a wrong name."""
    if "crashed" in line:
        line = {**CRASHED_LINE, "causes": [{"set": [CRASHED]}]}
    sets = [tuple(entry["set"]) for entry in (*line["causes"], *line["raw"])]
    rest = tuple(line["unexplained"])
    fates = tuple(
        Fate(
            cause.cause, cause.place, cause.times, _find_given_name(cause.cause, sets, answer, rest)
        )
        for cause in answer.causes
    )
    absent = [limit for limit in line["absent"] if limit[4] is not None]
    worst = max(absent, key=lambda limit: float(limit[4]), default=None)
    return Outcome(
        seed=answer.seed,
        kind=answer.kind,
        program=answer.program,
        soak=answer.soak_k != 0.0,  # warmed or cooled before the session
        fates=fates,
        sets=tuple(sets),
        rest=rest,
        expected=answer.groups,
        covered_causes=tuple(_compare_causes(answer, line)),
        covered_calibration=tuple(_compare_calibration(answer, line)),
        harm=None if worst is None else (str(worst[0]), float(worst[4])),
        harm_printed=bool(line["harm_printed"]),
        said_blind=set(answer.names) <= set(line["not_testable"]),
        decoy=answer.decoy,
        near=answer.near,
        allowed=answer.allowed,
        ladder=answer.tier == "ladder",
        seconds=float(line["seconds"]),
        beliefs=collect_beliefs(answer.names[0], line) if answer.kind == "one" else (),
        gain_sigma=_compute_gain_sigma(answer, line),
    )


def _find_given_name(
    cause: str, sets: Sequence[tuple[str, ...]], answer: Answer, rest: Sequence[str]
) -> Name:
    with_it = [names for names in sets if cause in names]
    if any(is_sole(names) for names in with_it):
        return cause
    if with_it:
        return AMONG
    # If several are hidden, a wrong name counts for the case, not for one of the causes.
    alone = [names for names in sets if is_sole(names)]
    if len(answer.causes) == 1 and alone:
        return alone[0][0]
    return REST if rest else (AMONG + " others" if sets else MISSED)


def _compare_causes(answer: Answer, line: Mapping[str, Any]) -> list[Coverage]:
    """Compare each named size with its true value, if the name is right and has one."""
    coverages = []
    for hidden in answer.causes:
        named = [entry for entry in line["causes"] if entry["set"][0] == hidden.cause]
        for entry in named[:1]:
            true_sizes = convert_true_values(hidden.cause, hidden.place, hidden.parameters)
            for name, true in true_sizes:
                value, std = entry["values"].get(name, (None, None))
                if value is not None and std and name in entry["sizes"]:
                    coverages.append(Coverage(f"{hidden.cause}.{name}", (value - true) / std))
    return coverages


def _compute_gain_sigma(answer: Answer, line: Mapping[str, Any]) -> float | None:
    """Return the largest error of the gain, None if no entry is stated or comparable."""
    errors = [
        abs(line["calibration"][name][0] - true) / line["total_std"][name]
        for name, true in answer.calibration.items()
        if name.partition(".")[0] in GAIN
        and line.get("total_std", {}).get(name)
        and math.isfinite(true)
    ]
    return None if set(answer.names) & AXIS_CAUSES else max(errors, default=None)


def _compare_calibration(answer: Answer, line: Mapping[str, Any]) -> list[Coverage]:
    """Compare the calibration after selection with the true values.

    With exchanged or inverted axes the gain has another definition. A lag that changes is not a
    single time offset.
    """
    hidden = set(answer.names)
    if hidden & AXIS_CAUSES:
        return []
    coverages = []
    for name, true in answer.calibration.items():
        if name == "time_offset" and hidden & LAG_CAUSES:
            continue
        value, std, _ = line["calibration"].get(name, (None, None, None))
        if value is not None and std and math.isfinite(true):
            coverages.append(Coverage(name, (value - true) / std))
    return coverages
