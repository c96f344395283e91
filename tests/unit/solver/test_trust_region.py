"""The trust-region iteration: gain ratio, damping, and the parameter that still moves."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import Convergence
from gyrorig_solver.estimate.trust_region import (
    LATE_EVALUATIONS,
    MAX_INCREASE_NATS,
    NEGLIGIBLE_NATS,
    STALLED_EVALUATIONS,
    NotConvergedError,
    ProposedStep,
    minimise,
)

MANY = 60


@dataclass
class Rosenbrock:
    """A curved valley, in nats; its Gauss-Newton steps are too long at first."""

    x: FloatArray
    parameter_names: tuple[str, ...] = ("along", "across")
    rejected: int = 0
    wrong_slope: float = 1.0  # factor of the derivatives by the first parameter

    def residual(self, x: FloatArray) -> FloatArray:
        return np.array([1e2 * (x[1] - x[0] ** 2), 1e1 * (1.0 - x[0])])

    def jacobian(self) -> FloatArray:
        exact = np.array([[-2e2 * self.x[0], 1e2], [-1e1, 0.0]])
        return np.asarray(exact * np.array([self.wrong_slope, 1.0]), dtype=np.float64)

    def propose(self, damping: float) -> ProposedStep:
        jacobian, residual = self.jacobian(), self.residual(self.x)
        information, score = jacobian.T @ jacobian, -jacobian.T @ residual
        damped = information + damping * np.diag(np.diag(information))
        step = np.asarray(np.linalg.solve(damped, score), dtype=np.float64)
        predicted = float(score @ step - 0.5 * step @ information @ step)
        sigma = np.sqrt(np.diag(np.linalg.inv(information)))
        return ProposedStep(step, (), predicted, step / sigma)

    def evaluate(self, proposal: ProposedStep) -> float:
        self.trial = self.x + proposal.step
        before, after = self.residual(self.x), self.residual(self.trial)
        decrease = 0.5 * float(before @ before - after @ after)
        self.rejected += decrease < 0.0
        return decrease

    def accept(self, new_derivatives: bool) -> None:
        assert new_derivatives in (True, False)
        self.x = self.trial

    def renew_derivatives(self) -> bool:
        return False

    def finish(self, proposal: ProposedStep) -> None:
        self.x = self.x + proposal.step


def test_steps_that_raise_the_objective_are_rejected() -> None:
    problem = Rosenbrock(np.array([-1.2, 1.0]))
    solution = minimise(problem, MANY)
    assert solution.converged
    assert problem.rejected > 0
    np.testing.assert_allclose(problem.x, [1.0, 1.0], atol=1e-4)
    assert solution.remaining_nats < NEGLIGIBLE_NATS


@dataclass
class Threshold(Rosenbrock):
    """A parabola with other curvatures on both sides of zero: full steps lead back, too far."""

    parameter_names: tuple[str, ...] = ("level",)

    def propose(self, damping: float) -> ProposedStep:
        slope = self.x[0] + (1.0 if self.x[0] > 0.0 else -1.0)
        step = np.array([-slope / (1.0 + damping)])
        return ProposedStep(step, (), float(0.5 * slope**2), step)

    def evaluate(self, proposal: ProposedStep) -> float:
        self.trial = self.x + proposal.step
        return self.nats(float(self.x[0])) - self.nats(float(self.trial[0]))

    @staticmethod
    def nats(x: float) -> float:
        return 0.5 * x**2 + abs(x)


def test_a_strict_minimisation_never_increases_the_objective() -> None:
    start = 0.4
    free, strict = (Threshold(np.array([start])) for _ in range(2))
    minimise(free, 15)
    minimise(strict, 15, always_renew=True)
    assert Threshold.nats(float(free.x[0])) > 0.5  # on one side or the other
    assert Threshold.nats(float(strict.x[0])) < 0.1


def test_full_steps_that_hold_what_they_predict_are_gauss_newton() -> None:
    problem = Rosenbrock(np.array([0.98, 0.97]))
    plain = problem.x.copy()
    for _ in range(2):
        plain = plain + Rosenbrock(plain).propose(0.0).step
    solution = minimise(problem, MANY)
    assert solution.converged
    assert problem.rejected == 0
    np.testing.assert_allclose(problem.x, plain, atol=1e-9)


def test_limit_on_evaluations_names_the_parameter_that_still_moves() -> None:
    problem = Rosenbrock(np.array([-1.2, 1.0]))
    solution = minimise(problem, 3)
    assert not solution.converged
    full = problem.propose(0.0)
    assert solution.moving == problem.parameter_names[int(np.argmax(np.abs(full.sigmas)))]
    assert solution.moving_sigma == pytest.approx(full.size_sigma)
    assert solution.moving in solution.reason


def test_derivatives_of_the_wrong_sign_never_converge() -> None:
    problem = Rosenbrock(np.array([0.5, 0.25]), wrong_slope=-1.0)
    before = problem.residual(problem.x)
    solution = minimise(problem, MANY)
    assert not solution.converged
    after = problem.residual(problem.x)
    assert 0.5 * (after @ after - before @ before) < MAX_INCREASE_NATS


def test_refusal_is_one_line_with_the_parameter_and_the_remedy() -> None:
    refusal = NotConvergedError(
        Convergence(False, 40, 7.0, "base_speed_jump.speed.pan", 3.25), "leave out a cause"
    )
    assert isinstance(refusal, InputError)
    assert refusal.exit_code == 3
    assert refusal.moving == "base_speed_jump.speed.pan"
    assert str(refusal) == (
        "the fit did not converge in 40 steps, and base_speed_jump.speed.pan still moves by 3.2 "
        "standard deviations. Leave out a cause."
    )


def test_an_error_reaches_another_process() -> None:
    """An error that cannot be read there ends the whole pool of workers."""
    refusal = NotConvergedError(Convergence(False, 40, 7.0, "gap.pan", 3.25), "leave out a cause")
    received = pickle.loads(pickle.dumps(refusal))  # noqa: S301 - our own bytes
    assert type(received) is NotConvergedError
    assert str(received) == str(refusal)
    assert (received.problem, received.remedy) == (refusal.problem, refusal.remedy)
    assert (received.moving, received.exit_code) == ("gap.pan", 3)


@dataclass
class Circle:
    """Each step decreases the objective, and three steps lead back: the noise levels follow."""

    place: int = 0
    evaluations: int = 0
    decrease: float = 100.0
    parameter_names: tuple[str, ...] = ("east", "north")

    def propose(self, damping: float) -> ProposedStep:
        assert damping >= 0.0
        angle = 2.0 * np.pi * self.place / 3.0
        step = 5.0 * np.array([np.cos(angle), np.sin(angle)])
        return ProposedStep(step, (), self.decrease, step)

    def evaluate(self, proposal: ProposedStep) -> float:
        self.evaluations += 1
        return proposal.predicted_decrease

    def accept(self, new_derivatives: bool) -> None:
        assert new_derivatives in (True, False)
        self.place = (self.place + 1) % 3

    def renew_derivatives(self) -> bool:
        return False

    def finish(self, proposal: ProposedStep) -> None:
        raise AssertionError(proposal)


def test_steps_that_lead_back_end_the_fit() -> None:
    problem = Circle()
    solution = minimise(problem, MANY)
    assert not solution.converged
    assert problem.evaluations == solution.evaluations == 3
    assert solution.moving == "east"
    # Small steps may end in many ways: they are not judged.
    slow = Circle(decrease=1.0)
    assert minimise(slow, MANY).evaluations > 6


@dataclass
class Misled(Circle):
    """The derivative promises a decrease in a direction in which the objective increases."""

    progress_nats: float = 0.0  # of a step with much damping

    def propose(self, damping: float) -> ProposedStep:
        shrinkage = 1.0 / (1.0 + damping)
        step = np.array([4.0 * shrinkage, 0.0])
        return ProposedStep(step, (), 8.0 * shrinkage, step)

    def evaluate(self, proposal: ProposedStep) -> float:
        self.evaluations += 1
        is_damped = proposal.predicted_decrease < 4.0
        return self.progress_nats if is_damped else -proposal.predicted_decrease


def test_a_fit_that_only_rejects_steps_ends() -> None:
    solution = minimise(Misled(), MANY)
    assert not solution.converged
    assert solution.evaluations == STALLED_EVALUATIONS
    assert solution.moving == "east"
    # Damped steps that decrease the objective are progress.
    assert minimise(Misled(progress_nats=1.5), MANY).evaluations == MANY


@dataclass
class Plateau(Circle):
    """Every step is the same, and the objective does not follow its derivative."""

    size_sigma: float = 0.02
    finished: bool = False

    def propose(self, damping: float) -> ProposedStep:
        step = np.array([self.size_sigma, 0.0])
        return ProposedStep(step, (), 0.5 * self.size_sigma**2, step)

    def evaluate(self, proposal: ProposedStep) -> float:
        self.evaluations += 1
        return 0.0

    def renew_derivatives(self) -> bool:
        return True

    def finish(self, proposal: ProposedStep) -> None:
        self.finished = True


def test_small_steps_that_change_nothing_end_the_fit() -> None:
    level = Plateau()
    solution = minimise(level, MANY)
    assert solution.converged
    assert level.finished
    assert level.evaluations == LATE_EVALUATIONS
    # A fit that still moves, or that would gain something, goes on.
    assert not minimise(Plateau(size_sigma=0.2), MANY).converged


@dataclass
class Bowl:
    """A parabola whose curvature is larger than the model's; the start is in the steps' unit."""

    x: float = 1.0
    curvature: float = 2.05
    parameter_names: tuple[str, ...] = ("height",)

    def propose(self, damping: float) -> ProposedStep:
        step = np.array([-self.curvature * self.x / (1.0 + damping)])
        predicted = float(-self.curvature * self.x * step[0] - 0.5 * step[0] ** 2)
        return ProposedStep(step, (), predicted, step)

    def evaluate(self, proposal: ProposedStep) -> float:
        self.trial = self.x + float(proposal.step[0])
        return 0.5 * self.curvature * (self.x**2 - self.trial**2)

    def accept(self, new_derivatives: bool) -> None:
        assert new_derivatives in (True, False)
        self.x = self.trial

    def renew_derivatives(self) -> bool:
        return True

    def finish(self, proposal: ProposedStep) -> None:
        self.x += float(proposal.step[0])


@pytest.mark.parametrize("curvature", [1.6, 2.05])
def test_small_steps_that_alternate_are_summed(curvature: float) -> None:
    bowl = Bowl(curvature=curvature)
    solution = minimise(bowl, MANY)
    assert solution.converged
    assert solution.evaluations < LATE_EVALUATIONS
    assert bowl.x == pytest.approx(0.0, abs=1e-2)
