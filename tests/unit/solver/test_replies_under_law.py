"""Position replies under another motion law: derivatives against numeric differences."""

from dataclasses import replace

import numpy as np
import pytest

from gyrorig_solver.reference import LAW_VALUES, LawProfile, MotionLaw
from gyrorig_solver.reference.unit.axis_trajectory import build_trajectories
from gyrorig_solver.reference.unit.law_fit import LawFits
from gyrorig_solver.reference.unit.move_fit import MoveFit, UnitPolls, fit_moves
from gyrorig_solver.reference.unit.move_table import MoveTable
from gyrorig_solver.reference.unit.profile_derivatives import differentiate_move
from gyrorig_solver.reference.unit.recorded_orders import UnitExchange, translate_exchanges
from gyrorig_solver.reference.unit.rounded_trajectory import (
    RoundedTrajectory,
    build_executed_trajectories,
)
from gyrorig_solver.reference.unit.trapezoidal_moves import TrapezoidalMoves
from gyrorig_solver.reference.unit.unit_moves import MotionReader, UnitMotion

SETTINGS = {
    f"{axis}_{kind}": value
    for axis in ("pan", "tilt")
    for kind, value in (("acceleration", 3000.0), ("base_speed", 40.0), ("speed", 900.0))
}
COMMANDS = (
    (1.0, "PP900"), (1.5, "TP-300"), (4.0, "PS1500"), (4.1, "PP-800"), (6.0, "TS400"),
    (6.1, "TP200"), (8.0, "PP700"), (8.3, "PP-100"), (11.0, "PP1200"), (11.2, "TP-350"),
    (14.0, "PP0"), (14.5, "TP0"),
)  # fmt: skip
POLL_HZ = 200.0
DELAY_S = 0.012  # of every command
# Pan and tilt of acceleration, base speed (steps/s) and corners.
TRUTH = MotionLaw((0.03, -0.02), (25.0, 60.0), (0.02, 0.04))
STEPS = np.array([1e-5, 1e-5, 1e-3, 1e-3, 1e-6, 1e-6])


def commanded() -> UnitMotion:
    exchanges = [UnitExchange(at_s, at_s + 0.01, True, text) for at_s, text in COMMANDS]
    return MotionReader(SETTINGS, (0, 0)).read(translate_exchanges(exchanges))


def executed_polls(motion: UnitMotion, law: MotionLaw) -> UnitPolls:
    """Return the counts of a unit that executes a law, rounded to steps."""
    table = MoveTable.of(motion)
    recorded = table.commanded_parameters
    parameters = replace(recorded, start_times_s=recorded.start_times_s + DELAY_S)
    time_s = np.arange(0.0, 18.0, 1.0 / POLL_HZ)
    trajectories = build_executed_trajectories(table.with_law(law), parameters, law)
    steps = np.column_stack([np.round(track.sample(time_s).steps) for track in trajectories])
    return UnitPolls(time_s, time_s + 1e-4, steps, np.ones(steps.shape, dtype=np.bool_))


@pytest.fixture(scope="module")
def fitted() -> MoveFit:
    motion = commanded()
    return fit_moves(motion, executed_polls(motion, TRUTH))


def changed(law: MotionLaw, change: np.ndarray) -> MotionLaw:
    values = np.array([*law.acceleration_share, *law.base_speed_steps_s, *law.corner_s]) + change
    return MotionLaw.of_values(values, law.has_known_acceleration, (1.0, 1.0))


@pytest.mark.parametrize("distance", [30.0, 200.0, 2000.0])
def test_the_derivative_by_base_speed_is_the_difference(distance: float) -> None:
    def moves(base: float) -> TrapezoidalMoves:
        return TrapezoidalMoves.of(*(np.array([x]) for x in (distance, 900.0, 3000.0, base)))

    def position(move: TrapezoidalMoves, polynomial: np.ndarray, time_s: np.ndarray) -> np.ndarray:
        segment = np.searchsorted(move.segment_start_s[:, 0], time_s, side="right") - 1
        since = time_s - move.segment_start_s[segment, 0]
        constant, linear, square = polynomial[:, segment, 0]
        return np.asarray(constant + (linear + square * since) * since)

    now, before, after = moves(60.0), moves(60.0 - 1e-4), moves(60.0 + 1e-4)
    time_s = np.linspace(0.0, float(now.end_s[0]), 400)
    corners = np.abs(time_s[:, None] - now.segment_start_s[:, 0]).min(axis=1) < 1e-5
    numeric = position(after, after.position, time_s) - position(before, before.position, time_s)
    closed = position(now, now.by_base_speed, time_s)
    assert closed[~corners] == pytest.approx(numeric[~corners] / 2e-4, abs=1e-5)


def test_a_move_with_commands_on_the_way_has_a_derivative_by_base_speed() -> None:
    motion = commanded()
    move = next(move for move in motion.moves if len(move.commands) > 1)
    time_s = np.linspace(7.0, 11.0, 300)
    starts_s, log_speed = move.start_times_s, np.zeros(motion.speed_class_count)
    after, before = (
        replace(move, base_speed_steps_s=base).profile(starts_s, log_speed, 0.0)
        for base in (41.0, 39.0)
    )
    numeric = (after.position_steps(time_s) - before.position_steps(time_s)) / 2.0
    analytic = differentiate_move(move, starts_s, log_speed, 0.0, time_s).base_speed
    corners_s = np.concatenate([after.start_s, before.start_s])
    smooth = np.abs(time_s[:, None] - corners_s).min(axis=1) > 5e-3
    assert analytic[smooth] == pytest.approx(numeric[smooth], abs=2e-3)


def test_rounded_corners_are_the_mean_of_the_position() -> None:
    table = MoveTable.of(commanded())
    parameters = replace(
        table.commanded_parameters, rest_offset_steps=np.linspace(-0.5, 0.5, table.rest_count)
    )
    length_s, step_s = 0.05, 1e-6
    time_s = np.linspace(0.5, 17.0, 2000)
    inside_s = (np.arange(400) + 0.5) / 400.0 * length_s - length_s / 2.0
    for planned in build_trajectories(table, parameters):
        rounded = RoundedTrajectory.of(planned, length_s).sample(time_s)
        every_s = time_s[:, None] + inside_s
        mean = planned.sample(every_s.ravel()).steps.reshape(every_s.shape).mean(axis=1)
        assert rounded.steps == pytest.approx(mean, abs=2e-3)
        ends = (
            RoundedTrajectory.of(planned, length_s + sign * step_s).sample(time_s).steps
            for sign in (1.0, -1.0)
        )
        by_corner = (next(ends) - next(ends)) / (2.0 * step_s)
        assert rounded.by_corner == pytest.approx(by_corner, abs=1e-2)
        later = RoundedTrajectory.of(planned, length_s).sample(time_s + 1e-5).steps
        assert rounded.speed_steps_s == pytest.approx((later - rounded.steps) / 1e-5, abs=1.0)
        assert rounded.progress.min() > -1e-9
        assert rounded.progress.max() < 1.0 + 1e-9
        assert rounded.progress[-1] == pytest.approx(1.0)


def test_the_replies_determine_the_law_and_the_starts(fitted: MoveFit) -> None:
    law = replace(TRUTH, has_known_acceleration=(True, True))
    fits = LawFits(fitted)
    delays_s = fits.at(law).fit.parameters.start_times_s - fitted.table.command_times_s
    assert np.abs(delays_s[fitted.table.first_command[:-1]] - DELAY_S).max() < 1e-3
    wrong = fitted.parameters.start_times_s - fitted.table.command_times_s
    assert np.abs(wrong - DELAY_S).max() > 5e-3  # with the recorded settings
    assert fits.recorded_cost - fits.at(law).cost > 10.0


@pytest.mark.parametrize("known", [(True, True), (False, False)])
def test_the_score_of_the_law_is_the_difference(fitted: MoveFit, known: tuple[bool, bool]) -> None:
    law = replace(TRUTH, has_known_acceleration=known)
    now = LawFits(fitted).at(law)
    profile = LawProfile.of(now.information, now.fit.information)

    def cost(values: np.ndarray, changed_law: MotionLaw) -> float:
        return now.objective.cost(fitted.table, values, changed_law, now.objective.prior)

    values = now.fit.values
    for k in range(LAW_VALUES):
        step, change = STEPS[k], STEPS[k] * np.eye(LAW_VALUES)[k]
        tolerance = 0.02 * np.sqrt(now.information.law_block[k, k])  # 0.02 of a standard deviation
        after, before = (cost(values, changed(law, sign * change)) for sign in (1, -1))
        numeric = (before - after) / (2.0 * step)
        assert now.information.score[k] == pytest.approx(numeric, abs=tolerance)
        after, before = (
            cost(values + sign * step * profile.shift[:, k], changed(law, sign * change))
            for sign in (1, -1)
        )
        numeric = (before - after) / (2.0 * step)
        assert profile.score[k] == pytest.approx(numeric, abs=tolerance)


def test_the_fitted_moves_follow_the_law_as_their_derivative_says(fitted: MoveFit) -> None:
    law = replace(TRUTH, has_known_acceleration=(True, True))
    fits = LawFits(fitted)
    now = fits.at(law)
    profile = LawProfile.of(now.information, now.fit.information)
    starts = fitted.table.first_command[:-1]  # which are polled
    for k in range(LAW_VALUES):
        change = 30.0 * STEPS[k] * np.eye(LAW_VALUES)[k]
        after, before = (fits.at(changed(law, sign * change)).fit.values for sign in (1, -1))
        numeric = (after - before)[starts] / (60.0 * STEPS[k])
        largest = float(np.abs(profile.shift[starts, k]).max())
        assert profile.shift[starts, k] == pytest.approx(numeric, abs=0.05 * largest)


def test_the_step_to_the_fitted_moves_has_no_score(fitted: MoveFit) -> None:
    now = LawFits(fitted).at(replace(TRUTH, has_known_acceleration=(True, True)))
    values, information = now.fit.values, now.fit.information
    table = fitted.table
    for k in (0, 3, table.command_count, values.size - 1):
        step = np.zeros(values.size)
        step[k] = 0.1 / np.sqrt(float(information.multiply(np.eye(values.size)[k])[k]))
        costs = [
            now.objective.cost(table, values + sign * step, TRUTH, now.objective.prior)
            for sign in (1, 0, -1)
        ]
        assert (costs[0] - costs[2]) / 0.2 == pytest.approx(0.0, abs=0.02)
        # In units of its standard deviation with all others fixed the curvature is 1.
        assert (costs[0] - 2.0 * costs[1] + costs[2]) / 0.01 == pytest.approx(1.0, rel=0.05)


def test_no_difference_is_the_recorded_motion(fitted: MoveFit) -> None:
    same = LawFits(fitted).at(MotionLaw())
    assert same.fit.values == pytest.approx(fitted.values, abs=1e-6)
