"""Causes fitted together: a chain from motor to stamp, each acting on what came before."""

from typing import Any

import numpy as np
import pytest

from gyrorig_solver.estimate.cascade import (
    TermCascade,
    effect_of_removing,
    effects_in_order,
    fitted_derivatives,
    order_by_stage,
    total_effect,
)
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.model.catalogue import catalogue, find_term
from gyrorig_solver.model.signal_state import RecordingContext, SignalState
from gyrorig_solver.model.term import SIGNAL_PATH, value_indices, value_parameters
from gyrorig_solver.reference.unit.motion_profile import MotionLimits, ProfileCommand, plan_motion

Array = np.ndarray
KINDS = ("effect", "known")
SHOWN = tuple(c for c, one in catalogue().items() if one.kind in KINDS)
# Of each kind of link one whose effect hangs on what comes before.
STRONG = {
    "s_curve": [0.06, 0.03],
    "backlash": [0.004, 0.003, 1.0, -1.0],
    "board_slip": [0.01, -0.02, 0.015, 12.3],
    "scale_asymmetry": [0.004, 0.002, -0.003],
    "low_pass_lag": [-0.4],
    "saturation": [0.8],
    "clock_step": [0.02, 14.2],
}


def extension(cause: str, values: Any) -> FittedTerm:
    one = find_term(cause)
    return FittedTerm(
        one, np.array(values, dtype=np.float64), np.array(value_indices(one, role="size"))
    )


def some(cause: str, scene: Any) -> FittedTerm:
    """Typical sizes, shapes from the middle of the bank."""
    one = find_term(cause)
    bank = one.template_bank(scene)
    values = bank[len(bank) // 2].copy()
    own = value_parameters(one)
    for k in value_indices(one, role="size"):
        values[k] = np.clip(0.7 * own[k].typical_size, own[k].lower, own[k].upper)
    return extension(cause, values)


def all_strong() -> list[FittedTerm]:
    return [extension(cause, values) for cause, values in STRONG.items()]


def norm(values: Array) -> float:
    return float(np.linalg.norm(values))


def test_every_cause_has_a_stage() -> None:
    for one in catalogue().values():
        assert one.stage in SIGNAL_PATH
    # An axis' own: what it is told, how it turns, what lies in the gap, what the wheel makes.
    order = ["base_speed_jump", "s_curve", "lost_steps", "worm_error", "backlash", "eccentricity"]
    order += ["ringing", "axis_nonorthogonality", "board_slip", "scale_cubic", "bias_step"]
    order += ["low_pass_lag", "saturation", "clock_skew", "supply_hum"]
    places = [SIGNAL_PATH.index(find_term(cause).stage) for cause in order]
    assert places == sorted(set(places))


@pytest.mark.parametrize("cause", SHOWN)
def test_single_cause_has_its_own_effect(cause: str, rig: Any) -> None:
    one = some(cause, rig.scene)
    assert np.array_equal(total_effect([one], rig.scene), one.term.effect(rig.scene, one.values))
    columns = one.term.local_jacobian(rig.scene, one.values)[one.free_indices]
    assert np.array_equal(fitted_derivatives([one], rig.scene), columns)
    assert np.array_equal(
        TermCascade([], rig.scene).joint_effect(one.term, one.values),
        total_effect([one], rig.scene),
    )


@pytest.mark.parametrize("cause", SHOWN)
def test_propagated_signal_contains_the_effect(cause: str, rig: Any) -> None:
    """What a scene shows after a cause, minus what it shows before, is the cause's effect."""
    one = some(cause, rig.scene)
    if one.term.stage == "readout":
        return
    passed = one.term.propagate(rig.scene, one.values)
    zero = np.zeros(rig.scene.used_instants.size)
    shown = [scene.block_means(scene.output_at_delay(zero)[0]) for scene in (passed, rig.scene)]
    effect = one.term.effect(rig.scene, one.values)
    assert norm(shown[0] - shown[1] - effect) < 1e-3 * max(norm(effect), 1e-9)


def test_effects_add_up_in_any_order(rig: Any) -> None:
    told = all_strong()
    shares = effects_in_order(told, rig.scene)
    again = effects_in_order(told[::-1], rig.scene)[::-1]
    assert all(np.array_equal(a, b) for a, b in zip(shares, again, strict=True))
    assert np.allclose(sum(shares), total_effect(told, rig.scene), atol=1e-15)
    assert [one.term.cause for one in order_by_stage(told)] == list(STRONG)


@pytest.mark.parametrize("cause", STRONG)
def test_effect_of_removing_a_cause(cause: str, rig: Any) -> None:
    told = all_strong()
    gone = next(one for one in told if one.term.cause == cause)
    rest = [one for one in told if one is not gone]
    lost = total_effect(told, rig.scene) - total_effect(rest, rig.scene)
    assert np.allclose(effect_of_removing([gone], told, rig.scene), lost, atol=1e-12)


@pytest.mark.parametrize("cause", STRONG)
def test_joint_effect_of_a_candidate(cause: str, rig: Any) -> None:
    told = all_strong()
    one = next(one for one in told if one.term.cause == cause)
    rest = [other for other in told if other is not one]
    exact = total_effect(told, rig.scene) - total_effect(rest, rig.scene)
    found = TermCascade(rest, rig.scene).joint_effect(one.term, one.values)
    # Products of two small effects are left out: 2 % of a slip, 0.4 % of an asymmetry.
    assert norm(found - exact) < 0.03 * norm(exact)


def test_fitted_derivatives_match_the_total_effect(rig: Any) -> None:
    told = [one for one in all_strong() if one.term.cause not in ("backlash", "saturation")]
    columns = fitted_derivatives(told, rig.scene)
    row = 0
    for number, one in enumerate(told):
        for k in one.free_indices:
            step = np.zeros(one.values.size)
            step[k] = 1e-4 * value_parameters(one.term)[k].typical_size
            moved = [
                [
                    FittedTerm(o.term, o.values + sign * step, o.free_indices) if o is one else o
                    for o in told
                ]
                for sign in (1.0, -1.0)
            ]
            high, low = (total_effect(extensions, rig.scene) for extensions in moved)
            exact = (high - low) / (2.0 * step[k])
            assert norm(columns[row] - exact) < 0.03 * norm(exact), (number, k)
            row += 1


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
    told = [
        extension("backlash", [gap, 0.0, 1.0, 0.0]),
        extension("s_curve", [length_s, 0.0]),
    ]
    assert norm(total_effect(told, rig.scene) - theirs) < 0.02 * norm(theirs)
    added = sum(one.term.effect(rig.scene, one.values) for one in told)
    assert norm(added - theirs) > 0.1 * norm(theirs)


def test_clock_delay_shifts_the_backlash_pulse(rig: Any) -> None:
    gap, late_s, at_s = 0.004, 0.03, 14.2

    def play(_: Array, told: Array) -> Array:
        out, at = [], told[0] - gap / 2
        for angle in told.tolist():
            at = min(max(at, angle - gap / 2), angle + gap / 2)
            out.append(at)
        return np.array(out)

    geared = rig.sensor(rig.table(play, "pan"), rig.tilt)
    theirs = rig.measured(geared, taken_s=lambda t: t - late_s * (t > at_s)) - rig.measured_base
    told = [
        extension("clock_step", [late_s, at_s]),
        extension("backlash", [gap, 0.0, 1.0, 0.0]),
    ]
    assert norm(total_effect(told, rig.scene) - theirs) < 0.02 * norm(theirs)


def test_tilt_backlash_leaves_the_tilt_zero_uncertain() -> None:
    gap = 0.0012
    values = np.array([0.003, gap, 1.0, 1.0])
    assert find_term("backlash").tilt_zero_std_rad(values) == pytest.approx(gap / 2)
    assert find_term("backlash").tilt_zero_std_rad(np.array([0.003, 0.0, 1.0, 1.0])) == 0.0
    assert all(
        one.tilt_zero_std_rad(np.ones(len(value_parameters(one)))) == 0.0
        for cause, one in catalogue().items()
        if cause != "backlash"
    )


def test_changed_limits_combine(rig: Any) -> None:
    """Steeper ramps and a jump to the base speed: the move that has both, laid at once."""
    step, begin_s, share, base = 0.0009, 1.0, 0.2, 0.08
    # The way is short: peaks rise with both, until the told speed cuts them off.
    for speed in (1200.0, 2000.0):
        told = MotionLimits(speed, 4000.0, 60.0)
        both = MotionLimits(speed, 4000.0 * (1.0 + share), 60.0 + base / step)
        courses = [
            plan_motion(0.0, [ProfileCommand(begin_s, "to", 300.0, one)]) for one in (told, both)
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
    own = bend.term.effect(lag.term.propagate(jumping, lag.values), bend.values)
    assert np.allclose(both - late, own, atol=1e-12)
    # It is no small part of it: the pulses grow as the square of the cut-off.
    assert norm(own - bend.term.effect(jumping, bend.values)) > 0.3 * norm(own)
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


def test_samples_at_a_speed_jump_are_masked(jumping: SignalState) -> None:
    unsure = find_term("base_compliance").timing_sensitive_mask(jumping, np.array([5e-5, 0.0]))
    assert unsure is not None
    assert 1 <= unsure.sum() <= 2
    assert find_term("base_compliance").timing_sensitive_mask(jumping, np.array([0.0, 0.0])) is None
    assert find_term("s_curve").timing_sensitive_mask(jumping, np.array([0.01, 0.0])) is None
