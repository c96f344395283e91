"""Looking for the program that tells most in a given time.

Many designs are drawn and judged quickly (`quick`). The best of both kinds of the family are
walked downhill, one number at a time. The best of a few kinds, and then those near the best
of all, are judged by the full prediction, which decides. The same seed gives the same program.

For causes a stay is given as many tilts and speeds as the time allows, and the rest is
decided by how large causes must be to be known by name. A function of tilt or speed that
no catalogue has shows only where there are more of them than the function has parameters
(three more; notes on discovery, section 3.3), so levels come before standard deviations.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram
from gyrorig_solver.model.terms.scene import Site
from gyrorig_solver.plan.causes import Outlook, foresee
from gyrorig_solver.plan.criterion import Criterion, cost, drawback
from gyrorig_solver.plan.family import CHOICES, ROUNDS_ONLY, Design, Space, drawn, program_of
from gyrorig_solver.plan.predict import Prediction, predict
from gyrorig_solver.plan.quick import Quick
from gyrorig_solver.plan.sensor import SensorModel
from gyrorig_solver.plan.unit import UnitModel

DRAWN, WALKED, KINDS = 150, 3, 8  # of each kind of the family; kinds of design, of both
NEAR = ("pan_span", "tilt_span")
# Zero rate and scale of a part of its family leave so much of the range for the motion.
USABLE_RANGE = 0.75

Aim = Literal["calibration", "causes"]
AIMS: tuple[str, ...] = get_args(Aim)
# Tilts and speeds for causes, the most wanted first; and swings of tilt at each.
LEVELS = ((5, 4), (5, 3), (3, 4), (3, 3), (3, 2), (3, 1))
SWINGS = (1, 2, 4)

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The best program that was found, and what it was chosen from."""

    design: Design
    prediction: Prediction
    cost: float  # by the criterion
    judged: int  # designs looked at
    outlook: Outlook | None = None  # where it was looked for by causes

    @property
    def program(self) -> MotionProgram:
        """The program itself."""
        return self.prediction.program


def find_program(
    unit: UnitModel,
    sensor: SensorModel,
    seconds: float,
    criterion: Criterion = "worst",
    seed: int = 1,
    progress: Progress = lambda text: None,
    aim: Aim = "calibration",
    site: Site | None = None,
) -> Found:
    """Return the best program of the family within a time.

    Args:
        unit: what carries it out.
        sensor: what is to be calibrated.
        seconds: how long the recording may last.
        criterion: see `criterion.cost`.
        seed: of the designs drawn.
        progress: is told what is being done.
        aim: least standard deviations, or causes known by name.
        site: where the rig stands; for causes.

    Raises:
        UsageError: no program of the family fits into so little time.
    """
    space = Space.of(unit, float(np.degrees(sensor.full_scale_rad_s)) * USABLE_RANGE)
    quick = Quick(unit, sensor, space, seconds, criterion)
    if aim == "causes":
        return _for_causes(quick, (unit, sensor, site), criterion, progress)
    rng = np.random.default_rng(seed)
    for once, name in ((False, "rounds"), (True, "stays")):
        designs = sorted({drawn(rng, once) for _ in range(DRAWN)}, key=repr)
        progress(f"judging {len(designs)} programs of {name} quickly")
        ranked = sorted(designs, key=quick.cost)
        for number, design in enumerate(ranked[:WALKED], start=1):
            progress(f"improving program {number} of {WALKED} of {name}")
            _downhill(design, quick)
    if not quick.best_kinds(1):
        raise _too_short(quick, seconds)
    found: dict[Design, Found] = {}
    weighed: dict[Design, float] = {}

    def judge(designs: Sequence[Design], what: str) -> Design:
        for number, design in enumerate(designs, start=1):
            progress(f"predicting {what} {number} of {len(designs)}")
            if design not in found and np.isfinite(quick.cost(design)):
                with suppress(UsageError):  # its cycle is a little longer than it seemed
                    prediction = predict(program_of(design, space, unit, seconds), unit, sensor)
                    value = cost(prediction.decision, criterion)
                    weighed[design] = value * drawback(
                        prediction.decision, prediction.bias_floor_rad_s
                    )
                    found[design] = Found(design, prediction, value, quick.judged)
        if not found:
            raise _too_short(quick, seconds)
        return min(found, key=weighed.__getitem__)

    best = judge(quick.best_kinds(KINDS), "kind")
    best = judge([d for d in _neighbours(best) if _differs_in(d, best, NEAR)], "neighbour")
    return found[best]


def _for_causes(
    quick: Quick,
    rig: tuple[UnitModel, SensorModel, Site | None],
    criterion: Criterion,
    progress: Progress,
) -> Found:
    """Return the program with the most levels that fit, and of those the least blind one.

    Over the whole range, as fast as the unit may, with the shortest rests.
    """
    unit, sensor, site = rig
    found: list[Found] = []
    for poses, speeds in LEVELS:
        for swings in SWINGS:
            design = _survey(poses, speeds, swings)
            with suppress(UsageError):
                made = program_of(design, quick.space, unit, quick.seconds)
                progress(f"looking for causes with {poses} tilts, {speeds} speeds, {swings} swings")
                prediction = predict(made, unit, sensor)
                outlook = foresee(prediction, sensor, site)
                value = cost(prediction.decision, criterion)
                found.append(Found(design, prediction, value, len(found) + 1, outlook))
        if found:
            best = min(found, key=lambda one: one.outlook.blindness if one.outlook else np.inf)
            return replace(best, judged=len(found))
    shortest = _survey(*LEVELS[-1], SWINGS[0])
    quick.cost(shortest)
    raise UsageError(
        f"{quick.seconds:g} s is too short for a program that tells causes apart",
        f"give --seconds {np.ceil(quick.least_s[shortest]):.0f} or more",
    )


def _survey(poses: int, speeds: int, swings: int) -> Design:
    return Design(
        poses=poses,
        passes=speeds,
        swings=swings,
        along=False,
        weave=0,
        pan_span=1.0,
        tilt_span=1.0,
        pan_speed=1.0,
        tilt_speed=1.0,
        acceleration_deg_s2=max(CHOICES["acceleration_deg_s2"]),
        dwell_s=min(CHOICES["dwell_s"]),
        once=True,
        speeds=speeds,
        again=True,
    )


def _downhill(design: Design, quick: Quick) -> None:
    """Change one number at a time, to any of its choices, as long as that helps."""
    here, value = design, quick.cost(design)
    if not np.isfinite(value):
        return
    while True:
        better = min(_neighbours(here), key=quick.cost)
        if not quick.cost(better) < value * (1.0 - 1e-6):
            return
        here, value = better, quick.cost(better)


def _neighbours(design: Design) -> Iterator[Design]:
    for name, choices in CHOICES.items():
        if design.once and name in ROUNDS_ONLY:
            continue
        for choice in choices:
            if choice != getattr(design, name):
                yield replace(design, **{name: choice})  # type: ignore[arg-type] # as in drawn


def _differs_in(design: Design, other: Design, names: tuple[str, ...]) -> bool:
    return any(getattr(design, name) != getattr(other, name) for name in names)


def _too_short(quick: Quick, seconds: float) -> UsageError:
    """Return what to say where nothing fits: the shortest of the programs drawn lasts longer."""
    return UsageError(
        f"{seconds:g} s is too short for a program that shows all parameters",
        f"give --seconds {np.ceil(min(quick.least_s.values())):.0f} or more",
    )
