"""What one number decides: kind, causes, places, signs, sizes, rig, program, soak, decoy.

What to use when: `drawn` for a session of a tier. Sizes are found with a `Sizer` on the way,
because a cause that this rig cannot show under this program is drawn anew.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from tests.hidden.truth.detectable import detectable_of
from tests.hidden.truth.outside import NEARLY, OUTSIDE, SHAPES, Shape
from tests.hidden.truth.session import Course, More, RigDraw, course, settings_of
from tests.hidden.truth.shapes import hanger
from tests.hidden.truth.sizing import COUNTED, Sizer, VisibleSize
from tests.support.noncentrality import Visibility

from gyrorig_daemon.emulator.emulator_settings import InjectionRequest
from gyrorig_daemon.emulator.injection import CAUSES

TIERS = ("mixed", "nulls", "ladder", "outside", "many", "nearly", "held", "rig")  # order seeds
KINDS = ("null", "one", "two", "outside", "nearly", "unobservable")
SHARES = (0.30, 0.35, 0.15, 0.10, 0.05, 0.05)

# Program and share of sessions: the long ones less often, as they cost ten times as much.
PROGRAMS = {
    "survey-40": 0.46, "quick": 0.15, "planned-75": 0.11, "paper": 0.08, "survey-130": 0.08,
    "full": 0.07, "planned-300": 0.05,
}  # fmt: skip
NULL_PROGRAMS = {
    "survey-40": 0.41, "quick": 0.15, "planned-75": 0.12, "paper": 0.12, "survey-130": 0.0667,
    "full": 0.0667, "planned-300": 0.0666,
}  # fmt: skip
MANY_PROGRAMS = {"survey-130": 0.6, "full": 0.4}
LADDER_PROGRAMS = ("survey-40", "survey-130")
RIG_PROGRAM = "survey-130"
# What a rig can have at all times: of its clocks, of the sensor, of the unit.
RIG_CAUSES = (
    "clock_skew", "scale_quadratic", "scale_asymmetry", "g_sensitivity", "motor_coupling",
    "backlash", "eccentricity", "worm_error", "axis_nonorthogonality", "acceleration_error",
    "ringing", "tilt_sag", "base_compliance",
)  # fmt: skip
# Lines that a unit may be set to, and how long its controller thinks.
LINES = ((9600, 1.0), (9600, 20.0), (38400, 5.0), (115200, 1.0), (115200, 5.0))

# What a calibration absorbs whole, or a session is too short for: never to be seen.
UNSEEN = ("clock_offset", "tilt_zero", "earth_rotation")
# Also not under a program that never pans while tilted.
FLAT_PROGRAM, UNSEEN_FLAT = "paper", ("axis_nonorthogonality",)
# The order in which names are drawn: the sessions of a seed depend on it. Other causes follow.
ORDER = (
    "clock_offset", "clock_skew", "clock_step", "lost_samples", "repeated_samples",
    "sample_jitter", "corrupt_samples", "axis_swap", "sign_flip", "wrong_full_scale",
    "low_pass_lag", "scale_quadratic", "scale_cubic", "scale_asymmetry", "saturation",
    "dead_zone", "g_sensitivity", "vibration_rectification", "thermal_scale", "motor_coupling",
    "thermal_bias", "warm_up", "bias_ramp", "bias_step", "bias_random_walk", "supply_hum",
    "backlash", "lost_steps", "eccentricity", "worm_error", "axis_nonorthogonality",
    "tilt_zero", "step_resolution", "acceleration_error", "s_curve", "base_speed_jump",
    "ringing", "tilt_sag", "base_compliance", "board_slip", "earth_rotation",
)  # fmt: skip
_NAMES = (*ORDER, *sorted(CAUSES.keys() - set(ORDER)))
LATER = ("clock_sawtooth",)  # not drawn: the sessions of the scored seeds are older
SIZED = tuple(name for name in _NAMES if name not in (*COUNTED, *UNSEEN, *LATER))
PAIR = ("bias_ramp", "thermal_bias", "warm_up")  # alike where the room keeps its temperature
EVENTS = ("bias_step", "board_slip", "clock_step", "lost_steps")
TWO_TIMES = 3.0
RUNG_WIDTH = 0.04  # of a ladder's non-centrality
_TRIES = 40


@dataclass(frozen=True, slots=True)
class Item:
    """One thing to hide."""

    name: str  # of a cause, or of a shape outside the catalogue
    place: str
    size: float | None  # None: the emulator's own draw
    wanted_times: float | None = None
    seen: Visibility | None = None

    @property
    def order(self) -> InjectionRequest:
        """The same for the emulator."""
        return InjectionRequest(self.name, self.place, self.size)


@dataclass(frozen=True, slots=True)
class Session:
    """All that is decided before a session."""

    tier: str
    kind: str
    rig: RigDraw
    items: tuple[Item, ...] = ()
    decoy: str | None = None
    expected_set: tuple[str, ...] = ()
    rung: float | None = None
    held: RigDraw | None = None

    @property
    def more(self) -> More | None:
        """What hangs shapes outside the catalogue, None without any."""
        item = next((item for item in self.items if item.name in SHAPES), None)
        if item is None or item.size is None:
            return None
        return hanger(SHAPES[item.name], item.size, settings_of(self.rig))


@dataclass(slots=True)
class _Drawing:
    """A session on its way."""

    rng: np.random.Generator
    tier: str
    rig: RigDraw

    @property
    def sizer(self) -> Sizer:
        """The visibility of what may be hidden in this rig."""
        return sizer_of(self.rig)

    def place(self, name: str) -> str:
        """Return a place: an axis of the unit, else wherever it is by itself."""
        cause = CAUSES[name]
        if cause.acts_on_all or not cause.components:
            return ""
        return str(self.rng.choice(cause.components))

    def sign(self, name: str) -> float:
        """Return a direction."""
        return float(self.rng.choice((-1.0, 1.0))) if CAUSES[name].is_signed else 1.0

    def at(self, name: str, times: float) -> Item | None:
        """Return a cause of so many times its minimal size, None where that cannot be."""
        place, sign = self.place(name), self.sign(name)
        if name in COUNTED:
            return Item(name, place, None)
        sized = self.sizer.size_of_cause(name, place, times, sign)
        return None if sized is None else Item(name, place, sized.size, times, sized.seen)

    def near_typical(self, name: str, place: str) -> Item:
        """Return a cause near its typical size, as the parts scatter."""
        cause = CAUSES[name]
        size = float(np.clip(cause.typical * np.exp(0.4 * self.rng.standard_normal()),
                             cause.sampled_min, cause.sampled_max))  # fmt: skip
        size = self.sign(name) * (float(max(round(size), 1)) if cause.is_integer else size)
        return Item(name, place, size, None, self.sizer.of_cause(name, place)(size))


def drawn(
    seed: int, tier: str, rungs: Sequence[float] = (1.0, 2.0, 3.0), first: int = 0
) -> Session | None:
    """Return what a session is to be, a pure function of its arguments.

    Args:
        seed: the session's number.
        tier: one of `TIERS`; of `held`, one cause each, all that can have a second session.
        rungs: of a ladder, in minimal detectable sizes.
        first: the first seed of a ladder, whose causes and rungs go round.

    Returns:
        None where a ladder asks for what its programs cannot show.
    """
    rng = np.random.default_rng([seed, TIERS.index(tier), 0x5452])
    if tier == "ladder":
        return _ladder(rng, seed, rungs, first)
    kind = {"nulls": "null", "mixed": "", "held": "one"}.get(tier, tier)
    kind = kind or str(rng.choice(KINDS, p=SHARES))
    programs = {"nulls": NULL_PROGRAMS, "many": MANY_PROGRAMS}.get(tier, PROGRAMS)
    program = str(rng.choice(list(programs), p=list(programs.values())))
    drawing = _Drawing(rng, tier, _rig(rng, seed, program, soak=bool(rng.random() < 0.35)))
    return _OF_KIND[kind](drawing)


def course_of(rig: RigDraw) -> Course:
    """Return what the axes do in a session."""
    return course(rig.program, rig.ptu_baud, rig.command_time_ms)


@lru_cache(maxsize=2)
def sizer_of(rig: RigDraw) -> Sizer:
    """Return the visibility of what may be hidden in a rig."""
    return Sizer(settings_of(rig), course_of(rig))


def _rig(rng: np.random.Generator, seed: int, program: str, soak: bool) -> RigDraw:
    soak_k = float(rng.choice((-1.0, 1.0)) * rng.uniform(10.0, 25.0))
    baud, command_time_ms = LINES[int(rng.integers(len(LINES)))]
    return RigDraw(seed, program, soak_k if soak else 0.0, baud, command_time_ms)


def _null(drawing: _Drawing) -> Session:
    roll = float(drawing.rng.random())
    decoy = "temperature" if roll < 0.08 else "idle_channel" if roll < 0.12 else None
    return Session(drawing.tier, "null", drawing.rig, decoy=decoy)


def _single_cause(drawing: _Drawing) -> Session:
    rng = drawing.rng
    if rng.random() < 0.05:
        return _pair(drawing)
    for _ in range(_TRIES):
        times = float(np.exp(rng.uniform(np.log(0.7), np.log(10.0))))
        item = drawing.at(str(rng.choice([*SIZED, *COUNTED])), times)
        if item is not None:
            return Session(drawing.tier, "one", drawing.rig, (item,), held=_held(drawing, item))
    return _null(drawing)


def _pair(drawing: _Drawing) -> Session:
    """Causes that this program cannot part: the right answer is the set of them."""
    rng, rig = drawing.rng, drawing.rig
    drawing.rig = RigDraw(rig.seed, "survey-40", 0.0, rig.ptu_baud, rig.command_time_ms)
    for name in rng.permutation(PAIR).tolist():
        item = drawing.at(name, float(rng.uniform(1.3, 2.0)))
        if item is not None:
            return Session(
                drawing.tier, "one", drawing.rig, (item,), decoy="pair", expected_set=PAIR
            )
    return _null(drawing)


def _two(drawing: _Drawing) -> Session:
    items: list[Item] = []
    for name in drawing.rng.permutation(SIZED).tolist():
        item = drawing.at(name, TWO_TIMES)
        if item is not None:
            items.append(item)
        if len(items) == 2:
            break
    return Session(drawing.tier, "two", drawing.rig, tuple(items), held=_held(drawing, *items))


def _many(drawing: _Drawing) -> Session:
    """Four to eight causes of usual sizes: near the typical one, as the parts scatter."""
    rng = drawing.rng
    names = rng.permutation([n for n in SIZED if n not in ("bias_random_walk", "sample_jitter")])
    chosen = names[: int(rng.integers(4, 9))].tolist()
    items = tuple(drawing.near_typical(name, drawing.place(name)) for name in chosen)
    return Session(drawing.tier, "many", drawing.rig, items)


def _whole_rig(drawing: _Drawing) -> Session:
    """All persistent causes at once, each near its typical size."""
    rig = replace(drawing.rig, program=RIG_PROGRAM, soak_k=0.0)
    drawing.rig = rig
    items = tuple(drawing.near_typical(name, drawing.place(name)) for name in RIG_CAUSES)
    return Session(drawing.tier, "rig", rig, items)


def _shape(shapes: dict[str, Shape]) -> "Callable[[_Drawing], Session]":
    def of(drawing: _Drawing) -> Session:
        rng, rig = drawing.rng, drawing.rig
        kind = "nearly" if shapes is NEARLY else "outside"
        for name in rng.permutation(list(shapes)).tolist():
            shape = shapes[name]
            if (shape.needs_soak and rig.soak_k == 0.0) or (
                rig.program == FLAT_PROGRAM and shape.needs_tilted_pan
            ):
                continue
            times = float(np.exp(rng.uniform(np.log(3.0), np.log(10.0))))
            sized = shape_sized(drawing.sizer, shape, rig, times)
            if sized is not None:
                item = Item(name, "", sized.size, times, sized.seen)
                return Session(drawing.tier, kind, rig, (item,))
        return _null(drawing)

    return of


def shape_sized(sizer: Sizer, shape: Shape, rig: RigDraw, times: float) -> VisibleSize | None:
    """Return the size at which a shape is so many times its minimal detectable size."""
    settings = settings_of(rig)

    def seen(size: float) -> Visibility:
        return sizer.visibility(more=hanger(shape, size, settings))

    return sizer.sized(seen, (times, detectable_of(shape.name)), shape.start, shape.most)


def _unobservable(drawing: _Drawing) -> Session:
    """A cause of a usual size that no session of this program can show."""
    rng = drawing.rng
    names = [*UNSEEN, "step_resolution"]
    if drawing.rig.program == FLAT_PROGRAM:
        names += UNSEEN_FLAT
    name = str(rng.choice(names))
    cause = CAUSES[name]
    place = "pan" if name == "step_resolution" else drawing.place(name)
    size = float(np.exp(rng.uniform(np.log(cause.sampled_min), np.log(cause.sampled_max))))
    size *= drawing.sign(name)
    seen = drawing.sizer.of_cause(name, place)(size)
    return Session(
        drawing.tier, "unobservable", drawing.rig, (Item(name, place, size, None, seen),)
    )


def ladder_turn(number: int, rungs: int) -> tuple[str, int, bool]:
    """Return cause, rung and whether with soak: all causes, then the next rung, then soak."""
    turn, cause = divmod(number, len(SIZED) + len(COUNTED))
    turn, rung = divmod(turn, rungs)
    return (*SIZED, *COUNTED)[cause], rung, bool(turn % 2)


def _ladder(
    rng: np.random.Generator, seed: int, rungs: Sequence[float], first: int
) -> Session | None:
    name, rung, soak = ladder_turn(seed - first, len(rungs))
    if name in COUNTED and rung:
        return None  # their sizes are the emulator's own: once is enough
    for program in LADDER_PROGRAMS:
        drawing = _Drawing(rng, "ladder", _rig(rng, seed, program, soak))
        item = drawing.at(name, float(rungs[rung]))
        if item is None and CAUSES[name].components and not CAUSES[name].acts_on_all:
            item = drawing.at(name, float(rungs[rung]))  # another place, maybe
        if item is not None:
            return Session("ladder", "one", drawing.rig, (item,), rung=float(rungs[rung]))
    return None


def _held(drawing: _Drawing, *items: Item) -> RigDraw | None:
    """Return a second session of the same rig, for one in ten (or all) where all causes stay."""
    share = 1.0 if drawing.tier == "held" else 0.1
    if drawing.rng.random() >= share or any(i.name in (*EVENTS, *COUNTED) for i in items):
        return None
    program = {
        "survey-40": "quick", "survey-130": "planned-75", "full": "survey-130",
        "planned-300": "full", "planned-75": "survey-40",
    }.get(drawing.rig.program, "survey-40")  # fmt: skip
    rig = drawing.rig
    return RigDraw(rig.seed + 500_000_000, program, 0.0, rig.ptu_baud, rig.command_time_ms)


def seen_by(sizer: Sizer, session: Session) -> Session:
    """Return a session whose effects are as visible as under the motion that it really had."""
    items = []
    for item in session.items:
        if item.size is None:
            items.append(item)
            continue
        if item.name in SHAPES:
            seen = sizer.visibility(more=session.more)
        else:
            seen = sizer.of_cause(item.name, item.place)(item.size)
        items.append(replace(item, seen=seen))
    return replace(session, items=tuple(items))


def on_rung(sizer: Sizer, session: Session) -> Session | None:
    """Return a ladder's session with a size that meets its rung, None where it does already."""
    if session.rung is None or session.items[0].seen is None:
        return None
    (item,) = session.items
    if item.seen is None or item.size is None or CAUSES[item.name].is_integer:
        return None
    wanted = session.rung**2 * detectable_of(item.name)
    if abs(item.seen.noncentrality / wanted - 1.0) < RUNG_WIDTH:
        return None
    sign = -1.0 if item.size < 0.0 else 1.0
    sized = sizer.size_of_cause(item.name, item.place, session.rung, sign)
    return None if sized is None else replace(session, items=(replace(item, size=sized.size),))


def orders_of(items: Sequence[Item]) -> tuple[InjectionRequest, ...]:
    """Return what the emulator has to hide, without shapes outside the catalogue."""
    return tuple(item.order for item in items if item.name not in SHAPES)


_OF_KIND: dict[str, Callable[[_Drawing], Session]] = {
    "null": _null,
    "one": _single_cause,
    "two": _two,
    "many": _many,
    "rig": _whole_rig,
    "outside": _shape(OUTSIDE),
    "nearly": _shape(NEARLY),
    "unobservable": _unobservable,
}
