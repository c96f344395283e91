"""Draw a session from one seed: kind, causes, places, signs, sizes, rig, program, soak, decoy.

What to use when: `draw_session` for a session of a tier. A `Sizer` finds the sizes. If a cause is
not visible in this rig under this program, another cause is drawn.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from tests.hidden.truth.detectable import compute_detectable
from tests.hidden.truth.outside import NEARLY, OUTSIDE, SHAPES, Shape
from tests.hidden.truth.session import Course, ExtraEffects, RigDraw, make_settings, simulate_course
from tests.hidden.truth.shapes import make_shape_adder
from tests.hidden.truth.sizing import COUNTED, Sizer, VisibleSize
from tests.support.noncentrality import Visibility

from gyrorig_daemon.emulator.emulator_settings import InjectionRequest
from gyrorig_daemon.emulator.injection import CAUSES

# The index of a tier is part of the seed.
TIERS = ("mixed", "nulls", "ladder", "outside", "many", "nearly", "held", "rig")
KINDS = ("null", "one", "two", "outside", "nearly", "unobservable")
SHARES = (0.30, 0.35, 0.15, 0.10, 0.05, 0.05)

# Program and share of sessions. Long programs are less frequent: they take ten times as long.
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
# Persistent causes of a rig: of its clocks, of the sensor, of the unit.
RIG_CAUSES = (
    "clock_skew", "scale_quadratic", "scale_asymmetry", "g_sensitivity", "motor_coupling",
    "backlash", "eccentricity", "worm_error", "axis_nonorthogonality", "acceleration_error",
    "ringing", "tilt_sag", "base_compliance",
)  # fmt: skip
# Baud rates of a unit, and the processing time of its controller in ms.
LINES = ((9600, 1.0), (9600, 20.0), (38400, 5.0), (115200, 1.0), (115200, 5.0))

# Causes that are never visible: the calibration absorbs them, or a session is too short.
UNSEEN = ("clock_offset", "tilt_zero", "earth_rotation")
# Causes that are not visible under a program that never pans while tilted.
FLAT_PROGRAM, UNSEEN_FLAT = "paper", ("axis_nonorthogonality",)
# The session of a seed depends on this order of the names. Other causes follow.
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
NOT_DRAWN = ("clock_sawtooth",)  # the sessions of the scored seeds are older than this cause
SIZED = tuple(name for name in _NAMES if name not in (*COUNTED, *UNSEEN, *NOT_DRAWN))
PAIR = ("bias_ramp", "thermal_bias", "warm_up")  # similar at a constant room temperature
EVENTS = ("bias_step", "board_slip", "clock_step", "lost_steps")
TWO_TIMES = 3.0
RUNG_WIDTH = 0.04  # of a ladder's non-centrality
_MAX_TRIES = 40


@dataclass(frozen=True, slots=True)
class Item:
    """One cause or shape to hide."""

    name: str  # of a cause, or of a shape outside the catalogue
    place: str
    size: float | None  # None: the emulator draws it
    wanted_times: float | None = None
    visibility: Visibility | None = None

    @property
    def request(self) -> InjectionRequest:
        """The request to the emulator."""
        return InjectionRequest(self.name, self.place, self.size)


@dataclass(frozen=True, slots=True)
class Session:
    """Everything that is drawn before a session."""

    tier: str
    kind: str
    rig: RigDraw
    items: tuple[Item, ...] = ()
    decoy: str | None = None
    expected_set: tuple[str, ...] = ()
    rung: float | None = None
    second_rig: RigDraw | None = None

    @property
    def extra_effects(self) -> ExtraEffects | None:
        """The function that adds a shape outside the catalogue, None without a shape."""
        item = next((item for item in self.items if item.name in SHAPES), None)
        if item is None or item.size is None:
            return None
        return make_shape_adder(SHAPES[item.name], item.size, make_settings(self.rig))


@dataclass(slots=True)
class _SessionDraw:
    """The state of the draw of a session."""

    rng: np.random.Generator
    tier: str
    rig: RigDraw

    @property
    def sizer(self) -> Sizer:
        """The sizer of this rig."""
        return make_sizer(self.rig)

    def draw_place(self, name: str) -> str:
        """Return a random axis of the unit; empty for other causes."""
        cause = CAUSES[name]
        if cause.acts_on_all or not cause.components:
            return ""
        return str(self.rng.choice(cause.components))

    def draw_sign(self, name: str) -> float:
        """Return a random sign."""
        return float(self.rng.choice((-1.0, 1.0))) if CAUSES[name].is_signed else 1.0

    def draw_cause(self, name: str, times: float) -> Item | None:
        """Return a cause of `times` minimal detectable sizes, None if this is impossible."""
        place, sign = self.draw_place(name), self.draw_sign(name)
        if name in COUNTED:
            return Item(name, place, None)
        sized = self.sizer.find_cause_size(name, place, times, sign)
        return None if sized is None else Item(name, place, sized.size, times, sized.visibility)

    def draw_near_typical(self, name: str, place: str) -> Item:
        """Return a cause near its typical size, with the spread of real parts."""
        cause = CAUSES[name]
        size = float(np.clip(cause.typical * np.exp(0.4 * self.rng.standard_normal()),
                             cause.sampled_min, cause.sampled_max))  # fmt: skip
        size = self.draw_sign(name) * (float(max(round(size), 1)) if cause.is_integer else size)
        return Item(name, place, size, None, self.sizer.make_visibility_function(name, place)(size))


def draw_session(
    seed: int, tier: str, rungs: Sequence[float] = (1.0, 2.0, 3.0), first: int = 0
) -> Session | None:
    """Return the session of a seed, a pure function of its arguments.

    Args:
        seed: the session's number.
        tier: one of `TIERS`; a session of `held` has one cause and, if possible, a second session.
        rungs: of a ladder, in minimal detectable sizes.
        first: first seed of a ladder; the causes and rungs repeat from there.

    Returns:
        None if a cause of a ladder is not visible under its programs.
    """
    rng = np.random.default_rng([seed, TIERS.index(tier), 0x5452])
    if tier == "ladder":
        return _draw_ladder(rng, seed, rungs, first)
    kind = {"nulls": "null", "mixed": "", "held": "one"}.get(tier, tier)
    kind = kind or str(rng.choice(KINDS, p=SHARES))
    programs = {"nulls": NULL_PROGRAMS, "many": MANY_PROGRAMS}.get(tier, PROGRAMS)
    program = str(rng.choice(list(programs), p=list(programs.values())))
    drawing = _SessionDraw(rng, tier, _draw_rig(rng, seed, program, soak=bool(rng.random() < 0.35)))
    return _DRAW_BY_KIND[kind](drawing)


def make_course(rig: RigDraw) -> Course:
    """Return the motion of the axes in a session."""
    return simulate_course(rig.program, rig.ptu_baud, rig.command_time_ms)


@lru_cache(maxsize=2)
def make_sizer(rig: RigDraw) -> Sizer:
    """Return the sizer of a rig."""
    return Sizer(make_settings(rig), make_course(rig))


def _draw_rig(rng: np.random.Generator, seed: int, program: str, soak: bool) -> RigDraw:
    soak_k = float(rng.choice((-1.0, 1.0)) * rng.uniform(10.0, 25.0))
    baud, command_time_ms = LINES[int(rng.integers(len(LINES)))]
    return RigDraw(seed, program, soak_k if soak else 0.0, baud, command_time_ms)


def _draw_null(drawing: _SessionDraw) -> Session:
    roll = float(drawing.rng.random())
    decoy = "temperature" if roll < 0.08 else "idle_channel" if roll < 0.12 else None
    return Session(drawing.tier, "null", drawing.rig, decoy=decoy)


def _draw_single_cause(drawing: _SessionDraw) -> Session:
    rng = drawing.rng
    if rng.random() < 0.05:
        return _draw_pair(drawing)
    for _ in range(_MAX_TRIES):
        times = float(np.exp(rng.uniform(np.log(0.7), np.log(10.0))))
        item = drawing.draw_cause(str(rng.choice([*SIZED, *COUNTED])), times)
        if item is not None:
            return Session(
                drawing.tier,
                "one",
                drawing.rig,
                (item,),
                second_rig=_draw_second_rig(drawing, item),
            )
    return _draw_null(drawing)


def _draw_pair(drawing: _SessionDraw) -> Session:
    """Return a session with one of several causes that this program cannot separate."""
    rng, rig = drawing.rng, drawing.rig
    drawing.rig = RigDraw(rig.seed, "survey-40", 0.0, rig.ptu_baud, rig.command_time_ms)
    for name in rng.permutation(PAIR).tolist():
        item = drawing.draw_cause(name, float(rng.uniform(1.3, 2.0)))
        if item is not None:
            return Session(
                drawing.tier, "one", drawing.rig, (item,), decoy="pair", expected_set=PAIR
            )
    return _draw_null(drawing)


def _draw_two(drawing: _SessionDraw) -> Session:
    items: list[Item] = []
    for name in drawing.rng.permutation(SIZED).tolist():
        item = drawing.draw_cause(name, TWO_TIMES)
        if item is not None:
            items.append(item)
        if len(items) == 2:
            break
    return Session(
        drawing.tier, "two", drawing.rig, tuple(items), second_rig=_draw_second_rig(drawing, *items)
    )


def _draw_many(drawing: _SessionDraw) -> Session:
    """Return a session with four to eight causes near their typical sizes."""
    rng = drawing.rng
    names = rng.permutation([n for n in SIZED if n not in ("bias_random_walk", "sample_jitter")])
    chosen = names[: int(rng.integers(4, 9))].tolist()
    items = tuple(drawing.draw_near_typical(name, drawing.draw_place(name)) for name in chosen)
    return Session(drawing.tier, "many", drawing.rig, items)


def _draw_whole_rig(drawing: _SessionDraw) -> Session:
    """Return a session with all persistent causes, each near its typical size."""
    rig = replace(drawing.rig, program=RIG_PROGRAM, soak_k=0.0)
    drawing.rig = rig
    items = tuple(drawing.draw_near_typical(name, drawing.draw_place(name)) for name in RIG_CAUSES)
    return Session(drawing.tier, "rig", rig, items)


def _make_shape_draw(shapes: dict[str, Shape]) -> "Callable[[_SessionDraw], Session]":
    def draw_shape(drawing: _SessionDraw) -> Session:
        rng, rig = drawing.rng, drawing.rig
        kind = "nearly" if shapes is NEARLY else "outside"
        for name in rng.permutation(list(shapes)).tolist():
            shape = shapes[name]
            if (shape.needs_soak and rig.soak_k == 0.0) or (
                rig.program == FLAT_PROGRAM and shape.needs_tilted_pan
            ):
                continue
            times = float(np.exp(rng.uniform(np.log(3.0), np.log(10.0))))
            sized = find_shape_size(drawing.sizer, shape, rig, times)
            if sized is not None:
                item = Item(name, "", sized.size, times, sized.visibility)
                return Session(drawing.tier, kind, rig, (item,))
        return _draw_null(drawing)

    return draw_shape


def find_shape_size(sizer: Sizer, shape: Shape, rig: RigDraw, times: float) -> VisibleSize | None:
    """Return the size of a shape that is `times` its minimal detectable size."""
    settings = make_settings(rig)

    def visibility_at(size: float) -> Visibility:
        return sizer.measure_visibility(extra_effects=make_shape_adder(shape, size, settings))

    return sizer.find_size(
        visibility_at, (times, compute_detectable(shape.name)), shape.start, shape.most
    )


def _draw_unobservable(drawing: _SessionDraw) -> Session:
    """Return a session with a cause that is not visible under this program."""
    rng = drawing.rng
    names = [*UNSEEN, "step_resolution"]
    if drawing.rig.program == FLAT_PROGRAM:
        names += UNSEEN_FLAT
    name = str(rng.choice(names))
    cause = CAUSES[name]
    place = "pan" if name == "step_resolution" else drawing.draw_place(name)
    size = float(np.exp(rng.uniform(np.log(cause.sampled_min), np.log(cause.sampled_max))))
    size *= drawing.draw_sign(name)
    visibility = drawing.sizer.make_visibility_function(name, place)(size)
    return Session(
        drawing.tier, "unobservable", drawing.rig, (Item(name, place, size, None, visibility),)
    )


def choose_ladder_case(number: int, rungs: int) -> tuple[str, int, bool]:
    """Return cause, rung and soak of a ladder case; the cause changes fastest, the soak slowest."""
    turn, cause = divmod(number, len(SIZED) + len(COUNTED))
    turn, rung = divmod(turn, rungs)
    return (*SIZED, *COUNTED)[cause], rung, bool(turn % 2)


def _draw_ladder(
    rng: np.random.Generator, seed: int, rungs: Sequence[float], first: int
) -> Session | None:
    name, rung, soak = choose_ladder_case(seed - first, len(rungs))
    if name in COUNTED and rung:
        return None  # the emulator draws their sizes, so they need one rung only
    for program in LADDER_PROGRAMS:
        drawing = _SessionDraw(rng, "ladder", _draw_rig(rng, seed, program, soak))
        item = drawing.draw_cause(name, float(rungs[rung]))
        if item is None and CAUSES[name].components and not CAUSES[name].acts_on_all:
            item = drawing.draw_cause(name, float(rungs[rung]))  # the place may be another one
        if item is not None:
            return Session("ladder", "one", drawing.rig, (item,), rung=float(rungs[rung]))
    return None


def _draw_second_rig(drawing: _SessionDraw, *items: Item) -> RigDraw | None:
    """Return a second session of the same rig, or None; its causes must be persistent."""
    share = 1.0 if drawing.tier == "held" else 0.1
    if drawing.rng.random() >= share or any(i.name in (*EVENTS, *COUNTED) for i in items):
        return None
    program = {
        "survey-40": "quick", "survey-130": "planned-75", "full": "survey-130",
        "planned-300": "full", "planned-75": "survey-40",
    }.get(drawing.rig.program, "survey-40")  # fmt: skip
    rig = drawing.rig
    return RigDraw(rig.seed + 500_000_000, program, 0.0, rig.ptu_baud, rig.command_time_ms)


def update_visibility(sizer: Sizer, session: Session) -> Session:
    """Return a session with the visibility of its effects under the recorded motion."""
    items = []
    for item in session.items:
        if item.size is None:
            items.append(item)
            continue
        if item.name in SHAPES:
            visibility = sizer.measure_visibility(extra_effects=session.extra_effects)
        else:
            visibility = sizer.make_visibility_function(item.name, item.place)(item.size)
        items.append(replace(item, visibility=visibility))
    return replace(session, items=tuple(items))


def correct_size(sizer: Sizer, session: Session) -> Session | None:
    """Return a session of a ladder with a size that meets its rung, None if the size meets it."""
    if session.rung is None or session.items[0].visibility is None:
        return None
    (item,) = session.items
    if item.visibility is None or item.size is None or CAUSES[item.name].is_integer:
        return None
    wanted = session.rung**2 * compute_detectable(item.name)
    if abs(item.visibility.noncentrality / wanted - 1.0) < RUNG_WIDTH:
        return None
    sign = -1.0 if item.size < 0.0 else 1.0
    sized = sizer.find_cause_size(item.name, item.place, session.rung, sign)
    return None if sized is None else replace(session, items=(replace(item, size=sized.size),))


def make_requests(items: Sequence[Item]) -> tuple[InjectionRequest, ...]:
    """Return the requests to the emulator, without shapes outside the catalogue."""
    return tuple(item.request for item in items if item.name not in SHAPES)


_DRAW_BY_KIND: dict[str, Callable[[_SessionDraw], Session]] = {
    "null": _draw_null,
    "one": _draw_single_cause,
    "two": _draw_two,
    "many": _draw_many,
    "rig": _draw_whole_rig,
    "outside": _make_shape_draw(OUTSIDE),
    "nearly": _make_shape_draw(NEARLY),
    "unobservable": _draw_unobservable,
}
