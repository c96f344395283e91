"""Motion from counts alone: the spline's own claim, its derivatives, and what is chosen when."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import signal

from gyrorig_solver.data.clocks import map_clock
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import UNIT_REMEDIES, fit_motion
from gyrorig_solver.model import factorise
from gyrorig_solver.reference import MotionLimits, PanTiltReference, plan_motion
from gyrorig_solver.reference.unit.counted_reference import CountedReference, counted_reference
from gyrorig_solver.reference.unit.motion_profile import ProfileCommand
from gyrorig_solver.reference.unit.move_fit import UnitPolls
from gyrorig_solver.reference.unit.pan_tilt_recording import choose_reference
from gyrorig_solver.reference.unit.recorded_orders import UnitExchange, translate_exchanges
from gyrorig_solver.reference.unit.stage_kinematics import stage_rate
from gyrorig_solver.reference.unit.unit_moves import MotionReader

STEP_RAD = float(np.radians(185.142857 / 3600.0))
LAW = MotionLimits(1200.0, 4000.0, 60.0)
# Seconds, axis, target: pan at three tilts.
MOVES = [(2.0, 1, -500), (4.5, 0, 1500), (8.0, 0, -1000), (12.0, 1, 300), (14.0, 0, 1500),
         (18.0, 0, -1200), (22.0, 1, 0), (24.0, 0, 0)]  # fmt: skip
LENGTH_S, FINE_HZ = 30.0, 2000.0
SETTINGS = {
    f"{axis}_{kind}": value
    for axis in ("pan", "tilt")
    for kind, value in (("base_speed", 60.0), ("acceleration", 4000.0), ("speed", 1200.0))
}


@dataclass(frozen=True)
class SimulatedMotion:
    """One run in plain arrays; the unit counts the steps that it has made."""

    time_s: np.ndarray
    steps: np.ndarray  # (2, n), true
    polls: UnitPolls


def make(seed: int) -> SimulatedMotion:
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, LENGTH_S, 1.0 / FINE_HZ)
    steps = np.zeros((2, time_s.size))
    stood = [0.0, 0.0]
    for told_s, axis, target in MOVES:
        start_s = told_s + float(rng.uniform(0.0, 0.01))
        course = plan_motion(stood[axis], [ProfileCommand(start_s, "to", float(target), LAW)])
        after = time_s >= start_s
        steps[axis, after] = course.position_steps(time_s[after])
        stood[axis] = float(target)
    request_s = np.arange(0.1, LENGTH_S - 0.1, 0.012)
    at_s = request_s + 0.0025 + rng.exponential(2e-4, request_s.size)
    hi_s = at_s + 0.0025 + rng.exponential(2e-4, request_s.size)
    true = np.stack([np.interp(at_s, time_s, s) for s in steps])
    rising = np.stack([np.interp(at_s + 1e-3, time_s, s) for s in steps]) >= true
    counted = np.where(rising, np.floor(true + 1e-6), np.ceil(true - 1e-6)).T
    polls = UnitPolls(request_s, hi_s, counted, np.ones(counted.shape, dtype=np.bool_))
    return SimulatedMotion(time_s, steps, polls)


def reference_of(made: SimulatedMotion) -> CountedReference:
    return counted_reference(
        made.polls, (STEP_RAD, STEP_RAD), "the recording has no command of a move"
    )


def test_counts_alone_follow_the_motion() -> None:
    made = make(1)
    reference = reference_of(made)
    assert reference.unknown_spans == ()
    result = reference.angles_rad(made.time_s) / STEP_RAD
    # The count lags by up to a step, which is the lag's own parameter.
    assert np.sqrt(np.mean((result - made.steps) ** 2)) < 0.6
    assert np.abs(result - made.steps).max() < 2.5


def test_derivatives_are_the_differences() -> None:
    made = make(2)
    reference = reference_of(made)
    edges = np.linspace(0.5, 29.5, 2901)
    here = reference.evaluate(edges)
    size = reference.values.size
    assert len(here.local) + here.shared.shape[0] == size == sum(reference.information.size)
    for k in [0, 3, 5, 7, 40, size // 2, size - 30, size - 1]:
        step = np.zeros(size)
        step[k] = 1e-3
        change = reference.with_step(step).evaluate(edges, derivatives=False).rate_rad_s
        column = np.zeros_like(change)
        if k < len(here.local):
            local = here.local[k]
            column[local.first_interval : local.first_interval + local.values.shape[0]] = (
                local.values
            )
        else:
            column = here.shared[k - len(here.local)]
        assert (change - here.rate_rad_s) / 1e-3 == pytest.approx(column, abs=2e-6)


@pytest.mark.parametrize("seed", [3, 4])
def test_a_board_is_calibrated_by_counts_alone(seed: int) -> None:
    made = make(seed)
    rng = np.random.default_rng(seed)
    rate = np.gradient(made.steps * STEP_RAD, 1.0 / FINE_HZ, axis=1)
    omega = stage_rate(made.steps[1] * STEP_RAD, rate[0], rate[1])
    seen = signal.lfilter(*signal.butter(2, 25.0, fs=FINE_HZ), omega, axis=0)
    gain = np.eye(3) + rng.normal(scale=0.02, size=(3, 3))
    bias = rng.normal(scale=0.02, size=3)
    every = round(FINE_HZ / 100.0)
    y = (seen @ gain.T + bias)[::every]
    y = y + rng.normal(scale=3e-3, size=y.shape)
    result = fit_motion(samples_of(made.time_s[::every], y), reference_of(made), UNIT_REMEDIES)
    assert result.identified
    factors = factorise(gain)
    true = [*bias, *factors.scale, *factors.nonorthogonality, *factors.misalignment_rad]
    error = np.array([result.value(name) for name in result.order[:12]]) - true
    covariance = result.covariance[:12, :12]
    assert np.abs(error / np.sqrt(np.diag(covariance))).max() < 4.0
    # scipy.stats.chi2.ppf(0.999, 12) = 32.9
    assert error @ np.linalg.solve(covariance, error) < 32.9
    assert max(result.std[name] for name in result.order[3:12]) < 2e-3


def test_commands_are_used_if_they_explain_the_counts() -> None:
    made = make(5)
    output = [UnitExchange(at, at + 0.005, True, f"{'PT'[axis]}P{to}") for at, axis, to in MOVES]

    def chosen(exchanges: list[UnitExchange]) -> PanTiltReference | CountedReference:
        motion = MotionReader(SETTINGS, (0, 0), made.polls.count_at_rest).read(
            translate_exchanges(exchanges)
        )
        return choose_reference(motion, made.polls, (STEP_RAD, STEP_RAD))

    whole = chosen(output)
    assert isinstance(whole, PanTiltReference)
    assert whole.warnings == ()
    without = chosen([*output[:2], *output[3:]])
    assert isinstance(without, PanTiltReference)
    assert any("do not follow" in words for words in without.warnings)
    rate = without.evaluate(np.array([9.0, 9.01, 15.0, 15.01])).rate_rad_s
    assert np.isnan(rate[0]).all()
    assert np.isfinite(rate[2]).all()
    none = chosen([])
    assert isinstance(none, CountedReference)
    assert any("the recording has no command of a move" in words for words in none.warnings)


def test_a_recording_that_ends_during_a_move_has_a_warning() -> None:
    made = make(6)
    early = made.polls.earliest_s < 15.0
    polls = made.polls
    cut = UnitPolls(
        polls.earliest_s[early], polls.latest_s[early], polls.steps[early], polls.valid[early]
    )
    reference = counted_reference(
        cut, (STEP_RAD, STEP_RAD), "the recording has no command of a move"
    )
    assert any("ends during a move" in words for words in reference.warnings)
    rate = reference.evaluate(np.array([5.0, 5.01, 14.5, 14.51])).rate_rad_s
    assert np.isfinite(rate[0]).all()
    assert np.isnan(rate[2]).all()


def samples_of(time_s: np.ndarray, rate_rad_s: np.ndarray) -> GyroSamples:
    n = time_s.size
    clock = map_clock(np.rint(time_s * 1e6).astype(np.int64), time_s, 1e6, 64)
    return GyroSamples(
        board="B",
        metadata={"bandwidth_hz": "25"},
        origin_ns=0,
        time_s=time_s,
        host_s=time_s,
        number=np.arange(n),
        segment=np.zeros(n, dtype=np.int64),
        rate_rad_s=rate_rad_s,
        usable=np.ones(n, dtype=np.bool_),
        accel_m_s2=None,
        temperature_degc=None,
        quantum_rad_s=1e-6,
        clock=clock,
        latency_bounds=None,
        lost=0,
        repeated=0,
        late=0,
    )


@pytest.mark.parametrize("gap_s", [60.0, 300.0, 3600.0, 1e8])
def test_a_unit_that_moved_in_a_long_gap_of_the_replies_is_unknown(gap_s: float) -> None:
    """The effort of the spline does not grow with the gap, and the motion after it is known."""
    at_s = np.linspace(0.0, 5.98, 300)
    steps = np.zeros((300, 2))
    steps[50:100, 0] = np.arange(50) * 10
    steps[100:, 0] = 490
    at_s[150:] += gap_s
    steps[150:, 0] += 3
    steps[200:250, 0] += np.arange(50) * 10
    steps[250:, 0] += 490
    polls = UnitPolls(at_s, at_s + 0.004, steps, np.ones((300, 2), dtype=bool))
    reference = counted_reference(polls, (1e-3, 1e-3), "no orders")
    assert len(reference.segments) == 3
    ((begin_s, end_s, _),) = reference.unknown_spans
    assert begin_s == pytest.approx(2.93, abs=0.1)
    assert end_s == pytest.approx(3.07 + gap_s, abs=0.1)
    assert reference.values.size < 200  # 1,500 more with the knots of a motion in a gap of 60 s
    after_s = gap_s + np.linspace(3.5, 5.9, 25)
    rate = reference.evaluate(after_s, derivatives=False).rate_rad_s
    assert np.isfinite(rate).all()
    angle = np.interp(after_s, at_s, steps[:, 0]) * 1e-3
    assert reference.angles_rad(after_s)[0] == pytest.approx(angle, abs=0.03)
