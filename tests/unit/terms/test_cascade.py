"""Causes fitted together: a chain from motor to stamp, each acting on what came before."""

from typing import Any

import numpy as np
import pytest

from gyrorig_solver.estimate import FittedTerm, total_effect
from gyrorig_solver.estimate.cascade import (
    TermCascade,
    effect_and_mask,
    effect_of_removing,
    effects_in_order,
    fitted_derivatives,
    order_by_stage,
)
from gyrorig_solver.model import (
    RecordingContext,
    SignalState,
    find_term,
    value_indices,
    value_parameters,
)
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.model.cause_categories import SIGNAL_PATH
from gyrorig_solver.model.speed_jumps import find_speed_jumps
from gyrorig_solver.reference import MotionLimits, plan_motion
from gyrorig_solver.reference.unit.motion_profile import ProfileCommand

Array = np.ndarray
KINDS = ("effect", "known")
SHOWN = tuple(c for c, term in catalogue().items() if term.kind in KINDS)
# Of each kind of link one whose effect hangs on what comes before.
STRONG = {
    "s_curve": [0.06, 0.03],
    "backlash": [0.004, 0.003, 1.0, -1.0],
    "board_slip": [0.01, -0.02, 0.015, 12.3],
    "scale_asymmetry": [0.004, 0.002, -0.003],
    "low_pass_lag": [-0.4],
    "saturation": [0.8],
    "clock_sawtooth": [1e-3, 8.0, 14.2],
    "clock_step": [0.02, 14.2],
}


def extension(cause: str, values: Any) -> FittedTerm:
    term = find_term(cause)
    return FittedTerm(
        term, np.array(values, dtype=np.float64), np.array(value_indices(term, role="size"))
    )


def strong_term(cause: str, scene: Any) -> FittedTerm:
    """Typical sizes, shapes from the middle of the bank."""
    term = find_term(cause)
    bank = term.template_bank(scene)
    values = bank[len(bank) // 2].copy()
    parameters = value_parameters(term)
    for k in value_indices(term, role="size"):
        values[k] = np.clip(
            0.7 * parameters[k].typical_size, parameters[k].lower, parameters[k].upper
        )
    return extension(cause, values)


def all_strong() -> list[FittedTerm]:
    return [extension(cause, values) for cause, values in STRONG.items()]


def norm(values: Array) -> float:
    return float(np.linalg.norm(values))


def test_every_cause_has_a_stage() -> None:
    for term in catalogue().values():
        assert term.stage in SIGNAL_PATH
    # An axis' own: what it is told, how it turns, what lies in the gap, what the wheel makes.
    order = ["base_speed_jump", "s_curve", "lost_steps", "worm_error", "backlash", "eccentricity"]
    order += ["ringing", "axis_nonorthogonality", "board_slip", "scale_cubic", "bias_step"]
    order += ["low_pass_lag", "saturation", "clock_skew", "supply_hum"]
    places = [SIGNAL_PATH.index(find_term(cause).stage) for cause in order]
    assert places == sorted(set(places))


@pytest.mark.parametrize("cause", SHOWN)
def test_single_cause_has_its_own_effect(cause: str, rig: Any) -> None:
    strong = strong_term(cause, rig.scene)
    assert np.array_equal(
        total_effect([strong], rig.scene), strong.term.effect(rig.scene, strong.values)
    )
    columns = strong.term.local_jacobian(rig.scene, strong.values)[strong.free_indices]
    assert np.array_equal(fitted_derivatives([strong], rig.scene), columns)
    assert np.array_equal(
        TermCascade([], rig.scene).joint_effect(strong.term, strong.values),
        total_effect([strong], rig.scene),
    )


@pytest.mark.parametrize("cause", SHOWN)
def test_propagated_signal_contains_the_effect(cause: str, rig: Any) -> None:
    """What a scene shows after a cause, minus what it shows before, is the cause's effect.

    A scene has no part of an effect that its grid cannot represent.
    """
    strong = strong_term(cause, rig.scene)
    if strong.term.stage == "readout":
        return
    passed = strong.term.propagate(rig.scene, strong.values)
    zero = np.zeros(rig.scene.used_instants.size)
    shown = [
        scene.block_means(scene.sampled_output.at_delay(zero)) for scene in (passed, rig.scene)
    ]
    effect = strong.term.effect(rig.scene, strong.values)
    off_grid = strong.term.off_grid_effect(rig.scene, strong.values)
    on_grid = effect if off_grid is None else effect - off_grid
    assert norm(shown[0] - shown[1] - on_grid) < 1e-3 * max(norm(effect), 1e-9)


def test_effects_add_up_in_any_order(rig: Any) -> None:
    strong_terms = all_strong()
    shares = effects_in_order(strong_terms, rig.scene)
    again = effects_in_order(strong_terms[::-1], rig.scene)[::-1]
    assert all(np.array_equal(a, b) for a, b in zip(shares, again, strict=True))
    assert np.allclose(sum(shares), total_effect(strong_terms, rig.scene), atol=1e-15)
    assert [fitted_term.term.cause for fitted_term in order_by_stage(strong_terms)] == list(STRONG)


@pytest.mark.parametrize("cause", STRONG)
def test_effect_of_removing_a_cause(cause: str, rig: Any) -> None:
    strong_terms = all_strong()
    gone = next(fitted_term for fitted_term in strong_terms if fitted_term.term.cause == cause)
    rest = [fitted_term for fitted_term in strong_terms if fitted_term is not gone]
    lost = total_effect(strong_terms, rig.scene) - total_effect(rest, rig.scene)
    assert np.allclose(effect_of_removing([gone], strong_terms, rig.scene), lost, atol=1e-12)


@pytest.mark.parametrize("cause", STRONG)
def test_joint_effect_of_a_candidate(cause: str, rig: Any) -> None:
    strong_terms = all_strong()
    candidate = next(fitted_term for fitted_term in strong_terms if fitted_term.term.cause == cause)
    rest = [other for other in strong_terms if other is not candidate]
    exact = total_effect(strong_terms, rig.scene) - total_effect(rest, rig.scene)
    effect = TermCascade(rest, rig.scene).joint_effect(candidate.term, candidate.values)
    # Products of two small effects are left out: 2 % of a slip, 0.4 % of an asymmetry.
    assert norm(effect - exact) < 0.03 * norm(exact)


def test_fitted_derivatives_match_the_total_effect(rig: Any) -> None:
    strong_terms = [
        fitted_term
        for fitted_term in all_strong()
        if fitted_term.term.cause not in ("backlash", "saturation")
    ]
    columns = fitted_derivatives(strong_terms, rig.scene)
    row = 0
    for number, fitted_term in enumerate(strong_terms):
        for k in fitted_term.free_indices:
            step = np.zeros(fitted_term.values.size)
            step[k] = 1e-4 * value_parameters(fitted_term.term)[k].typical_size
            moved = [
                [
                    FittedTerm(o.term, o.values + sign * step, o.free_indices)
                    if o is fitted_term
                    else o
                    for o in strong_terms
                ]
                for sign in (1.0, -1.0)
            ]
            high, low = (total_effect(extensions, rig.scene) for extensions in moved)
            exact = (high - low) / (2.0 * step[k])
            assert norm(columns[row] - exact) < 0.03 * norm(exact), (number, k)
            row += 1


@pytest.mark.long
def test_backlash_acts_on_the_rounded_motion(rig: Any) -> None:
    """Rounded ramps, then a gap: against angles made step by step."""
    length_s, gap = 0.06, 0.004
    offsets = (np.arange(60) + 0.5) / 60 - 0.5

    def both(time_s: Array, _: Array) -> Array:
        rounded = np.mean([rig.pan(time_s + length_s * o) for o in offsets], axis=0)
        out, at = [], rounded[0] - gap / 2
        for angle in rounded.tolist():
            at = min(max(at, angle - gap / 2), angle + gap / 2)
            out.append(at)
        return np.array(out)

    theirs = rig.difference(rig.sensor(rig.table(both, "pan"), rig.tilt))
    fitted_terms = [
        extension("backlash", [gap, 0.0, 1.0, 0.0]),
        extension("s_curve", [length_s, 0.0]),
    ]
    assert norm(total_effect(fitted_terms, rig.scene) - theirs) < 0.02 * norm(theirs)
    added = sum(
        fitted_term.term.effect(rig.scene, fitted_term.values) for fitted_term in fitted_terms
    )
    assert norm(added - theirs) > 0.1 * norm(theirs)


def test_clock_delay_shifts_the_backlash_pulse(rig: Any) -> None:
    gap, late_s, at_s = 0.004, 0.03, 14.2

    def play(_: Array, angle_rad: Array) -> Array:
        out, at = [], angle_rad[0] - gap / 2
        for angle in angle_rad.tolist():
            at = min(max(at, angle - gap / 2), angle + gap / 2)
            out.append(at)
        return np.array(out)

    geared = rig.sensor(rig.table(play, "pan"), rig.tilt)
    theirs = rig.measured(geared, taken_s=lambda t: t - late_s * (t > at_s)) - rig.measured_base
    fitted_terms = [
        extension("clock_step", [late_s, at_s]),
        extension("backlash", [gap, 0.0, 1.0, 0.0]),
    ]
    assert norm(total_effect(fitted_terms, rig.scene) - theirs) < 0.02 * norm(theirs)


def test_tilt_backlash_leaves_the_tilt_zero_uncertain() -> None:
    gap = 0.0012
    values = np.array([0.003, gap, 1.0, 1.0])
    assert find_term("backlash").tilt_zero_std_rad(values) == pytest.approx(gap / 2)
    assert find_term("backlash").tilt_zero_std_rad(np.array([0.003, 0.0, 1.0, 1.0])) == 0.0
    assert all(
        term.tilt_zero_std_rad(np.ones(len(value_parameters(term)))) == 0.0
        for cause, term in catalogue().items()
        if cause != "backlash"
    )


def test_changed_limits_combine(rig: Any) -> None:
    """Steeper ramps and a jump to the base speed: the move that has both, laid at once."""
    step, begin_s, share, base = 0.0009, 1.0, 0.2, 0.08
    # The way is short: peaks rise with both, until the told speed cuts them off.
    for speed in (1200.0, 2000.0):
        limits = MotionLimits(speed, 4000.0, 60.0)
        both = MotionLimits(speed, 4000.0 * (1.0 + share), 60.0 + base / step)
        courses = [
            plan_motion(0.0, [ProfileCommand(begin_s, "to", 300.0, motion_limits)])
            for motion_limits in (limits, both)
        ]
        edges = np.arange(0.0, 3.0, 1e-3)
        angles = [step * course.position_steps(edges) for course in courses]
        scene = SignalState.build(
            edges,
            np.stack([angles[0], np.zeros_like(edges)]),
            np.ones(edges.size - 1, dtype=np.bool_),
            instants_per_block=1,
            intervals_per_instant=1,
            bandwidth_hz=None,
            gain=rig.gain,
            context=RecordingContext(rad_per_step=(step, step), motion_profiles=((0, courses[0]),)),
        )
        chain = [
            extension("base_speed_jump", [base, 0.0]),
            extension("acceleration_error", [share, 0.0]),
        ]
        change = np.stack([angles[1] - angles[0], np.zeros_like(edges)])
        exact = scene.measure_stage_rate(scene.stage_rate_change(change))
        assert norm(exact) > 0.0
        assert norm(total_effect(chain, scene) - exact) < 1e-9 * norm(exact)


@pytest.fixture
def jumping() -> SignalState:
    """A move that starts and stops at its base speed, on a grid of 2 ms."""
    step, speed = 9e-4, 100.0
    course = plan_motion(
        0.0, [ProfileCommand(0.2998, "to", 100.0, MotionLimits(speed, 1000.0, speed))]
    )
    edges_s: Array = (np.arange(150 * 5 + 1, dtype=np.float64) - 2.5) / 500.0
    angle = np.stack([course.position_steps(edges_s) * step, np.zeros_like(edges_s)])
    return SignalState.build(
        edges_s, angle, np.ones(150, dtype=np.bool_), instants_per_block=1, intervals_per_instant=5,
        bandwidth_hz=25.0, gain=np.eye(3),
        context=RecordingContext(rad_per_step=(step, step), motion_profiles=((0, course),)),
    )  # fmt: skip


def test_off_grid_effect_passes_the_actual_filter(jumping: SignalState) -> None:
    bend = extension("base_compliance", [5e-5, 0.0])
    lag = extension("low_pass_lag", [-0.3])
    both, late = total_effect([bend, lag], jumping), total_effect([lag], jumping)
    effect = bend.term.effect(lag.term.propagate(jumping, lag.values), bend.values)
    assert np.allclose(both - late, effect, atol=1e-12)
    # It is no small part of it: the pulses grow as the square of the cut-off.
    assert norm(effect - bend.term.effect(jumping, bend.values)) > 0.3 * norm(effect)
    exact = both - total_effect([bend], jumping)
    assert norm(
        TermCascade([bend], jumping).joint_effect(lag.term, lag.values) - exact
    ) < 0.02 * norm(exact)
    assert np.allclose(effect_of_removing([lag], [bend, lag], jumping), exact, atol=1e-12)


def test_filter_derivative_includes_the_off_grid_effect(jumping: SignalState) -> None:
    bend = extension("base_compliance", [5e-5, 0.0])
    lag = extension("low_pass_lag", [-0.3])
    step = 1e-3
    more, less = (
        total_effect([bend, extension("low_pass_lag", [-0.3 + by])], jumping)
        for by in (step, -step)
    )
    slope = fitted_derivatives([bend, lag], jumping)[2]
    assert norm(slope - (more - less) / (2.0 * step)) < 0.02 * norm(slope)


GAPS = (3e-4, 1.1e-3, 4.05e-3)  # crossed within an interval of the grid, and after many


def moving_behind_gap(gap_rad: float) -> FittedTerm:
    """Backlash of pan; the stage lies against the other face as the move begins."""
    return extension("backlash", [gap_rad, 0.0, -1.0, 0.0])


def accelerating(points_per_s: int) -> SignalState:
    """A move with a base speed and a ramp, on a grid of some density."""
    step = 9e-4
    limits = MotionLimits(400.0, 800.0, 60.0)
    course = plan_motion(0.0, [ProfileCommand(0.2998, "to", 300.0, limits)])
    fine = points_per_s // 100
    edges_s: Array = (np.arange(200 * fine + 1, dtype=np.float64) - 0.5 * fine) / points_per_s
    angle = np.stack([course.position_steps(edges_s) * step, np.zeros_like(edges_s)])
    return SignalState.build(
        edges_s, angle, np.ones(200, dtype=np.bool_), instants_per_block=1,
        intervals_per_instant=fine, bandwidth_hz=25.0, gain=np.eye(3),
        context=RecordingContext(rad_per_step=(step, step), motion_profiles=((0, course),)),
    )  # fmt: skip


@pytest.mark.parametrize("gap_rad", GAPS)
def test_a_stage_behind_a_gap_starts_at_the_speed_of_the_motor(gap_rad: float) -> None:
    coarse = accelerating(500)
    play = moving_behind_gap(gap_rad)
    jumps = find_speed_jumps(play.term.propagate(coarse, play.values), 0)
    distance = gap_rad / 9e-4  # steps; the time is the root of 60 t + 400 t^2 = distance
    time_s = 0.2998 + (np.sqrt(60.0**2 + 1600.0 * distance) - 60.0) / 800.0
    assert jumps.time_s[0] == pytest.approx(time_s, abs=2e-5)
    assert jumps.size_rad_s[0] == pytest.approx(9e-4 * (60.0 + 800.0 * (time_s - 0.2998)), rel=1e-3)
    assert jumps.time_s.size == 2  # and the stop


def test_an_angle_error_is_no_gap() -> None:
    state, uneven = accelerating(500), extension("eccentricity", [0, 0, 0.02, 0, 0, 0, 0, 0])
    jumps = find_speed_jumps(uneven.term.propagate(state, uneven.values), 0)
    assert jumps.time_s == pytest.approx(find_speed_jumps(state, 0).time_s, abs=5e-5)


@pytest.mark.long
@pytest.mark.parametrize("gap_rad", GAPS)
def test_a_coarse_grid_shows_the_twist_of_the_base_behind_a_gap(gap_rad: float) -> None:
    terms = [moving_behind_gap(gap_rad), extension("base_compliance", [5e-5, 0.0])]
    coarse, fine = (effects_in_order(terms, accelerating(rate))[1] for rate in (500, 100_000))
    assert np.abs(coarse - fine).max() < 0.03 * np.abs(fine).max()


@pytest.mark.parametrize(
    "later", [("base_compliance", [5e-5, 0.0]), ("ringing", [0.05, 0, 9, 0.05])]
)
def test_the_derivative_by_a_gap_includes_what_it_moves(later: tuple[str, list[float]]) -> None:
    state, step = accelerating(500), 2e-5
    play, excited = moving_behind_gap(1.1e-3), extension(*later)
    more, less = (
        total_effect([moving_behind_gap(1.1e-3 + by), excited], state) for by in (step, -step)
    )
    slope = fitted_derivatives([play, excited], state)[0]
    wanted = (more - less) / (2.0 * step)
    assert norm(slope - wanted) < 0.02 * norm(wanted)
    assert norm(fitted_derivatives([play], state)[0] - wanted) > 0.05 * norm(wanted)


@pytest.mark.parametrize(("gap_rad", "is_masked"), [(1.238e-3, True), (1.1e-3, False)])
def test_a_sample_is_masked_where_the_gap_has_been_crossed(gap_rad: float, is_masked: bool) -> None:
    state, bend = accelerating(500), extension("base_compliance", [5e-5, 0.0])
    play = moving_behind_gap(gap_rad)
    jumps = find_speed_jumps(play.term.propagate(state, play.values), 0)
    assert (abs(jumps.time_s[0] - 0.32) < jumps.time_error_s[0]) == is_masked
    _, mask = effect_and_mask([play, bend], state)
    assert (mask is not None and bool(mask[32])) == is_masked
    at_start = effect_and_mask([bend], state)[1]
    assert at_start is not None
    assert at_start[[30, 32]].tolist() == [True, False]  # without the gap


def test_samples_at_a_speed_jump_are_masked(jumping: SignalState) -> None:
    unsure = find_term("base_compliance").timing_sensitive_mask(jumping, np.array([5e-5, 0.0]))
    assert unsure is not None
    assert 1 <= unsure.sum() <= 2
    assert find_term("base_compliance").timing_sensitive_mask(jumping, np.array([0.0, 0.0])) is None
    assert find_term("s_curve").timing_sensitive_mask(jumping, np.array([0.01, 0.0])) is None
