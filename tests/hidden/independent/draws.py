"""What one seed hides: the rig, the program, and causes or an effect with their sizes.

What to use when: `drawn` for the session of a seed and a tier.
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
from tests.hidden.independent.simulation import NO_CAUSES, NO_EFFECT, Scene, with_moves_of
from tests.hidden.independent.sizing import (
    Sized,
    cause_noncentrality,
    causes_of,
    effect_of,
    size_of_cause,
    size_of_effect,
)
from tests.hidden.independent.visibility import Visibility
from tests.hidden.truth.detectable import detectable_of

from gyrorig_protocol.program import MotionProgram

TIERS = ("nulls", "ladder", "many", "outside")  # at the end: they seed
RUNGS = (1.0, 2.0, 3.0)
SHORT_PROGRAM = "survey-40"
PROGRAMS = {
    "nulls": ((SHORT_PROGRAM, 0.7), ("planned-75", 0.15), ("survey-130", 0.15)),
    "ladder": ((SHORT_PROGRAM, 0.7), ("survey-130", 0.3)),
    "many": ((SHORT_PROGRAM, 0.5), ("survey-130", 0.5)),
    "outside": ((SHORT_PROGRAM, 0.7), ("survey-130", 0.3)),
}
MANY_COUNT, MANY_TIMES, OUTSIDE_TIMES = (2, 8), (2.0, 6.0), (3.0, 8.0)
REFITS, RUNG_WIDTH = 3, 0.06  # of the non-centrality, after the session was simulated
MOST_FILTER_TIMES = 0.35  # of the minimal detectable size; more would be an effect
SESSION_STREAM = 0x5345


@dataclass(frozen=True, slots=True)
class HiddenCause:
    """A cause of the catalogue with its size."""

    hiding: Hiding
    times: float  # as wanted
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
        return causes_of(self.items)

    @property
    def hidden_effect(self) -> Effect:
        """The effect outside the catalogue."""
        if self.effect is None:
            return NO_EFFECT
        return effect_of(self.visibility, self.effect.entry, self.effect.sized.size)


def drawn(
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
    visibility = Visibility(_scene(draw_parts(seed, filters), motions, NO_CAUSES))
    plain = Session(seed, tier, "null", motions, _with_quiet_filter(visibility))
    if tier == "nulls":
        return plain
    if tier == "ladder":
        times = float(rungs[int(rng.integers(len(rungs)))])
        causes = _drawn_causes(plain.visibility, rng, [times])
        return _settled(replace(plain, kind="one", causes=causes, rung=times))
    if tier == "many":
        count = int(rng.integers(MANY_COUNT[0], MANY_COUNT[1] + 1))
        causes = _drawn_causes(plain.visibility, rng, rng.uniform(*MANY_TIMES, size=count).tolist())
        return _settled(replace(plain, kind="many", causes=causes))
    effect = _drawn_effect(plain.visibility, rng)
    return replace(plain, kind="nearly" if effect.entry.near else "outside", effect=effect)


def low_pass_noncentrality(visibility: Visibility) -> float:
    """Return how visible it is that the filter is not the one that the solver assumes."""
    return visibility.noncentrality(visibility.scene.rates(low_pass=ASSUMED))


def _with_quiet_filter(visibility: Visibility) -> Visibility:
    """Return the same rig with a filter whose order does not show beyond a share of 1x.

    What shows of a short stage goes with the square of its time. A strong filter is left alone.
    """
    for _ in range(REFITS):
        scene = visibility.scene
        low_pass = scene.parts.low_pass
        times = np.sqrt(low_pass_noncentrality(visibility) / detectable_of("low_pass_lag"))
        if low_pass.stage is None or times <= MOST_FILTER_TIMES:
            break
        stage_s = low_pass.stage_s * float(np.sqrt(0.9 * MOST_FILTER_TIMES / times))
        parts = replace(scene.parts, low_pass=replace(low_pass, stage_s=stage_s))
        visibility = Visibility(replace(scene, parts=parts))
    return visibility


def _scene(parts: RigParts, program: MotionProgram, causes: HiddenCauses) -> Scene:
    """Return the session of a rig with causes; its moves are stated as without them."""
    rng = np.random.default_rng([parts.seed, SESSION_STREAM])
    session = run_program(program, causes, parts.baud, parts.has_counter, rng)
    return Scene(parts, with_moves_of(session, NO_CAUSES))


def _drawn_causes(
    visibility: Visibility, rng: np.random.Generator, wanted_times: Sequence[float]
) -> tuple[HiddenCause, ...]:
    """Return different causes; one that needs too large a size is replaced."""
    chosen: list[HiddenCause] = []
    for name in rng.permutation(HIDEABLE).tolist():
        if len(chosen) == len(wanted_times):
            break
        if name in COUNTED and len(wanted_times) > 1:
            continue
        times = wanted_times[len(chosen)]
        hiding = draw_hiding(name, rng)
        sized = size_of_cause(visibility, hiding, times)
        if sized is not None:
            chosen.append(HiddenCause(hiding, times, sized))
    return tuple(chosen)


def _settled(session: Session) -> Session:
    """Return a session whose moves begin as its causes let them, with sizes that fit.

    A cause of the moves also changes when later commands are sent. Therefore its non-centrality is
    computed again with the session as it was.
    """
    for _ in range(REFITS):
        scene = _scene(session.scene.parts, session.program, session.hidden_causes)
        if scene.moves_s == session.scene.moves_s:
            return session
        visibility = Visibility(scene)
        causes = tuple(_refitted(visibility, cause) for cause in session.causes)
        session = replace(session, visibility=visibility, causes=causes)
    scene = _scene(session.scene.parts, session.program, session.hidden_causes)
    return _restated(replace(session, visibility=Visibility(scene)))


def _refitted(visibility: Visibility, cause: HiddenCause) -> HiddenCause:
    if cause.hiding.cause in COUNTED:
        return cause
    noncentrality = cause_noncentrality(visibility, cause.hiding, cause.sized.size)
    if abs(noncentrality / cause.sized.noncentrality - 1.0) > RUNG_WIDTH:
        sized = size_of_cause(visibility, cause.hiding, cause.times)
        if sized is not None:
            return replace(cause, sized=sized)
    return replace(cause, sized=Sized(cause.sized.size, noncentrality))


def _restated(session: Session) -> Session:
    """Return a session with the non-centralities computed for its own moves."""
    causes = []
    for cause in session.causes:
        if cause.hiding.cause not in COUNTED:
            noncentrality = cause_noncentrality(session.visibility, cause.hiding, cause.sized.size)
            cause = replace(cause, sized=Sized(cause.sized.size, noncentrality))  # noqa: PLW2901
        causes.append(cause)
    return replace(session, causes=tuple(causes))


def _drawn_effect(visibility: Visibility, rng: np.random.Generator) -> HiddenEffect:
    for name in rng.permutation(list(EFFECTS)).tolist():
        entry = EFFECTS[name]
        times = float(np.exp(rng.uniform(*np.log(OUTSIDE_TIMES))))
        sized = size_of_effect(visibility, entry, times)
        if sized is not None:
            return HiddenEffect(entry, times, sized)
    raise ValueError("no effect outside the catalogue can be seen in this session")


def statistic_of(name: str) -> str:
    """Return what a cause changes: the mean, the variance, or what is counted in the stream."""
    return "count" if name in COUNTED else "variance" if name in IN_VARIANCE else "mean"
