"""Each cause in the unit changes the angles or rates of the stage as its mechanics say."""

from typing import Any

import numpy as np
import pytest
from tests.bench.accuracy.profile import RAD_PER_STEP
from tests.bench.rigs.rig import SimulatedRig
from tests.bench.rigs.stage_motion import WORM_TURNS, play

PAN, TILT = 0, 1


def rests(rig: SimulatedRig, axis: int) -> list[int]:
    """Return grid edges in the middle of the rests before, between and after an axis' moves."""
    moves = [move for move in rig.session.moves if move.axis == axis]
    times = [-0.5, *(move.end_s + 0.4 for move in moves)]
    return [int(np.searchsorted(rig.motion.edges_s, time_s)) for time_s in times]


def added_at_rests(plain: SimulatedRig, other: SimulatedRig, axis: int) -> np.ndarray:
    """Return the angle with the cause minus the angle without it, at each rest."""
    angles = [(rig.motion.pan_rad, rig.motion.tilt_rad)[axis] for rig in (plain, other)]
    return np.asarray((angles[1] - angles[0])[rests(plain, axis)])


def angle_at_rests(rig: SimulatedRig, axis: int) -> np.ndarray:
    return (rig.motion.pan_rad, rig.motion.tilt_rad)[axis][rests(rig, axis)]


def cruise(rig: SimulatedRig, number: int) -> slice:
    """Return the cells of the steady part of a move."""
    move = rig.session.moves[number]
    middle_s = (move.start_s + move.end_s) / 2.0
    at = int(np.searchsorted(rig.motion.edges_s, middle_s))
    return slice(at - 200, at + 200)


def test_gap_loses_its_width_at_each_reversal(plain: SimulatedRig, record: Any) -> None:
    gap = 0.004
    added = added_at_rests(plain, record({"backlash": {"pan": gap, "face": 1.0}}), PAN)
    # The moves of pan: up, down, down, up; the stage is behind the motor by half a gap.
    assert np.diff(added)[1:] == pytest.approx([gap, 0.0, -gap], abs=1e-9)


def test_play_follows_only_beyond_the_gap() -> None:
    angle = np.array([0.0, 0.4, 1.0, 1.0, 0.7, -1.0, -1.0, 2.0])
    expected = [0.0, 0.0, 0.5, 0.5, 0.5, -0.5, -0.5, 1.5]
    assert play(angle, 1.0) == pytest.approx(expected)


def test_lost_steps_leave_the_stage_behind(plain: SimulatedRig, record: Any) -> None:
    other = record({"lost_steps": {"pan": 8.0, "at": 0.01}})
    added = added_at_rests(plain, other, PAN)
    assert added == pytest.approx([0.0, *([-8.0 * RAD_PER_STEP] * 4)], abs=1e-9)
    assert np.array_equal(other.tracks.counted[PAN], plain.tracks.counted[PAN])


def test_worm_and_wheel_add_sines_of_the_angle(plain: SimulatedRig, record: Any) -> None:
    at = angle_at_rests(plain, PAN)
    worm = record({"worm_error": {"pan": 0.003, "pan_phase": 0.7}})
    expected = 0.003 * np.sin(WORM_TURNS * at + 0.7)
    assert added_at_rests(plain, worm, PAN) == pytest.approx(expected, abs=1e-9)
    wheel = record({"eccentricity": {"pan": 0.003, "pan_phase": 0.7}})
    expected = 0.003 * np.sin(at + 0.7)
    assert added_at_rests(plain, wheel, PAN) == pytest.approx(expected, abs=1e-9)


def test_step_size_tilt_zero_and_sag(plain: SimulatedRig, record: Any) -> None:
    pan, tilt = angle_at_rests(plain, PAN), angle_at_rests(plain, TILT)
    steps = record({"step_resolution": {"pan": 0.01}})
    assert added_at_rests(plain, steps, PAN) == pytest.approx(0.01 * pan, abs=1e-9)
    zero = record({"tilt_zero": {"size": 0.02}})
    assert added_at_rests(plain, zero, TILT) == pytest.approx(0.02, abs=1e-9)
    sag = record({"tilt_sag": {"size": 0.02, "phase": 0.5}})
    assert added_at_rests(plain, sag, TILT) == pytest.approx(0.02 * np.sin(tilt + 0.5), abs=1e-9)


def test_skewed_axes_add_a_part_of_pan_to_the_tilt_axis(plain: SimulatedRig, record: Any) -> None:
    other = record({"axis_nonorthogonality": {"size": 0.02}})
    at = cruise(plain, 0)
    pan_rate = np.linalg.norm(plain.motion.rate_rad_s[at], axis=1)
    assert other.motion.rate_rad_s[at, 0] == pytest.approx(np.sin(0.02) * pan_rate, rel=1e-6)
    assert np.linalg.norm(other.motion.rate_rad_s[at], axis=1) == pytest.approx(pan_rate)
    assert np.all(pan_rate > 0.9)


def test_profile_of_a_move(plain: SimulatedRig, record: Any) -> None:
    move, steps = plain.session.moves[0], plain.session.ramp_steps_s2
    edges_s = plain.motion.edges_s
    ramp = slice(*np.searchsorted(edges_s, [move.start_s + 0.05, move.start_s + 0.15]))

    def slope(rig: SimulatedRig) -> float:
        rate = np.gradient(rig.tracks.counted[PAN], edges_s[: rig.tracks.counted[PAN].size])
        return float(np.mean(np.gradient(rate, edges_s[: rate.size])[ramp]))

    assert slope(plain) == pytest.approx(steps, rel=2e-3)
    steep = record({"acceleration_error": {"pan": 0.2}})
    # Longer recordings have more edges; the first move is in the same place.
    edges_s = plain.motion.edges_s if steep.motion.edges_s.size >= edges_s.size else edges_s
    assert steep.session.moves[0].acceleration_steps_s2 == pytest.approx(1.2 * steps, rel=2e-3)
    first_s = steep.session.moves[0].end_s - steep.session.moves[0].start_s
    assert first_s < move.end_s - move.start_s
    quick = record({"base_speed_jump": {"pan": 0.1}})
    jump_s = quick.session.moves[0].start_s
    after = np.interp(jump_s + np.array([0.001, 0.003]), quick.motion.edges_s, quick.motion.pan_rad)
    base_rad_s = plain.session.base_steps_s * RAD_PER_STEP + 0.1
    assert (after[1] - after[0]) / 0.002 == pytest.approx(base_rad_s, rel=0.1)


def test_rounded_ramps_last_longer_by_their_window(plain: SimulatedRig, record: Any) -> None:
    window_s = 0.1
    other = record({"s_curve": {"pan": window_s}})
    ends = []
    for rig in (plain, other):
        steps, target = rig.tracks.counted[PAN], rig.session.moves[0].end_steps
        ends.append(float(rig.motion.edges_s[np.argmax(steps > target - 1e-6)]))
    assert ends[1] - ends[0] == pytest.approx(window_s, abs=1e-3)
    at_s = other.session.moves[0].start_s + window_s / 2.0
    early = np.interp(at_s, other.motion.edges_s, other.motion.pan_rad)
    exact = np.interp(at_s, plain.motion.edges_s, plain.motion.pan_rad)
    assert 0.0 < early < 0.5 * exact


def test_elastic_base_yields_to_the_acceleration(plain: SimulatedRig, record: Any) -> None:
    compliance = 2e-4
    other = record({"base_compliance": {"pan": compliance}})
    move = plain.session.moves[0]
    at = int(np.searchsorted(plain.motion.edges_s, move.start_s + 0.1))
    added = other.motion.pan_rad[at] - plain.motion.pan_rad[at]
    acceleration = move.acceleration_steps_s2 * RAD_PER_STEP
    assert added == pytest.approx(-compliance * acceleration, rel=2e-3)


def test_resonance_rings_at_its_frequency(plain: SimulatedRig, record: Any) -> None:
    ringing = {"pan": 0.2, "frequency_hz": 12.0, "damping": 0.03}
    other = record({"ringing": ringing})
    end_s = plain.session.moves[0].end_s
    at = slice(*np.searchsorted(plain.motion.edges_s, [end_s + 0.02, end_s + 0.72]))
    wave = other.motion.pan_rad[at] - plain.motion.pan_rad[at]
    crossings = np.flatnonzero(np.diff(np.sign(wave)))
    turns = (crossings.size - 1) / 2.0
    seconds = np.diff(plain.motion.edges_s[at][crossings[[0, -1]]])[0]
    assert turns / seconds == pytest.approx(12.0, rel=0.02)
    acceleration = plain.session.moves[0].acceleration_steps_s2 * RAD_PER_STEP
    assert np.max(np.abs(wave)) < 2.5 * 0.2 * acceleration / (2.0 * np.pi * 12.0) ** 2


def test_board_slip_turns_the_rate_after_the_event(plain: SimulatedRig, record: Any) -> None:
    other = record({"board_slip": {"x": 0.03, "at": 0.5}})
    before, after = cruise(plain, 0), cruise(plain, 3)
    was, seen = plain.motion.rate_rad_s, other.motion.rate_rad_s
    assert np.array_equal(was[before], seen[before])
    cosine, sine = np.cos(0.03), np.sin(0.03)
    assert seen[after, 1] == pytest.approx(cosine * was[after, 1] + sine * was[after, 2])
    assert seen[after, 2] == pytest.approx(cosine * was[after, 2] - sine * was[after, 1])


def test_the_earth_turns_the_base(plain: SimulatedRig, record: Any) -> None:
    other = record({"earth_rotation": {"sine_latitude": 0.6, "heading": 0.0}})
    added = other.motion.rate_rad_s[:10].mean(axis=0) - plain.motion.rate_rad_s[:10].mean(axis=0)
    # At pan 0 and tilt 0, y points north.
    assert added == pytest.approx(7.292115e-5 * np.array([0.0, 0.8, 0.6]), rel=1e-3, abs=1e-8)
