"""The motion program that separates causes that a search could not separate.

The solver computes once how well each block of motion separates each pair of causes. It then
chooses blocks in sequence by their gain per second, until each pair is separated with enough
probability or the time is used up. Finally it evaluates the chosen program as a whole.

Source: T-optimal design; Atkinson and Fedorov, Biometrika 62 (1975) 57.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from scipy import special

from gyrorig_protocol.program import MotionProgram, PtuSettings
from gyrorig_solver.discover import FALSE_ALARM_RATE, FitExplanation
from gyrorig_solver.discover.cause_ranking import nats_for_sole_name
from gyrorig_solver.discover.testable_terms import count_tests
from gyrorig_solver.estimate import ConvergedFit, SessionFit
from gyrorig_solver.model import term_label
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.numerics import chi2_noncentrality, chi2_quantile
from gyrorig_solver.plan.program_family import MotionSpace
from gyrorig_solver.plan.program_timeline import simulate_program
from gyrorig_solver.plan.separation.cause_pairs import (
    CausePair,
    FirstOrder,
    PairProducts,
    expected_nats,
    fitted_pairs,
    judged_by_typical_noise,
    pair_products,
    unseen_cause,
)
from gyrorig_solver.plan.separation.motion_blocks import (
    BLOCK_STATIC_S,
    STATIC_S,
    MotionBlock,
    motion_blocks,
    program_of_blocks,
)
from gyrorig_solver.plan.separation.simulated_recording import simulate_recording
from gyrorig_solver.plan.unit_model import UnitModel
from gyrorig_solver.reference import PanTiltReference

MAX_PROGRAM_S = 120.0
PROGRAM_NAME = "next-program"
DECISION_SIGMA = 2.6  # deviations of the log Bayes factor below its mean: 0.5 % fall below
DETECTION_POWER = 0.99  # of a cause of the typical size
MIN_PROBABILITY = 0.05  # of the best pair; a program with a smaller probability is not proposed
MIN_ADDED_NATS = 0.1  # by a block
USABLE_RANGE_SHARE = 0.9  # of the full scale of the gyroscope
ACCELERATION_SHARES = (1.0, 0.5)  # of that of the recording
BLOCKS_TRIED_AGAIN = 12  # at the second acceleration, in addition to the blocks chosen at the first
DEFAULT_FULL_SCALE_DEG_S = 250.0


@dataclass(frozen=True, slots=True)
class PairOutlook:
    """Expected result of a program for two causes."""

    causes: tuple[str, ...]  # a single cause has no rival
    nats: float  # expected log Bayes factor, the smaller of both truths
    probability: float  # that only the true cause is named, or that a single cause is detected

    @property
    def is_separated(self) -> bool:
        """Whether a decision is more probable than not."""
        return self.probability > 0.5


@dataclass(frozen=True, slots=True, eq=False)
class NextExperiment:
    """A motion program with its expected results; None as program if no program helps."""

    program: MotionProgram | None
    duration_s: float
    max_duration_s: float  # the allowed maximum
    outlooks: tuple[PairOutlook, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """A block with its duration and the products of all pairs."""

    block: MotionBlock
    duration_s: float
    products: tuple[PairProducts, ...]


def propose_program(
    explanation: FitExplanation,
    unit: UnitModel,
    max_duration_s: float = MAX_PROGRAM_S,
    unseen: Sequence[str] = (),
) -> NextExperiment | None:
    """Return the program that separates the causes of each ambiguous set best.

    Args:
        explanation: the findings of one board, with their fit.
        unit: with its limits.
        max_duration_s: of the program.
        unseen: causes that the program must show at their typical size.

    Returns:
        None if no cause is ambiguous or unseen, or the reference is not a pan-tilt unit.
    """
    solution = judged_by_typical_noise(explanation.solution_extended)
    if not isinstance(_last_motion(solution).reference, PanTiltReference):
        return None
    groups = ambiguous_groups(explanation, solution)
    alone = {cause: unseen_cause(solution, cause) for cause in unseen}
    groups += [[pair] for pair in alone.values() if pair is not None]
    hidden = tuple(PairOutlook((cause,), 0.0, 0.0) for cause, pair in alone.items() if not pair)
    if not groups:
        return NextExperiment(None, 0.0, max_duration_s, hidden) if hidden else None
    design = _Design(solution, unit, groups, max_duration_s)
    choices = [design.choose(ACCELERATION_SHARES[0], motion_blocks(design.space))]
    if choices[0].is_lacking:
        blocks = choices[0].most_useful
        choices += [design.choose(share, blocks) for share in ACCELERATION_SHARES[1:]]
    best = max(choices, key=lambda choice: round(choice.worth_nats, 1))
    proposed = design.judge(best)
    return replace(proposed, outlooks=(*proposed.outlooks, *hidden))


def ambiguous_groups(explanation: FitExplanation, solution: ConvergedFit) -> list[list[CausePair]]:
    """Return the pairs of each ambiguous set; those of one cause of the fit are together."""
    fitted = {term_label(cause.term): cause for cause in solution.fitted_terms}
    groups = []
    for cause in explanation.findings.causes:
        named = fitted.get(term_label(cause.term))
        if named is None or not cause.one_of or not named.free_indices.size:
            continue
        pairs = fitted_pairs(solution, named, cause.one_of)
        if pairs:
            groups.append(pairs)
    return groups


@dataclass(frozen=True, slots=True, eq=False)
class _Choice:
    """Chosen blocks with their settings."""

    blocks: tuple[MotionBlock, ...]
    settings: PtuSettings
    worth_nats: float  # expected nats of all pairs, each limited to the nats that a decision needs
    is_lacking: bool  # whether a pair needs more nats
    # the chosen blocks first, then the best others, each alone
    most_useful: tuple[MotionBlock, ...]


class _Design:
    """The choice of a program for some pairs of causes."""

    def __init__(
        self,
        solution: ConvergedFit,
        unit: UnitModel,
        groups: Sequence[Sequence[CausePair]],
        max_duration_s: float,
    ) -> None:
        self._solution, self._unit = solution, unit
        self._groups, self._max_duration_s = groups, max_duration_s
        self._pairs = [pair for group in groups for pair in group]
        self._test_count = count_tests(tuple(catalogue().values()))
        self._first_order = [FirstOrder(pair, solution) for pair in self._pairs]
        self.space = MotionSpace.of(unit, _fastest_deg_s(solution))

    def choose(self, acceleration_share: float, blocks: Iterable[MotionBlock]) -> _Choice:
        """Choose blocks in sequence, at one acceleration, by their gain in nats per second."""
        settings = self._settings(acceleration_share)
        empty = program_of_blocks((), self.space, settings, PROGRAM_NAME)
        fixed_s = simulate_program(empty, self._unit).duration_s
        alone_s = fixed_s - 2.0 * (STATIC_S - BLOCK_STATIC_S)
        candidates = [self._candidate(block, settings, alone_s) for block in blocks]
        chosen: list[_Candidate] = []
        left_s, worth = self._max_duration_s - fixed_s, self._worth(())
        while True:
            options = []
            for candidate in candidates:
                if candidate.duration_s <= left_s:
                    added = self._worth([*chosen, candidate]) - worth
                    options.append((added / candidate.duration_s, added, candidate))
            _, added, best = max(options, key=lambda option: option[0], default=(0.0, 0.0, None))
            if best is None or added < MIN_ADDED_NATS:
                break
            chosen.append(best)
            left_s, worth = left_s - best.duration_s, worth + added
        chosen_blocks = tuple(candidate.block for candidate in chosen)
        is_lacking = any(nats < needed for nats, needed in self._nats_and_needs(chosen))
        rest = sorted(
            (candidate for candidate in candidates if candidate.block not in chosen_blocks),
            key=lambda candidate: -self._worth([candidate]) / candidate.duration_s,
        )
        useful = dict.fromkeys(
            [*chosen_blocks, *(candidate.block for candidate in rest[:BLOCKS_TRIED_AGAIN])]
        )
        return _Choice(chosen_blocks, settings, worth, is_lacking, tuple(useful))

    def judge(self, choice: _Choice) -> NextExperiment:
        """Return the program of a choice with its exact expected results."""
        program = program_of_blocks(choice.blocks, self.space, choice.settings, PROGRAM_NAME)
        if not choice.blocks:
            outlooks = tuple(PairOutlook(pair.causes, 0.0, 0.0) for pair in self._pairs)
            return NextExperiment(None, 0.0, self._max_duration_s, outlooks)
        simulated = simulate_recording(self._solution, program, self._unit)
        outlooks = tuple(self._outlook(pair, simulated) for pair in self._pairs)
        duration_s = simulate_program(program, self._unit).duration_s
        is_useful = any(outlook.probability > MIN_PROBABILITY for outlook in outlooks)
        return NextExperiment(
            program if is_useful else None, duration_s, self._max_duration_s, outlooks
        )

    def _outlook(self, pair: CausePair, simulated: ConvergedFit) -> PairOutlook:
        outcomes = expected_nats(pair, self._solution, simulated)
        if pair.second is None:
            probabilities = [self._detection_probability(pair, nats) for nats, _ in outcomes]
        else:
            probabilities = [sole_name_probability(*outcome) for outcome in outcomes]
        nats = max(0.0, min(nats for nats, _ in outcomes))
        return PairOutlook(pair.causes, nats, float(np.mean(probabilities)))

    def _candidate(self, block: MotionBlock, settings: PtuSettings, fixed_s: float) -> _Candidate:
        program = program_of_blocks((block,), self.space, settings, PROGRAM_NAME, BLOCK_STATIC_S)
        simulated = simulate_recording(self._solution, program, self._unit)
        duration_s = simulate_program(program, self._unit).duration_s - fixed_s
        products = [pair for group in self._groups for pair in pair_products(simulated, group)]
        return _Candidate(block, duration_s, tuple(products))

    def _worth(self, chosen: Sequence[_Candidate]) -> float:
        """Return the expected nats of all pairs, each limited to the nats that a decision needs."""
        return sum(min(nats, needed) for nats, needed in self._nats_and_needs(chosen))

    def _nats_and_needs(self, chosen: Sequence[_Candidate]) -> Iterator[tuple[float, float]]:
        """Yield for each pair the expected nats, and the nats that a decision needs."""
        for k, first_order in enumerate(self._first_order):
            new = reduce(add, (candidate.products[k] for candidate in chosen)) if chosen else None
            nats, gain_nats = first_order.outlook(new)
            if self._pairs[k].second is None:
                yield nats, self._detection_nats(self._pairs[k])
            else:
                yield nats, _needed_nats(nats_for_sole_name(gain_nats))

    def _detection_limit(self, pair: CausePair) -> float:
        """Return the statistic at which a search names a cause."""
        return chi2_quantile(FALSE_ALARM_RATE / self._test_count, pair.size_count)

    def _detection_nats(self, pair: CausePair) -> float:
        """Return the expected nats with which a search almost always names a cause."""
        limit = self._detection_limit(pair)
        return 0.5 * chi2_noncentrality(limit, pair.size_count, DETECTION_POWER)

    def _detection_probability(self, pair: CausePair, nats: float) -> float:
        limit = self._detection_limit(pair)
        return float(1.0 - special.chndtr(limit, pair.size_count, 2.0 * nats))

    def _settings(self, acceleration_share: float) -> PtuSettings:
        pan = self._unit.pan
        deg_per_step = pan.resolution_arcsec / 3600.0
        acceleration = self._unit.acceleration_steps_s2 * deg_per_step * acceleration_share
        base_speed = self._unit.base_speed_steps_s * deg_per_step
        return PtuSettings(
            base_speed_deg_s=round(base_speed, 3) if base_speed > 0.0 else None,
            acceleration_deg_s2=round(acceleration, 3),
            default_speed_deg_s=self.space.pan_speed_deg_s,
        )


def sole_name_probability(nats: float, gain_nats: float) -> float:
    """Return the probability that only the true cause is named, from its log Bayes factor.

    A log Bayes factor with mean D has the variance 2 D if the cause is true.
    """
    if nats <= 0.0:
        return 0.0
    return float(special.ndtr((nats - nats_for_sole_name(gain_nats)) / np.sqrt(2.0 * nats)))


def _needed_nats(threshold_nats: float) -> float:
    """Return the expected log Bayes factor whose lower tail still exceeds a threshold."""
    root = np.sqrt(2.0) * DECISION_SIGMA
    return float(0.25 * (root + np.sqrt(root**2 + 4.0 * threshold_nats)) ** 2)


def _last_motion(solution: ConvergedFit) -> SessionFit:
    """Return the fit of the last recording that moves."""
    return solution.sessions[solution.offset_recording]


def _fastest_deg_s(solution: ConvergedFit) -> float:
    context = _last_motion(solution).context
    full_scale = None if context is None else context.full_scale_rad_s
    limit = DEFAULT_FULL_SCALE_DEG_S if full_scale is None else float(np.degrees(full_scale))
    return limit * USABLE_RANGE_SHARE
