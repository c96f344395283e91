"""Causes on the unit's side, each against angles made step by step and differentiated."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation

from gyrorig_solver.model import RecordingContext, SignalState, find_term, why_not_computable
from gyrorig_solver.model.causes.lost_steps import LostSteps, pulse_templates
from gyrorig_solver.model.drive_effects import apply_play, moving_average, replan_with_limits
from gyrorig_solver.model.replanned_moves import compound_moves, simple_moves
from gyrorig_solver.reference import MotionLimits, plan_motion
from gyrorig_solver.reference.unit.motion_profile import ProfileCommand

PathEffect = Callable[[np.ndarray, np.ndarray], np.ndarray]


def close(ours: np.ndarray, theirs: np.ndarray, share: float) -> None:
    assert np.linalg.norm(theirs) > 0.0
    assert np.linalg.norm(ours - theirs) < share * np.linalg.norm(theirs)


def made(rig: Any, pan: PathEffect | None = None, tilt: PathEffect | None = None) -> np.ndarray:
    """What is measured more if the angles are made from the commanded ones."""
    angles = [
        position if how is None else rig.table(how, name)
        for name, position, how in (("pan", rig.pan, pan), ("tilt", rig.tilt, tilt))
    ]
    return np.asarray(rig.difference(rig.sensor(*angles)))


def geared(gap: float, begin: float) -> PathEffect:
    """A pin in a slot, pushed along sample by sample."""

    def follow(time_s: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
        out, at = [], angle_rad[0] - begin * gap / 2
        for angle in angle_rad.tolist():
            if angle - at > gap / 2:
                at = angle - gap / 2
            elif at - angle > gap / 2:
                at = angle + gap / 2
            out.append(at)
        return np.array(out)

    return follow


@pytest.mark.parametrize("begin", [-1.0, 0.0, 1.0])
def test_backlash_of_pan(rig: Any, begin: float) -> None:
    ours = find_term("backlash").effect(rig.scene, np.array([0.004, 0.0, begin, 0.0]))
    close(ours, made(rig, pan=geared(0.004, begin)), 0.03)


def test_backlash_of_tilt(rig: Any) -> None:
    ours = find_term("backlash").effect(rig.scene, np.array([0.0, 0.003, 0.0, 1.0]))
    close(ours, made(rig, tilt=geared(0.003, 1.0)), 0.03)


def test_backlash_continues_from_earlier_motion(rig: Any) -> None:
    whole = rig.scene
    part = SignalState.build(
        whole.edges_s,
        whole.angle_rad,
        whole.used_instants,
        instants_per_block=2,
        intervals_per_instant=5,
        bandwidth_hz=50.0,
        gain=whole.gain,
        previous_direction=(1.0, 0.0),
    )
    term = find_term("backlash")
    ours = term.effect(part, np.array([0.004, 0.0, -1.0, 0.0]))
    assert np.allclose(ours, term.effect(whole, np.array([0.004, 0.0, 1.0, 0.0])))


def test_play_of_a_triangle() -> None:
    angle_rad = np.concatenate([np.linspace(0.0, 1.0, 11), np.linspace(0.9, 0.0, 10)])
    out = apply_play(angle_rad, 0.4, 0.0)
    assert out[10] == pytest.approx(0.8)
    assert out[13] == pytest.approx(0.8)
    assert out[-1] == pytest.approx(0.2)


# In the middle of a step of 125 us: the chain that it is compared with holds rates over one.
@pytest.mark.parametrize(
    ("axis", "at_s"), [(0, 1.9000625), (0, 11.7003125), (1, 5.9000625), (1, 17.3000625)]
)
def test_lost_steps(rig: Any, axis: int, at_s: float) -> None:
    lost = 0.0072
    sizes = np.zeros(2)
    sizes[axis] = lost

    def fallen(time_s: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
        return np.asarray(angle_rad - lost * (time_s >= at_s - 1e-9))

    term, values = find_term("lost_steps"), np.array([*sizes, at_s])
    theirs = made(rig, **{("pan", "tilt")[axis]: fallen})
    finer = rig.build(fine=25)
    close(term.effect(finer, values), theirs, 0.005)
    # What is looked for is the same signal, computed nearby only.
    close(lost * term.tangent_signals(finer, values)[axis], theirs, 0.005)
    # A sample taken while the filter begins to answer sees the grid of 1 ms.
    close(term.effect(rig.scene, values), theirs, 0.08)


def test_steps_are_lost_in_moves_only(rig: Any) -> None:
    term, scene = find_term("lost_steps"), rig.scene
    times = term.template_bank(scene)[:, 2]
    assert 100 < times.size <= 2100
    k = np.searchsorted(scene.edges_s, times) - 1
    assert np.all(scene.moving.any(axis=0)[k])
    assert not term.tangent_signals(scene, np.array([0.0, 0.0, 4.9]))[1].any()


@pytest.mark.parametrize("axis", [0, 1])
def test_steps_can_be_lost_shortly_before_the_predicted_start(rig: Any, axis: int) -> None:
    """A motor with an S-curve of 40 ms starts 20 ms before the start that a ramp would have."""
    scene = rig.scene
    start_s = float(scene.time_s[np.argmax(scene.moving[axis])])
    pulses = pulse_templates(scene)
    times_s = pulses.time_s[pulses.axis == axis]
    assert ((times_s > start_s - 0.03) & (times_s < start_s - 0.01)).any()
    assert not (times_s < start_s - 0.05).any()
    rests = np.flatnonzero(np.diff(scene.moving[axis].astype(np.int64)) < 0) + 1
    end_s = float(scene.time_s[rests[0]])
    assert not ((times_s > end_s + 0.002) & (times_s < end_s + 0.03)).any()
    early = np.array([0.0, 0.0, start_s - 0.02])
    assert find_term("lost_steps").tangent_signals(scene, early)[axis].any()


@pytest.mark.parametrize("lead", [0, 40])
def test_pulse_templates_match_the_effect(rig: Any, lead: int) -> None:
    whole = rig.scene
    scene = SignalState.build(
        whole.edges_s,
        whole.angle_rad,
        whole.used_instants[lead:],
        instants_per_block=whole.instants_per_block,
        intervals_per_instant=whole.intervals_per_instant,
        bandwidth_hz=50.0,
        gain=whole.gain,
    )
    pulses, term = pulse_templates(scene), find_term("lost_steps")
    assert np.unique(pulses.axis).size == 2
    for k in range(0, pulses.time_s.size, 401):
        axis, first = int(pulses.axis[k]), int(pulses.first_block[k])
        if axis == 0:
            exact = term.tangent_signals(scene, np.array([0.0, 0.0, pulses.time_s[k]]))[axis]
        else:
            shape = LostSteps().angle_shapes(scene, np.array([0.0, 0.0, pulses.time_s[k]]))[1][1]
            turn = scene.stage_rate_derivative(1, shape)
            turn[:, 1:] = 0.0
            exact = scene.measure_stage_rate(turn)
        ours = np.zeros_like(exact)
        ours[first : first + pulses.values.shape[1]] = pulses.values[k]
        close(ours, exact, 1e-3)


@pytest.mark.parametrize(
    ("cosine", "sine", "oval", "ahead"),
    [(0.001, 0.0, 0.0, 0.0), (-0.0004, 0.0009, 0.0, 0.0), (-0.0004, 0.0009, 0.4, -0.9)],
)
def test_eccentricity(rig: Any, cosine: float, sine: float, oval: float, ahead: float) -> None:
    share = oval * np.array([np.cos(ahead), np.sin(ahead)])
    ours = find_term("eccentricity").effect(rig.scene, np.array([cosine, sine, *share]))
    size, phase = np.hypot(cosine, sine), np.arctan2(sine, cosine)

    def eccentric(time_s: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.asarray(a + size * (np.cos(a - phase) + oval * np.cos(2 * a - phase - ahead)))

    close(ours, made(rig, pan=eccentric), 5e-3)


def test_worm(rig: Any) -> None:
    period = np.radians(20.57)
    ours = find_term("worm_error").effect(rig.scene, np.array([3e-4, 0.0, 0.0, -2e-4, period]))
    theirs = made(
        rig,
        pan=lambda t, a: a + 3e-4 * np.cos(2 * np.pi * a / period),
        tilt=lambda t, a: a - 2e-4 * np.sin(2 * np.pi * a / period),
    )
    close(ours, theirs, 5e-3)


def test_step_resolution(rig: Any) -> None:
    ours = find_term("step_resolution").effect(rig.scene, np.array([2e-3, -3e-3]))
    close(ours, made(rig, pan=lambda t, a: 1.002 * a, tilt=lambda t, a: 0.997 * a), 5e-3)


def test_gain_absorbs_the_pan_step_size(rig: Any) -> None:
    scene = rig.scene
    effect = find_term("step_resolution").jacobian(scene, np.zeros(2))[0]
    rate = scene.measure_sensor_rate(scene.rate_rad_s)
    design = np.column_stack([rate, np.ones(scene.block_count)])
    left = effect - design @ np.linalg.lstsq(design, effect, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-9 * np.linalg.norm(effect)


def test_sag(rig: Any) -> None:
    ours = find_term("tilt_sag").effect(rig.scene, np.array([2e-3, -1e-3]))
    close(ours, made(rig, tilt=lambda t, a: a + 2e-3 * np.cos(a) - 1e-3 * np.sin(a)), 5e-3)


def test_compliance(rig: Any) -> None:
    def pushed(coefficient: float) -> PathEffect:
        def bend(time_s: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
            h = time_s[1] - time_s[0]
            push = np.zeros_like(angle_rad)
            push[1:-1] = (angle_rad[2:] - 2 * angle_rad[1:-1] + angle_rad[:-2]) / h**2
            return angle_rad - coefficient * push

        return bend

    ours = find_term("base_compliance").effect(rig.build(fine=25), np.array([2e-4, 1e-4]))
    close(ours, made(rig, pan=pushed(2e-4), tilt=pushed(1e-4)), 0.02)


def test_compliance_where_speed_jumps() -> None:
    """A sample just before a jump sees nothing of it, one just after it all of it."""
    step, speed, coefficient, bandwidth_hz = 9e-4, 100.0, 5e-5, 25.0
    limits = MotionLimits(speed, 1000.0, speed)
    at_s = np.array([0.2996, 0.4004])  # 0.4 ms before and after a sample
    seen = []
    for begin_s in at_s:
        course = plan_motion(0.0, [ProfileCommand(float(begin_s), "to", 100.0, limits)])
        edges_s: np.ndarray = (np.arange(150 * 5 + 1, dtype=np.float64) - 2.5) / 500.0
        angle = np.stack([course.position_steps(edges_s) * step, np.zeros_like(edges_s)])
        scene = SignalState.build(
            edges_s,
            angle,
            np.ones(150, dtype=np.bool_),
            instants_per_block=1,
            intervals_per_instant=5,
            bandwidth_hz=bandwidth_hz,
            gain=np.eye(3),
            context=RecordingContext(rad_per_step=(step, step), motion_profiles=((0, course),)),
        )
        effect = find_term("base_compliance").effect(scene, np.array([coefficient, 0.0]))
        seen.append(effect[:, 2])
    omega = 2 * np.pi * bandwidth_hz
    b, a = signal.butter(2, omega, analog=True)
    fine = np.arange(0.0, 0.2, 1e-6)
    pulse = signal.impulse((b, a), T=fine)[1]
    double = np.gradient(pulse, fine)
    for effect, begin_s in zip(seen, at_s, strict=True):
        since = np.arange(150) / 100.0 - begin_s
        near = (since > -0.05) & (since < 0.15)
        theirs = -coefficient * speed * step * np.interp(since, fine, double, left=0.0)
        assert effect[near] == pytest.approx(theirs[near], abs=0.01 * np.abs(theirs).max())


@pytest.mark.parametrize("frequency_hz", [4.0, 12.0])
def test_ringing(rig: Any, frequency_hz: float) -> None:
    """The mode's equation stepped through time (Stormer's rule with damping)."""
    w, damping = 2 * np.pi * frequency_hz, 0.06

    def swing(time_s: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
        h = float(time_s[1] - time_s[0])
        push = np.zeros_like(angle_rad)
        push[1:-1] = -(angle_rad[2:] - 2 * angle_rad[1:-1] + angle_rad[:-2]) / h**2
        out, before, q = [], 0.0, 0.0
        for p in push.tolist():
            out.append(q)
            speed = (q - before) / h
            before, q = q, 2 * q - before + h * h * (p - 2 * damping * w * speed - w * w * q)
        return angle_rad + 0.1 * np.array(out)

    ours = find_term("ringing").effect(rig.scene, np.array([0.1, 0.0, frequency_hz, damping]))
    close(ours, made(rig, pan=swing), 0.03)


@pytest.mark.parametrize("length_s", [0.01, 0.06])
def test_s_curve(rig: Any, length_s: float) -> None:
    offsets = (np.arange(100) + 0.5) / 100 - 0.5

    def rounded(angle: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
        grid = np.arange(-0.02, 30.02, 1e-3)
        mean = np.mean([angle(grid + length_s * o) for o in offsets], axis=0)
        return lambda at: np.interp(at, grid, mean)

    ours = find_term("s_curve").effect(rig.scene, np.array([length_s, 0.0]))
    theirs = rig.difference(rig.sensor(rounded(rig.pan), rig.tilt))
    close(ours, theirs, 0.08 if length_s < 0.02 else 0.02)


def test_moving_average_keeps_straight_lines() -> None:
    edges = np.sort(np.random.default_rng(0).uniform(0.0, 10.0, 300))
    inside = (edges > 1.0) & (edges < 9.0)
    line = 3.0 - 2.0 * edges
    assert moving_average(edges, line, 0.5)[inside] == pytest.approx(line[inside], abs=1e-12)
    # A parabola rises by width^2/24 of its curvature, but for the grid's own chords.
    even = np.linspace(0.0, 10.0, 20001)
    rise = moving_average(even, even**2, 0.5) - even**2
    assert rise[4000:16000] == pytest.approx(0.25 / 12.0, rel=1e-4)


def test_moving_average_of_a_move_is_that_of_a_fine_grid() -> None:
    """Only the edges near a change of the rate are averaged; the others keep their angle."""
    edges = np.cumsum(np.random.default_rng(1).uniform(0.004, 0.006, 2000))
    fine = np.linspace(0.0, edges[-1], 400_001)
    step_s, half_s = fine[1], 0.05
    rate = np.clip((fine - 2.0) / 0.3, 0.0, 1.0) - np.clip((fine - 6.0) / 0.3, 0.0, 1.0)
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step_s)])
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (angle[1:] + angle[:-1]) * step_s)])
    inside = edges[(edges > 0.1) & (edges < edges[-1] - 0.1)]
    expected = np.interp(inside + half_s, fine, integral) - np.interp(
        inside - half_s, fine, integral
    )
    commanded = np.interp(edges, fine, angle)
    mean = moving_average(edges, commanded, 2.0 * half_s)
    assert mean[np.isin(edges, inside)] == pytest.approx(expected / (2.0 * half_s), abs=2e-7)
    assert np.mean(mean == commanded) > 0.8


def test_slip(rig: Any) -> None:
    turn, at_s = np.array([0.02, -0.01, 0.015]), 13.0
    slipped = Rotation.from_rotvec(turn)

    def rate(time_s: np.ndarray) -> np.ndarray:
        stage = rig.base()(time_s) @ np.linalg.inv(rig.gain).T
        # The board's frame is turned: what it sees is turned back.
        turned = slipped.inv().apply(stage)
        return np.asarray(np.where((time_s >= at_s)[:, None], turned, stage) @ rig.gain.T)

    close(
        find_term("board_slip").effect(rig.scene, np.array([*turn, at_s])),
        rig.difference(rate),
        5e-3,
    )


STEP = np.radians(0.0514)
TOLD = (MotionLimits(1200.0, 2400.0, 60.0), MotionLimits(500.0, 1500.0, 60.0))


def stepped(limits: MotionLimits, begin_s: float, way: float, time_s: np.ndarray) -> np.ndarray:
    """A ramp generator in small ticks: faster until it has to brake, then slower."""
    h = float(time_s[1] - time_s[0])
    at, speed, out = 0.0, 0.0, []
    for t in time_s.tolist():
        out.append(at)
        if t < begin_s or at >= way:
            continue
        speed = max(speed, limits.base_speed_steps_s)
        brake = (speed**2 - limits.base_speed_steps_s**2) / (2 * limits.acceleration_steps_s2)
        if way - at <= brake:
            speed = max(limits.base_speed_steps_s, speed - limits.acceleration_steps_s2 * h)
        else:
            speed = min(limits.speed_steps_s, speed + limits.acceleration_steps_s2 * h)
        at = min(way, at + speed * h)
    return np.array(out)


@pytest.mark.parametrize(("share", "base_steps_s"), [(0.1, 0.0), (-0.2, 0.0), (0.0, 100.0)])
def test_moves_with_other_limits(rig: Any, share: float, base_steps_s: float) -> None:
    ways = (1500.0, 120.0)  # the second never reaches its speed
    courses = tuple(
        (axis, plan_motion(0.0, [ProfileCommand(1.0 + axis, "to", ways[axis], TOLD[axis])]))
        for axis in (0, 1)
    )
    edges = np.arange(0.0, 4.0, 1e-3)
    position_rad = STEP * np.stack([course.position_steps(edges) for _, course in courses])
    scene = SignalState.build(
        edges,
        position_rad,
        np.ones(edges.size - 1, dtype=np.bool_),
        instants_per_block=1,
        intervals_per_instant=1,
        bandwidth_hz=None,
        gain=rig.gain,
        context=RecordingContext(rad_per_step=(STEP, STEP), motion_profiles=courses),
    )
    cause = "acceleration_error" if share else "base_speed_jump"
    term = find_term(cause)
    assert why_not_computable(term, [scene]) is None
    values = np.full(2, share or base_steps_s * STEP)
    ours = term.angle_error(scene, values)  # type: ignore[attr-defined]
    fine = np.arange(0.0, 4.0, 1e-5)
    for axis in (0, 1):
        base, other = TOLD[axis], TOLD[axis]
        other = MotionLimits(
            base.speed_steps_s,
            base.acceleration_steps_s2 * (1.0 + share),
            base.base_speed_steps_s + base_steps_s,
        )
        paths = [stepped(which, 1.0 + axis, ways[axis], fine) for which in (other, base)]
        theirs = STEP * np.interp(edges, fine, paths[0] - paths[1])
        close(ours[axis], theirs, 0.03)


def test_moves_with_commands_on_the_way_are_replanned() -> None:
    limits, steeper = MotionLimits(1000.0, 2000.0, 0.0), MotionLimits(1000.0, 2200.0, 30.0)
    back, expected = (
        plan_motion(
            0.0,
            [
                ProfileCommand(0.0, "to", 1000.0, move_limits),
                ProfileCommand(0.7, "to", -500.0, move_limits),
            ],
        )
        for move_limits in (limits, steeper)
    )
    replanned = replan_with_limits(back, 0.1, 30.0)
    assert replanned is not None
    time_s = np.linspace(-0.1, 4.0, 500)
    assert replanned.position_steps(time_s) == pytest.approx(expected.position_steps(time_s))


def test_moves_without_ramps_are_not_replanned() -> None:
    slow = plan_motion(0.0, [ProfileCommand(0.0, "to", 100.0, MotionLimits(50.0, 2000.0, 60.0))])
    assert replan_with_limits(slow, 0.1, 0.0) is None
    moves = simple_moves(((0, slow),), 0)
    assert not moves.position_change(np.arange(9.0), (0.1, 0.0), (0.0, 0.0)).any()
    assert not compound_moves(((0, slow),), 0)


@pytest.mark.parametrize("previous", [(0.0, 0.0), (0.05, 20.0)])
@pytest.mark.parametrize("change", [(0.3, 0.0), (-0.4, 0.0), (0.0, -100.0), (0.0, 900.0)])
@pytest.mark.parametrize("distance", [-2000.0, -30.0, 0.0, 1.0, 150.0, 4000.0])
def test_replanned_moves_match_the_planner(
    distance: float, change: tuple[float, float], previous: tuple[float, float]
) -> None:
    limits = MotionLimits(800.0, 1500.0, 60.0)
    profile = plan_motion(7.0, [ProfileCommand(1.3, "to", 7.0 + distance, limits)])
    edges = np.arange(0.0, 12.0, 0.01)
    positions = []
    for share, base in (previous, (change[0] + previous[0], change[1] + previous[1])):
        changed = MotionLimits(800.0, 1500.0 * (1.0 + share), max(0.0, 60.0 + base))
        command = ProfileCommand(1.3, "to", 7.0 + distance, changed)
        positions.append(plan_motion(7.0, [command]).position_steps(edges))
    position_change = simple_moves(((1, profile),), 1).position_change(edges, change, previous)
    assert position_change == pytest.approx(positions[1] - positions[0], abs=1e-9)


def test_motion_profiles_are_required(rig: Any) -> None:
    for cause in ("acceleration_error", "base_speed_jump"):
        assert "record the commands too" in str(why_not_computable(find_term(cause), [rig.scene]))
