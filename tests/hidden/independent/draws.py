"""Draw a session from one seed: the rig, the program, and causes or an effect with their sizes.

What to use when: `draw_session` for the session of a seed and a tier.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from tests.bench.rigs.prior_sizes import HiddenCauses
from tests.bench.rigs.rig import read_program
from tests.bench.rigs.serial_session import run_program
from tests.hidden.independent.causes import COUNTED, HIDEABLE, IN_VARIANCE, Hiding, draw_hiding
from tests.hidden.independent.effects import EFFECTS
from tests.hidden.independent.effects.effect import Effect, OutsideEffect
from tests.hidden.independent.low_passes import ASSUMED
from tests.hidden.independent.parts import RigParts, draw_parts
from tests.hidden.independent.simulation import NO_CAUSES, NO_EFFECT, Scene, change_moves
from tests.hidden.independent.sizing import (
    Sized,
    combine_causes,
    compute_cause_noncentrality,
    find_cause_size,
    find_effect_size,
    make_effect,
)
from tests.hidden.independent.visibility import Visibility
from tests.hidden.truth.detectable import compute_detectable

from gyrorig_protocol.program import MotionProgram

# The index of a tier is part of the seed: add new tiers at the end.
TIERS = ("nulls", "ladder", "many", "outside")
RUNGS = (1.0, 2.0, 3.0)
SHORT_PROGRAM = "survey-40"
PROGRAMS = {
    "nulls": ((SHORT_PROGRAM, 0.7), ("planned-75", 0.15), ("survey-130", 0.15)),
    "ladder": ((SHORT_PROGRAM, 0.7), ("survey-130", 0.3)),
    "many": ((SHORT_PROGRAM, 0.5), ("survey-130", 0.5)),
    "outside": ((SHORT_PROGRAM, 0.7), ("survey-130", 0.3)),
}
MANY_COUNT, MANY_TIMES, OUTSIDE_TIMES = (2, 8), (2.0, 6.0), (3.0, 8.0)
MAX_REFITS, RUNG_WIDTH = 3, 0.06  # of the non-centrality, after the simulation of the session
MOST_FILTER_TIMES = 0.35  # of the minimal detectable size; more would be an effect
SESSION_STREAM = 0x5345


@dataclass(frozen=True, slots=True)
class HiddenCause:
    """A cause of the catalogue with its size."""

    hiding: Hiding
    times: float  # wanted size in minimal detectable sizes
    sized: Sized


@dataclass(frozen=True, slots=True)
class HiddenEffect:
    """An effect outside the catalogue with its size."""

    entry: OutsideEffect
    times: float
    sized: Sized


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """One session before its samples are drawn."""

    seed: int
    tier: str
    kind: str
    program: MotionProgram
    visibility: Visibility
    causes: tuple[HiddenCause, ...] = ()
    effect: HiddenEffect | None = None
    rung: float | None = None

    @property
    def scene(self) -> Scene:
        """The rig and its session."""
        return self.visibility.scene

    @property
    def items(self) -> list[tuple[Hiding, float]]:
        """Causes and sizes."""
        return [(cause.hiding, cause.sized.size) for cause in self.causes]

    @property
    def hidden_causes(self) -> HiddenCauses:
        """All causes together."""
        return combine_causes(self.items)

    @property
    def hidden_effect(self) -> Effect:
        """The effect outside the catalogue."""
        if self.effect is None:
            return NO_EFFECT
        return make_effect(self.visibility, self.effect.entry, self.effect.sized.size)


def draw_session(
    seed: int,
    tier: str,
    rungs: Sequence[float] = RUNGS,
    program: str = "",
    filters: str = "mild",
) -> Session:
    """Return the session of a seed, a pure function of its arguments.

    Args:
        seed: of everything.
        tier: one of `TIERS`.
        rungs: of a ladder, in minimal detectable sizes.
        program: instead of a drawn one.
        filters: of the sensors, see `parts.draw_parts`.
    """
    rng = np.random.default_rng([seed, TIERS.index(tier), 0x494E44])
    names, shares = zip(*PROGRAMS[tier], strict=True)
    name = str(rng.choice(names, p=shares))
    motions = read_program(f"{program or name}.yaml")
    visibility = Visibility(_make_scene(draw_parts(seed, filters), motions, NO_CAUSES))
    plain = Session(seed, tier, "null", motions, _limit_filter(visibility))
    if tier == "nulls":
        return plain
    if tier == "ladder":
        times = float(rungs[int(rng.integers(len(rungs)))])
        causes = _draw_causes(plain.visibility, rng, [times])
        return _settle_moves(replace(plain, kind="one", causes=causes, rung=times))
    if tier == "many":
        count = int(rng.integers(MANY_COUNT[0], MANY_COUNT[1] + 1))
        causes = _draw_causes(plain.visibility, rng, rng.uniform(*MANY_TIMES, size=count).tolist())
        return _settle_moves(replace(plain, kind="many", causes=causes))
    effect = _draw_effect(plain.visibility, rng)
    return replace(plain, kind="nearly" if effect.entry.near else "outside", effect=effect)


def compute_low_pass_noncentrality(visibility: Visibility) -> float:
    """Return the non-centrality of the difference from the filter that the solver assumes."""
    return visibility.compute_noncentrality(visibility.scene.simulate_rates(low_pass=ASSUMED))


def _limit_filter(visibility: Visibility) -> Visibility:
    """Return the same rig with a filter whose order is visible by a small share of 1x at most.

    The visibility of a short stage is proportional to the square of its time. This function does
    not change a strong filter.
    """
    for _ in range(MAX_REFITS):
        scene = visibility.scene
        low_pass = scene.parts.low_pass
        times = np.sqrt(
            compute_low_pass_noncentrality(visibility) / compute_detectable("low_pass_lag")
        )
        if low_pass.stage is None or times <= MOST_FILTER_TIMES:
            break
        stage_s = low_pass.stage_s * float(np.sqrt(0.9 * MOST_FILTER_TIMES / times))
        parts = replace(scene.parts, low_pass=replace(low_pass, stage_s=stage_s))
        visibility = Visibility(replace(scene, parts=parts))
    return visibility


def _make_scene(parts: RigParts, program: MotionProgram, causes: HiddenCauses) -> Scene:
    """Return the session of a rig with causes; its moves have the profile without causes."""
    rng = np.random.default_rng([parts.seed, SESSION_STREAM])
    session = run_program(program, causes, parts.baud, parts.has_counter, rng)
    return Scene(parts, change_moves(session, NO_CAUSES))


def _draw_causes(
    visibility: Visibility, rng: np.random.Generator, wanted_times: Sequence[float]
) -> tuple[HiddenCause, ...]:
    """Return different causes; another cause replaces a cause that needs too large a size."""
    chosen: list[HiddenCause] = []
    for name in rng.permutation(HIDEABLE).tolist():
        if len(chosen) == len(wanted_times):
            break
        if name in COUNTED and len(wanted_times) > 1:
            continue
        times = wanted_times[len(chosen)]
        hiding = draw_hiding(name, rng)
        sized = find_cause_size(visibility, hiding, times)
        if sized is not None:
            chosen.append(HiddenCause(hiding, times, sized))
    return tuple(chosen)


def _settle_moves(session: Session) -> Session:
    """Return a session with the start times of its moves under its causes, and corrected sizes.

    A cause of the moves also changes the times of later commands. Therefore this function computes
    the non-centralities again with these times.
    """
    for _ in range(MAX_REFITS):
        scene = _make_scene(session.scene.parts, session.program, session.hidden_causes)
        if scene.moves_s == session.scene.moves_s:
            return session
        visibility = Visibility(scene)
        causes = tuple(_refit_size(visibility, cause) for cause in session.causes)
        session = replace(session, visibility=visibility, causes=causes)
    scene = _make_scene(session.scene.parts, session.program, session.hidden_causes)
    return _update_noncentralities(replace(session, visibility=Visibility(scene)))


def _refit_size(visibility: Visibility, cause: HiddenCause) -> HiddenCause:
    if cause.hiding.cause in COUNTED:
        return cause
    noncentrality = compute_cause_noncentrality(visibility, cause.hiding, cause.sized.size)
    if abs(noncentrality / cause.sized.noncentrality - 1.0) > RUNG_WIDTH:
        sized = find_cause_size(visibility, cause.hiding, cause.times)
        if sized is not None:
            return replace(cause, sized=sized)
    return replace(cause, sized=Sized(cause.sized.size, noncentrality))


def _update_noncentralities(session: Session) -> Session:
    """Return a session with the non-centralities computed for its own moves."""
    causes = []
    for cause in session.causes:
        if cause.hiding.cause not in COUNTED:
            noncentrality = compute_cause_noncentrality(
                session.visibility, cause.hiding, cause.sized.size
            )
            cause = replace(cause, sized=Sized(cause.sized.size, noncentrality))  # noqa: PLW2901
        causes.append(cause)
    return replace(session, causes=tuple(causes))


def _draw_effect(visibility: Visibility, rng: np.random.Generator) -> HiddenEffect:
    for name in rng.permutation(list(EFFECTS)).tolist():
        entry = EFFECTS[name]
        times = float(np.exp(rng.uniform(*np.log(OUTSIDE_TIMES))))
        sized = find_effect_size(visibility, entry, times)
        if sized is not None:
            return HiddenEffect(entry, times, sized)
    raise ValueError("no effect outside the catalogue can be seen in this session")


def find_statistic(name: str) -> str:
    """Return what a cause changes: the mean, the variance, or a count of samples."""
    return "count" if name in COUNTED else "variance" if name in IN_VARIANCE else "mean"
