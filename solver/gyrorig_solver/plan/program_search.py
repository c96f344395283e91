"""Search for the program with the least cost in a given time.

Many random designs are screened with white noise (`white_noise_screen`). Coordinate descent
improves the best designs of both families. The full prediction decides between the best of a few
kinds for each number of tilts, and their neighbours. It uses the total uncertainty: noise, and the
causes that the program does not determine. The same seed gives the same program.

For causes, a stay gets as many tilts and speeds as the time allows, and the mean identifiable size
decides the rest. An unknown function of tilt or speed is visible only if there are more levels than
the function has parameters; therefore levels have priority over uncertainties.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram
from gyrorig_solver.model import Site
from gyrorig_solver.plan.criterion import Criterion, bias_penalty, cost
from gyrorig_solver.plan.detectability import DetectabilityReport, predict_detectability
from gyrorig_solver.plan.prediction import Prediction, predict_program
from gyrorig_solver.plan.program_family import (
    CHOICES,
    ROUND_ONLY_DEFAULTS,
    MotionSpace,
    ProgramDesign,
    build_program,
    draw_design,
)
from gyrorig_solver.plan.program_timeline import MAX_DURATION_S
from gyrorig_solver.plan.sensor_model import SensorModel
from gyrorig_solver.plan.total_prediction import PlanPrior, TotalPrediction, predict_total
from gyrorig_solver.plan.unit_model import UnitModel
from gyrorig_solver.plan.white_noise_screen import WhiteNoiseScreen
from gyrorig_solver.uncertainty import default_settings

# Drawn and improved designs of each family; predicted kinds of design for each number of tilts.
DRAWN_DESIGNS, IMPROVED_DESIGNS, PREDICTED_KINDS = 150, 3, 4
REFINED_FIELDS = ("poses", "passes", "swings", "pan_span", "tilt_span")
# Share of the full scale for the motion; zero-rate offset and scale error of a part need the rest.
USABLE_RANGE_SHARE = 0.75

Aim = Literal["calibration", "causes"]
AIMS: tuple[str, ...] = get_args(Aim)
# Numbers of tilts and speeds for causes, in order of preference; numbers of swings at each tilt.
SURVEY_LEVELS = ((5, 4), (5, 3), (3, 4), (3, 3), (3, 2), (3, 1))
SURVEY_SWINGS = (1, 2, 4)

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult:
    """The selected program and the number of programs compared."""

    design: ProgramDesign
    prediction: Prediction
    cost: float  # by the criterion
    total: TotalPrediction
    design_count: int  # designs evaluated
    detectability: DetectabilityReport | None = None  # only of a search for causes

    @property
    def program(self) -> MotionProgram:
        """The selected program."""
        return self.prediction.program


def find_program(
    unit: UnitModel,
    sensor: SensorModel,
    duration_s: float,
    criterion: Criterion = "worst",
    seed: int = 1,
    progress: Progress = lambda text: None,
    aim: Aim = "calibration",
    site: Site | None = None,
    prior: PlanPrior | None = None,
) -> PlanResult:
    """Search for the best program of the family within a time.

    The designs are drawn with `seed`. Without prior sizes, the search minimises only the
    uncertainty from noise.

    Raises:
        UsageError: no program of the family fits into the time.
    """
    space = MotionSpace.of(unit, float(np.degrees(sensor.full_scale_rad_s)) * USABLE_RANGE_SHARE)
    screen = WhiteNoiseScreen(unit, sensor, space, duration_s, criterion)
    site = site or Site()
    prior = prior or PlanPrior(default_settings())
    if aim == "causes":
        return _find_for_causes(screen, (unit, sensor, site), prior, criterion, progress)
    rng = np.random.default_rng(seed)
    for once, name in ((False, "round"), (True, "stay")):
        designs = sorted({draw_design(rng, once) for _ in range(DRAWN_DESIGNS)}, key=repr)
        progress(f"estimating {len(designs)} {name} programs")
        ranked = sorted(designs, key=screen.cost)
        for number, design in enumerate(ranked[:IMPROVED_DESIGNS], start=1):
            progress(f"improving {name} program {number} of {IMPROVED_DESIGNS}")
            _improve_design(design, screen)
    if not screen.best_kinds(1):
        raise _too_short(screen, duration_s)
    results: dict[ProgramDesign, PlanResult] = {}
    weighted_costs: dict[ProgramDesign, float] = {}

    def judge(designs: Sequence[ProgramDesign], label: str) -> ProgramDesign:
        for number, design in enumerate(designs, start=1):
            progress(f"predicting {label} {number} of {len(designs)}")
            if design not in results and np.isfinite(screen.cost(design)):
                # its cycle is slightly longer than the screening estimated
                with suppress(UsageError):
                    prediction = predict_program(
                        build_program(design, space, unit, duration_s), unit, sensor
                    )
                    total = predict_total(prediction, sensor, site, prior)
                    cost_value = cost(total.decision, criterion)
                    weighted_costs[design] = cost_value * bias_penalty(
                        prediction.decision, prediction.bias_floor_rad_s
                    )
                    results[design] = PlanResult(
                        design, prediction, cost_value, total, screen.design_count
                    )
        if not results:
            raise _too_short(screen, duration_s)
        return min(results, key=weighted_costs.__getitem__)

    best = judge(screen.best_kinds(PREDICTED_KINDS), "kind")
    best = judge(
        [
            d
            for d in _neighbours(best)
            if any(getattr(d, name) != getattr(best, name) for name in REFINED_FIELDS)
        ],
        "neighbour",
    )
    return results[best]


def _find_for_causes(
    screen: WhiteNoiseScreen,
    rig: tuple[UnitModel, SensorModel, Site],
    prior: PlanPrior,
    criterion: Criterion,
    progress: Progress,
) -> PlanResult:
    """Return the program with the most levels that fit, with the smallest mean identifiable size.

    The design uses the whole range, the unit's highest speed and the shortest rests.
    """
    unit, sensor, site = rig
    results: list[PlanResult] = []
    for poses, speeds in SURVEY_LEVELS:
        for swings in SURVEY_SWINGS:
            design = _survey_design(poses, speeds, swings)
            with suppress(UsageError):
                program = build_program(design, screen.space, unit, screen.duration_s)
                progress(f"predicting causes with {poses} tilts, {speeds} speeds, {swings} swings")
                prediction = predict_program(program, unit, sensor)
                detectability = predict_detectability(prediction, sensor, site)
                total = predict_total(prediction, sensor, site, prior)
                cost_value = cost(total.decision, criterion)
                count = len(results) + 1
                results.append(
                    PlanResult(design, prediction, cost_value, total, count, detectability)
                )
        if results:
            best = min(
                results,
                key=lambda result: (
                    result.detectability.mean_identifiable_size if result.detectability else np.inf
                ),
            )
            return replace(best, design_count=len(results))
    shortest = _survey_design(*SURVEY_LEVELS[-1], SURVEY_SWINGS[0])
    screen.cost(shortest)
    raise UsageError(
        f"a motion program of {screen.duration_s:g} s is too short to separate causes",
        f"give --seconds {np.ceil(screen.min_duration_s[shortest]):.0f} or more",
    )


def _survey_design(poses: int, speeds: int, swings: int) -> ProgramDesign:
    return ProgramDesign(
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


def _improve_design(design: ProgramDesign, screen: WhiteNoiseScreen) -> None:
    """Improve a design by coordinate descent over its choices."""
    current, value = design, screen.cost(design)
    if not np.isfinite(value):
        return
    while True:
        better = min(_neighbours(current), key=screen.cost)
        if not screen.cost(better) < value * (1.0 - 1e-6):
            return
        current, value = better, screen.cost(better)


def _neighbours(design: ProgramDesign) -> Iterator[ProgramDesign]:
    for name, choices in CHOICES.items():
        if design.once and name in ROUND_ONLY_DEFAULTS:
            continue
        for choice in choices:
            if choice != getattr(design, name):
                yield replace(design, **{name: choice})  # type: ignore[arg-type] # as in drawn


def _too_short(screen: WhiteNoiseScreen, duration_s: float) -> UsageError:
    """Return the error for a time that is too short for any program, with the minimum length."""
    least_s = min(screen.min_duration_s.values(), default=MAX_DURATION_S)
    return UsageError(
        f"a motion program of {duration_s:g} s is too short to determine all parameters",
        f"give --seconds {np.ceil(least_s):.0f} or more",
    )
