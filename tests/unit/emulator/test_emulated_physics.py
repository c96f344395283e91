"""Stage, low-pass, noise, clocks and latency against independent formulations."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg, signal

from gyrorig_daemon.emulator.physics.bias_noise import BiasWander, white_step_sigma
from gyrorig_daemon.emulator.physics.device_clock import ClockTruth, DeviceClock
from gyrorig_daemon.emulator.physics.host_latency import HostLatency, LatencyTruth
from gyrorig_daemon.emulator.physics.lowpass import block_filter, butterworth_step
from gyrorig_daemon.emulator.physics.motion_law import MotionLaw
from gyrorig_daemon.emulator.physics.stage_motion import STANDARD_GRAVITY_M_S2, Stage
from gyrorig_daemon.emulator.physics.stepper_axis import AxisTruth, StepperAxis

ARCSEC = 185.142857


def moving_stage(error_rad: float = 0.0) -> Stage:
    """Both axes turn at once, with ramps inside the second that is looked at."""
    pan = StepperAxis(AxisTruth(ARCSEC), MotionLaw(200.0, 1500.0, 2000.0))
    tilt = StepperAxis(AxisTruth(ARCSEC), MotionLaw(100.0, 700.0, 1000.0))
    pan.move(0.1, 900)
    tilt.move(0.3, -350)
    return Stage(pan, tilt, error_rad)


def rotation(axis: int, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


@pytest.mark.parametrize("error_rad", [0.0, 0.02])
def test_body_rate_is_the_derivative_of_the_attitude(error_rad: float) -> None:
    # omega^ = R^T dR/dt by central differences of R = Rz(pan) Ry(e) Rx(tilt).
    stage = moving_stage(error_rad)
    dt = 1e-4
    pan = stage.pan.angles_rad(0.0, dt, 10001)
    tilt = stage.tilt.angles_rad(0.0, dt, 10001)
    rates = stage.body_rates_rad_s(0.0, dt, 10000)
    for k in range(5, 10000, 61):
        before, after = (
            rotation(2, pan[j]) @ rotation(1, error_rad) @ rotation(0, tilt[j]) for j in (k, k + 1)
        )
        middle = 0.5 * (before + after)
        cross = middle.T @ (after - before) / dt
        numeric = np.array([cross[2, 1], cross[0, 2], cross[1, 0]])
        assert rates[k] == pytest.approx(numeric, abs=2e-6)


def test_gravity_is_the_third_row_of_the_attitude() -> None:
    stage = moving_stage(0.02)
    felt = stage.gravity_stage_m_s2(0.5, 0.01, 50)
    tilt = stage.tilt.angles_rad(0.5, 0.01, 50)
    for k in range(50):
        up = (rotation(1, 0.02) @ rotation(0, tilt[k])).T @ [0.0, 0.0, STANDARD_GRAVITY_M_S2]
        assert felt[k] == pytest.approx(up, abs=1e-12)


def test_an_edge_keeps_its_angle_wherever_it_falls() -> None:
    pan = StepperAxis(AxisTruth(ARCSEC), MotionLaw(1000.0, 1000.0, 2000.0))
    stage = Stage(pan, StepperAxis(AxisTruth(ARCSEC), MotionLaw(1.0, 1.0, 1.0)))
    pan.move(0.1000377, 100)
    rates = stage.body_rates_rad_s(0.0, 1.25e-4, 4000)
    turned = rates[:, 2].sum() * 1.25e-4
    assert math.degrees(turned) == pytest.approx(100 * ARCSEC / 3600.0, rel=1e-12)


def test_filter_step_is_the_exact_zero_order_hold() -> None:
    # Independent: the matrix exponential of the augmented state (Van Loan's trick).
    w, dt = 2 * math.pi * 25.0, 1e-3
    a = np.array([[0.0, 1.0, 0.0], [-w * w, -math.sqrt(2) * w, w * w], [0.0, 0.0, 0.0]])
    exact = linalg.expm(a * dt)
    ad, bd = butterworth_step(25.0, dt)
    assert ad == pytest.approx(exact[:2, :2], abs=1e-9)
    assert bd == pytest.approx(exact[:2, 2], abs=1e-9)


@pytest.mark.parametrize("frequency_hz", [5.0, 25.0, 60.0])
def test_filter_has_the_exact_frequency_response(frequency_hz: float) -> None:
    block = block_filter(25.0, 1.25e-4, 80, 8)
    state = np.zeros((2, 1))
    outputs = []
    for k in range(400):
        n = np.arange(k * 640, (k + 1) * 640)
        # The mean of exp(i w t) over each substep, as the stage gives it; real part.
        w = 2 * math.pi * frequency_hz
        u = (np.exp(1j * w * (n + 1) * 1.25e-4) - np.exp(1j * w * n * 1.25e-4)) / (1j * w * 1.25e-4)
        out, state = block.run(state, u.real[:, None])
        outputs.append(out[:, 0])
    t = (np.arange(3200) + 1) * 0.01
    s = 2j * math.pi * frequency_hz
    wc = 2 * math.pi * 25.0
    response = wc**2 / (s**2 + math.sqrt(2) * wc * s + wc**2)
    expected = (response * np.exp(s * t)).real
    # Averaging and holding over a substep each cost (w dt)^2 / 24 of the amplitude.
    error = np.abs(np.concatenate(outputs)[100:] - expected[100:]).max() / abs(response)
    assert error < 1.1 * (w * 1.25e-4) ** 2 / 12.0


def test_blocks_of_any_size_give_the_same_output() -> None:
    inputs = np.random.default_rng(1).standard_normal((960, 3))
    small, large = block_filter(50.0, 1e-4, 10, 4), block_filter(50.0, 1e-4, 10, 96)
    state = np.zeros((2, 3))
    pieces = []
    for k in range(24):
        out, state = small.run(state, inputs[40 * k : 40 * (k + 1)])
        pieces.append(out)
    whole, end = large.run(np.zeros((2, 3)), inputs)
    assert np.concatenate(pieces) == pytest.approx(whole, abs=1e-12)
    assert state == pytest.approx(end, abs=1e-9)


def test_white_noise_has_the_stated_density() -> None:
    density = 5e-4
    sigma = white_step_sigma(np.full(1, density), 1.25e-4)[0]
    noise = sigma * np.random.default_rng(2).standard_normal(800_000)
    _, power = signal.welch(noise, 8000.0, nperseg=8000)
    # 199 averages of 4000 bins below 4 kHz: the mean is known to better than 0.2 %.
    assert math.sqrt(power[1:-1].mean()) == pytest.approx(density, rel=0.01)


def test_flicker_has_the_stated_allan_floor_and_slope() -> None:
    # Two-sided B^2 / (2 pi f) has an Allan variance of 2 ln2 B^2 / pi at any tau (IEEE 952).
    instability, period = 1.0, 0.08
    rng = np.random.default_rng(3)
    wander = BiasWander(np.full(3, instability), np.zeros(3), period, rng)
    path = np.array([wander.advance() for _ in range(60_000)])
    for m in (50, 250, 1000):
        means = path[: len(path) // m * m].reshape(-1, m, 3).mean(axis=1)
        allan = 0.5 * (np.diff(means, axis=0) ** 2).mean()
        assert allan == pytest.approx(2 * math.log(2) / math.pi, rel=0.25)


def test_random_walk_grows_as_the_root_of_time() -> None:
    rng = np.random.default_rng(4)
    ends = []
    for _ in range(400):
        wander = BiasWander(np.zeros(3), np.full(3, 2.0), 1.0, rng)
        for _ in range(25):
            end = wander.advance()
        ends.append(end)
    assert np.std(ends) == pytest.approx(2.0 * 5.0, rel=0.08)


def clock(**changes: float) -> DeviceClock:
    truth = ClockTruth(1e6, **changes)  # type: ignore[arg-type]
    return DeviceClock(truth, 1_000, np.random.default_rng(5))


def test_clock_skew_is_its_rate() -> None:
    fast = clock(skew=50e-6)
    assert fast.ticks(1_000 + 100_000_000_000) == 100_000_000 + 5_000


@settings(max_examples=30)
@given(times=st.lists(st.integers(0, 300_000_000_000), min_size=2, max_size=20))
def test_clock_reads_the_same_in_any_order(times: list[int]) -> None:
    first, other = (clock(skew=3e-5, wander_per_rts=1e-6) for _ in range(2))
    forward = {t: first.ticks(t) for t in sorted(times)}
    assert {t: other.ticks(t) for t in sorted(times, reverse=True)} == forward


def test_clock_wander_is_a_random_walk_of_frequency() -> None:
    # After T the phase has the variance q^2 T^3 / 3.
    ends = []
    for seed in range(300):
        wandering = DeviceClock(
            ClockTruth(1e6, wander_per_rts=1e-6), 0, np.random.default_rng(seed)
        )
        ends.append(wandering.seconds(100_000_000_000) - 100.0)
    assert np.std(ends) == pytest.approx(1e-6 * math.sqrt(100.0**3 / 3.0), rel=0.12)


def test_clock_starts_anew_at_a_reset() -> None:
    reset = DeviceClock(ClockTruth(1e6, start_ticks=77), 0, np.random.default_rng(6), (10**9,))
    assert reset.ticks(10**9 - 1) == 77 + 999_999
    assert reset.ticks(10**9) == 0
    assert reset.ticks(10**9 + 5_000) == 5
    assert reset.last_reset_ns(10**9 - 1) is None


def test_arrivals_have_a_floor_an_exponential_and_keep_order() -> None:
    truth = LatencyTruth(stall_interval_s=0.0)
    latency = HostLatency(truth, 0, np.random.default_rng(7))
    sent = np.arange(20_000) * 10_000_000
    late = np.array([latency.arrival_ns("a", int(t)) for t in sent]) - sent
    assert late.min() >= 60_000
    assert late.min() < 61_000
    assert (late - 60_000).mean() == pytest.approx(300_000, rel=0.03)


def test_each_frame_of_a_bus_has_the_latency_of_a_single_one() -> None:
    """Before, a frame waited for the one before it, and drew another latency in addition."""
    truth = LatencyTruth(stall_interval_s=0.0)
    latency = HostLatency(truth, 0, np.random.default_rng(4), (), ("can",))
    sent = (np.arange(20_000)[:, None] * 10_000_000 + np.arange(3) * 123_000).ravel()
    arrived = np.array([latency.arrival_ns("can", int(t)) for t in sent])
    assert (np.diff(arrived) >= 0).all()
    late = (arrived - sent - 60_000).reshape(-1, 3)
    assert late.mean(axis=0) == pytest.approx(np.full(3, 300_000), rel=0.03)


def test_stalls_hold_everything_and_let_it_go_at_once() -> None:
    truth = LatencyTruth(jitter_s=1e-9, stall_interval_s=2.0)
    latency = HostLatency(truth, 0, np.random.default_rng(8))
    sent = np.arange(0, 200_000) * 1_000_000
    arrived = np.array([latency.arrival_ns("ab"[k % 2], int(t)) for k, t in enumerate(sent)])
    assert (np.diff(arrived) >= 0).all()
    late_s = (arrived - sent) * 1e-9
    share = (late_s > 1e-3).mean()
    # One stall of 102.5 ms on average in every 2 s.
    assert share == pytest.approx(0.1025 / 2.1025, rel=0.3)
    assert 0.15 < late_s.max() < 0.201
