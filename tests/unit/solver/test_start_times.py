"""The fit of starts and rests against a dense second formulation of the same evidence.

The dense one goes move by move, differentiates courses numerically, inverts full matrices,
and takes the count's unknowns and the detents out by Schur complement and Woodbury's
identity. It shares the courses' laying and the first guess with nothing it judges.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from gyrorig_solver.reference import DETENT_VARIANCE, MotionLimits, PanTiltReference, plan_motion
from gyrorig_solver.reference.reference_motion import LocalDerivative
from gyrorig_solver.reference.unit import pan_tilt_recording, poll_likelihood
from gyrorig_solver.reference.unit.motion_profile import ProfileCommand
from gyrorig_solver.reference.unit.move_fit import MoveFit, UnitPolls, fit_moves
from gyrorig_solver.reference.unit.pan_tilt_recording import unexplained_spans
from gyrorig_solver.reference.unit.profile_derivatives import differentiate_move
from gyrorig_solver.reference.unit.recorded_orders import UnitExchange, translate_exchanges
from gyrorig_solver.reference.unit.rest_variance import VARIANCE_CANDIDATES
from gyrorig_solver.reference.unit.unit_moves import MotionReader, UnitMotion

BASE, RAMP = 100.0, 4000.0
SPEEDS = (600.0, 1500.0)
STEP_RAD = 9e-4
SETTINGS = {
    f"{axis}_{kind}": value
    for axis in ("pan", "tilt")
    for kind, value in (("base_speed", BASE), ("acceleration", RAMP))
}
STEP_VARIANCE = 1.0 / 12.0
AGREE = 5e-3  # standard deviations; what a solve is stopped at is some 1e-3


@dataclass(frozen=True)
class SimulatedMotion:
    """A motion, what was polled of it, and where it was at the polls."""

    motion: UnitMotion
    polls: UnitPolls
    starts_s: np.ndarray


def departures(motion: UnitMotion) -> list[int | None]:
    """The move that ends each rest, by axis and time; None after the last move of an axis."""
    moves = list(enumerate(motion.moves))
    return [k for axis in (0, 1) for k in [*(k for k, m in moves if m.axis == axis), None]]


def make(
    seed: int, moves: int = 10, off_steps: float = 0.0, change: bool = False
) -> SimulatedMotion:
    """Moves of pan, every third of tilt; rests off their counts; one order on the way."""
    rng = np.random.default_rng(seed)
    told_s, exchanges, legs, starts = 2.0, [], [], []
    stood, off = [0, 0], [0.0, 0.0]
    for k in range(moves):
        axis, speed = int(k % 3 == 2), SPEEDS[k % 2]
        name = "PT"[axis]
        target = int(stood[axis] + rng.choice([-1.0, 1.0]) * rng.uniform(300.0, 700.0))
        law = MotionLimits(speed * 1.0004, RAMP * 1.002, BASE)
        given = [(told_s, f"{name}S{speed:.0f}"), (told_s + 0.01, f"{name}P{target}")]
        starts.append(told_s + 0.01 + 0.004 + rng.uniform(0.0, 0.003))
        end = off_steps * rng.uniform(-0.5, 0.5)
        orders = [ProfileCommand(starts[-1], "to", target + end, law)]
        if change and k == 4:
            target = stood[axis]
            given.append((told_s + 0.25, f"{name}P{target}"))
            starts.append(told_s + 0.25 + 0.004 + rng.uniform(0.0, 0.003))
            orders.append(ProfileCommand(starts[-1], "to", target + end, law))
        exchanges += [UnitExchange(at, at + 0.004, True, command) for at, command in given]
        course = plan_motion(stood[axis] + off[axis], orders)
        legs.append((axis, course))
        stood[axis], off[axis] = target, end
        told_s = course.end_s + 0.4
    request_s = np.arange(0.1, told_s + 1.0, 0.012)
    at_s = request_s + 0.0025 + rng.exponential(2e-4, request_s.size)
    hi_s = at_s + 0.0025 + rng.exponential(2e-4, request_s.size)
    steps = np.zeros((request_s.size, 2))
    for axis, course in legs:
        after = at_s >= course.start_s[0]
        steps[after, axis] = course.position_steps(at_s[after])
    valid = rng.uniform(size=steps.shape) > 0.02
    motion = MotionReader(SETTINGS, (0, 0)).read(translate_exchanges(exchanges))
    polls = UnitPolls(request_s, hi_s, np.rint(steps), valid)
    return SimulatedMotion(motion, polls, np.array(starts))


@dataclass(frozen=True)
class Dense:
    """What the dense formulation finds: unknowns are starts, rests, speeds, ramps, count."""

    values: np.ndarray
    information: np.ndarray  # without the three of the count, with detents
    rest_variance: float


def dense_fit(made: SimulatedMotion, near: MoveFit) -> Dense:
    """Return the dense solution, with the scatter of the instants that `near` found."""
    motion, polls = made.motion, made.polls
    first = np.concatenate([[0], np.cumsum([len(m.commands) for m in motion.moves])])
    starts, rests = int(first[-1]), len(departures(motion))
    speed = starts + rests
    ramp = speed + motion.speed_class_count
    size = ramp + 5
    prior = np.zeros(size)
    changes = np.ones(starts, dtype=bool)
    changes[first[:-1]] = False
    prior[:starts] = np.where(changes, 0.02**-2, 1.0)
    prior[speed:] = [1e4] * (motion.speed_class_count + 2) + [4.0, 4.0, 0.3**-2]
    output = np.array([order.command_time_s for m in motion.moves for order in m.commands])
    width = polls.latest_s - polls.earliest_s
    least = np.percentile(width, 1.0)
    extra = np.clip(width - least, 0.0, None)
    values = np.zeros(size)
    values[:starts] = output + 0.006
    values[-1] = 0.5
    guess = values[:starts].copy()
    standing = np.arange(starts, speed)
    variance = STEP_VARIANCE
    for turn in range(14):
        gram, score = np.zeros((size, size)), np.zeros(size)
        for k, move in enumerate(motion.moves):
            rows = np.arange(first[k], first[k + 1])
            log_speed, log_ramp = values[speed:ramp], float(values[ramp + move.axis])
            course = move.profile(values[rows], log_speed, log_ramp)
            at = polls.earliest_s + least / 2.0 + values[-1] * extra
            inside = (at > values[rows[0]]) & (at < course.end_s) & polls.valid[:, move.axis]
            spacing = np.median(np.diff(at[inside]))
            position = course.position_steps(at)
            inside &= np.abs(position - move.from_steps) > 2.0
            inside &= np.abs(position - move.to_steps) > 2.0
            rate = course.speed_steps_s(at)
            inside &= rate != 0.0
            at, position, rate = at[inside], position[inside], rate[inside]
            share, sign = course.progress(at), np.sign(rate)
            before = starts + departures(motion).index(k)
            model = position + (1 - share) * values[before] + share * values[before + 1]
            by = differentiate_move(move, values[rows], log_speed, log_ramp, at)
            jacobian = np.zeros((at.size, size))
            jacobian[:, rows] = by.starts.T
            jacobian[:, before], jacobian[:, before + 1] = 1 - share, share
            jacobian[:, [speed + c for c in move.speed_classes]] = by.speeds.T
            jacobian[:, ramp + move.axis] = by.acceleration
            jacobian[:, -3], jacobian[:, -2] = 1.0, -sign
            jacobian[:, -1] = rate * extra[inside]
            residual = polls.steps[inside, move.axis] - model - values[-3] + sign * values[-2]
            weight = np.minimum(1.0, np.abs(rate) * spacing)
            weight /= STEP_VARIANCE + (rate * near.instant_std_s) ** 2
            gram += (jacobian.T * weight) @ jacobian
            score += jacobian.T @ (weight * residual)
        seen = np.median((values[:starts] - output)[~changes])
        centre = np.concatenate([np.where(changes, output + seen, guess), np.zeros(size - starts)])
        centre[-1] = 0.5
        gram[np.arange(size), np.arange(size)] += prior
        score += prior * (centre - values)
        if turn in (7, 8):
            variance = likeliest(gram, score, standing, values[standing])
        gram[standing, standing] += 1.0 / variance
        score[standing] -= values[standing] / variance
        values = values + np.linalg.solve(gram, score)
    indices, drop = np.arange(size - 3), np.arange(size - 3, size)
    taken = np.linalg.solve(gram[np.ix_(drop, drop)], gram[np.ix_(drop, indices)])
    left = gram[np.ix_(indices, indices)] - gram[np.ix_(indices, drop)] @ taken
    inner = left[np.ix_(standing, standing)] + np.eye(rests) / DETENT_VARIANCE
    loosened = left - left[:, standing] @ np.linalg.solve(inner, left[standing])
    return Dense(values, loosened, variance)


def likeliest(gram: np.ndarray, score: np.ndarray, standing: np.ndarray, at: np.ndarray) -> float:
    """Return the variance under which the data are likeliest, by eigenvalues."""
    others = np.setdiff1d(np.arange(score.size), standing)
    carry = np.linalg.solve(gram[np.ix_(others, others)], gram[np.ix_(others, standing)])
    information = gram[np.ix_(standing, standing)] - gram[np.ix_(standing, others)] @ carry
    pull = score[standing] - carry.T @ score[others] + information @ at
    values, vectors = np.linalg.eigh(information)
    pull = vectors.T @ pull
    likelihood = [
        np.sum(pull**2 / (values + 1.0 / v)) - np.sum(np.log1p(v * values))
        for v in VARIANCE_CANDIDATES
    ]
    return VARIANCE_CANDIDATES[int(np.argmax(likelihood))]


@pytest.mark.parametrize(
    ("seed", "off_steps", "change"), [(1, 0.0, False), (2, 1.0, False), (3, 1.0, True)]
)
def test_banded_and_dense_solutions_are_equal(seed: int, off_steps: float, change: bool) -> None:
    made = make(seed, 10, off_steps, change)
    result = fit_moves(made.motion, made.polls)
    dense = dense_fit(made, result)
    table, at = result.table, result.parameters
    acting = table.command_count + table.rest_count
    std = np.sqrt(np.diag(np.linalg.inv(dense.information)))
    values = np.concatenate(
        [at.start_times_s, at.rest_offset_steps, at.log_speed, at.log_acceleration]
    )
    assert result.rest_variance == dense.rest_variance
    assert np.abs((values - dense.values[:-3]) / std).max() < AGREE
    # The same covariance: counted rests and the count's unknowns marginalised.
    covariance = np.linalg.inv(result.information.to_dense())
    shared = np.arange(
        acting + table.rest_count, acting + table.rest_count + table.speed_class_count + 2
    )
    index = np.concatenate([np.arange(acting), shared])
    other = np.linalg.inv(dense.information)
    scale = np.outer(std, std)
    assert np.abs((covariance[np.ix_(index, index)] - other) / scale).max() < AGREE


def test_starts_are_where_they_were_within_what_is_claimed() -> None:
    """Ten runs; chi-squared of all starts together, the count's constants taken out."""
    total, count = 0.0, 0
    for seed in range(10, 20):
        made = make(seed, 12)
        result = fit_moves(made.motion, made.polls)
        covariance = np.linalg.inv(result.information.to_dense())
        starts = made.starts_s.size
        # All starts may shift together by what no poll can show.
        covariance = covariance[:starts, :starts] + result.common_shift_std_s**2
        error = result.parameters.start_times_s - made.starts_s
        total += float(error @ np.linalg.solve(covariance, error))
        count += starts
    # scipy.stats.chi2.interval(0.999, 120) = (75.5, 177.6)
    assert count == 120
    assert 75.5 < total < 177.6


def reference_of(made: SimulatedMotion) -> PanTiltReference:
    span = (float(made.polls.earliest_s[0]), float(made.polls.latest_s[-1]))
    result = fit_moves(made.motion, made.polls)
    return PanTiltReference.of(made.motion, result, (STEP_RAD, STEP_RAD), span)


@pytest.mark.parametrize("change", [False, True])
def test_derivatives_are_the_differences(change: bool) -> None:
    made = make(4, 9, change=change)
    reference = reference_of(made)
    # Away from corners: there a difference smears what jumps.
    edges = np.linspace(1.0, float(made.polls.latest_s[-1]) - 0.5, 4001)
    here = reference.evaluate(edges)
    local, shared = reference.information.size
    table = reference.move_fit.table
    acting = table.command_count + table.rest_count
    assert sorted(c.unknown for c in here.local) == list(range(acting))
    assert local == acting + table.rest_count
    assert shared == here.shared.shape[0] + 3
    for k in [*range(acting), *range(local, local + here.shared.shape[0])]:
        step = np.zeros(local + shared)
        step[k] = 1e-6 if k < table.command_count else 1e-5
        ahead = reference.with_step(step).evaluate(edges, derivatives=False).rate_rad_s
        behind = reference.with_step(-step).evaluate(edges, derivatives=False).rate_rad_s
        column = here.shared[k - local] if k >= local else np.zeros_like(ahead)
        for derivative in here.local:
            if derivative.unknown == k:
                column[
                    derivative.first_interval : derivative.first_interval
                    + derivative.values.shape[0]
                ] = derivative.values
        off = np.abs((ahead - behind) / (2.0 * step[k]) - column)
        assert np.mean(np.any(off > 1e-4 * np.abs(column).max() + 1e-9, axis=1)) < 2e-3
    # What only polls know of changes no rate.
    step = np.zeros(local + shared)
    step[acting:local] = 0.1
    step[-3:] = 0.1
    still = reference.with_step(step).evaluate(edges, derivatives=False).rate_rad_s
    assert np.array_equal(still, here.rate_rad_s)


@pytest.mark.parametrize("change", [False, True])
def test_a_window_is_a_piece_of_the_whole(change: bool) -> None:
    made = make(5, 9, change=change)
    reference = reference_of(made)
    edges = np.linspace(0.5, float(made.polls.latest_s[-1]), 3001)
    whole = reference.evaluate(edges)
    rng = np.random.default_rng(0)
    for begin, size in zip(rng.integers(0, 2900, 40), rng.integers(2, 700, 40), strict=True):
        piece = slice(int(begin), min(3000, int(begin + size)))
        result = reference.evaluate(edges[piece.start : piece.stop + 1])
        assert np.allclose(result.rate_rad_s, whole.rate_rad_s[piece], atol=1e-12, equal_nan=True)
        assert np.allclose(result.shared, whole.shared[:, piece], atol=1e-9)
        output = dense_columns(result.local, piece.stop - piece.start)
        expected = dense_columns(whole.local, 3000)
        for unknown, column in expected.items():
            here = output.get(unknown, np.zeros((piece.stop - piece.start, 3)))
            assert np.allclose(here, column[piece], atol=1e-9)
        angles = reference.angles_rad(edges[piece])
        assert np.allclose(angles, reference.angles_rad(edges)[:, piece], atol=1e-12)


def dense_columns(local: tuple[LocalDerivative, ...], size: int) -> dict[int, np.ndarray]:
    columns: dict[int, np.ndarray] = {}
    for derivative in local:
        column = columns.setdefault(derivative.unknown, np.zeros((size, 3)))
        column[
            derivative.first_interval : derivative.first_interval + derivative.values.shape[0]
        ] += derivative.values
    return columns


def test_the_cost_of_a_window_depends_on_its_length() -> None:
    """A window of a long recording returns the columns of its own moves only."""
    made = make(6, 120)
    reference = reference_of(made)
    middle_s = float(made.polls.latest_s[-1]) / 2.0
    result = reference.evaluate(np.linspace(middle_s, middle_s + 5.0, 501))
    assert 4 <= len(result.local) <= 20


def test_polls_in_pieces_give_the_same_result(monkeypatch: pytest.MonkeyPatch) -> None:
    made = make(7, 9, change=True)
    # A stretch of counts from somewhere else, and one that begins a piece.
    made.polls.steps[400:420, 0] += 300.0
    made.polls.steps[450:453, 1] -= 300.0
    reference = reference_of(made)
    spans, share = unexplained_spans(reference, made.polls)
    assert len(spans) == 2
    for size in (50, 64, 1000):
        monkeypatch.setattr(poll_likelihood, "POLLS_PER_PIECE", size)
        monkeypatch.setattr(pan_tilt_recording, "POLLS_PER_PIECE", size)
        again = fit_moves(made.motion, made.polls)
        assert np.allclose(
            again.parameters.start_times_s, reference.move_fit.parameters.start_times_s, atol=1e-9
        )
        assert unexplained_spans(reference, made.polls) == (spans, share)
