"""Known turns: exact recovery, coverage, partial knowledge, hostile events."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import EventKind, SessionEvent
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import fit_turns
from gyrorig_solver.reference import TimeInterval, TurnReference, read_turns
from gyrorig_solver.reference.known_turns import KnownTurn

Maker = Callable[..., GyroSamples]
STD_RAD = float(np.radians(1.0))


def turning(
    make: Maker,
    gain: FloatArray,
    bias: FloatArray,
    axes: FloatArray,
    seed: int | None,
    angle_rad: float = 2 * np.pi,
) -> tuple[GyroSamples, TurnReference]:
    """Rests of 5 s between turns of 4 s with a smooth start and stop.

    With a seed, the true angles and axes are off by what is stated of them.
    """
    rng = np.random.default_rng(seed)
    hz, turns, rests, rates = 100.0, [], [], [np.zeros((500, 3))]
    at_s = 5.0
    rests.append(TimeInterval(0.0, 4.99))
    for axis in axes:
        true_angle, true_axis = angle_rad, axis
        if seed is not None:
            true_angle += rng.normal() * STD_RAD
            tilt = rng.normal(size=3) * STD_RAD
            true_axis = axis + np.cross(tilt, axis)
        phase = (np.arange(400) + 0.5) / 400.0
        speed = true_angle / 4.0 * (1.0 - np.cos(2 * np.pi * phase))
        rates += [speed[:, None] * true_axis, np.zeros((500, 3))]
        turns.append(KnownTurn(TimeInterval(at_s, at_s + 3.99), axis, angle_rad, STD_RAD))
        rests.append(TimeInterval(at_s + 4.0, at_s + 8.99))
        at_s += 9.0
    rate = np.concatenate(rates)
    noise = np.random.default_rng(99).normal(size=rate.shape) * 1e-4
    samples = make(np.arange(len(rate)) / hz, rate @ gain.T + bias + noise)
    return samples, TurnReference(tuple(turns), tuple(rests))


def test_exact_turns_give_the_gain_back(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    turn_session = turning(samples_of, true_gain, true_bias_rad_s, np.eye(3), None)
    fit = fit_turns([turn_session])
    np.testing.assert_allclose(fit.gain, true_gain, atol=2e-4)
    np.testing.assert_allclose(fit.bias_rad_s, true_bias_rad_s, atol=3e-5)
    assert fit.observability.rank == 12
    assert np.isnan(fit.time_offset_s)
    # One degree of angle in 360 along the axis, one degree of direction across it.
    np.testing.assert_allclose(np.diag(fit.gain_std), 1.0 / 360.0, rtol=0.05)
    assert 0.015 < fit.gain_std[1, 0] < 0.020


def test_errors_are_what_the_covariance_says(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    axes = np.vstack([np.eye(3), -np.eye(3)])
    scores = []
    for seed in range(25):
        fit = fit_turns([turning(samples_of, true_gain, true_bias_rad_s, axes, seed)])
        scores.append(((fit.gain - true_gain) / fit.gain_std).ravel())
    every = np.concatenate(scores)
    # Six turns, nine unknowns: the covariance is widened by the turns' own spread where
    # that is above 1, so the mean square may lie below 1.
    assert 0.5 < np.mean(every**2) < 1.4
    assert np.abs(every).max() < 4.5


def test_turns_about_x_show_only_x(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    fit = fit_turns([turning(samples_of, true_gain, true_bias_rad_s, np.eye(3)[:1], None)])
    assert np.isfinite(fit.gain[:, 0]).all()
    assert np.isnan(fit.gain[:, 1:]).all()
    assert "scale.y" in fit.observability.unobservable
    assert any(
        "column y of the gain: the recordings have no turn about the y axis of the reference"
        in text
        for text in fit.observability.reasons
    )


def test_rest_and_turns_may_be_two_recordings(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    samples, result = turning(samples_of, true_gain, true_bias_rad_s, np.eye(3), None)
    alone = (samples, TurnReference(result.turns, ()))
    with pytest.raises(InputError, match="the board never rests"):
        fit_turns([alone])
    fit = fit_turns([alone, (samples, TurnReference((), result.rests))])
    np.testing.assert_allclose(fit.gain, true_gain, atol=2e-4)


def test_coarse_counts_do_not_stop_the_bias(samples_of: Maker) -> None:
    samples, result = turning(samples_of, np.eye(3), np.array([0.0004, 0.0, 0.0]), np.eye(3), None)
    quantum = 0.001
    coarse = np.rint(samples.rate_rad_s / quantum + 0.25) * quantum
    fit = fit_turns([(samples_of(samples.time_s, coarse), result)])
    assert np.abs(fit.bias_rad_s).max() < quantum


@pytest.mark.parametrize("turn_count", [3, 6])
def test_rounded_rests_share_the_error_of_their_rounding(
    samples_of: Maker, true_gain: FloatArray, turn_count: int
) -> None:
    """Before, more rests and turns reduced it; the bias differed by 6 of its uncertainties."""
    quantum = 0.009
    axes = np.vstack([np.eye(3), -np.eye(3)])[:turn_count]
    bias = np.array([0.0112, -0.0220, 0.0049])
    samples, result = turning(samples_of, true_gain, bias, axes, None)
    rounded = np.rint(samples.rate_rad_s / quantum) * quantum
    coarse = replace(samples_of(samples.time_s, rounded), quantum_rad_s=quantum)
    # The angles are known well, so that the turns contribute to the bias.
    turns = tuple(replace(turn, std_rad=1e-3) for turn in result.turns)
    fit = fit_turns([(coarse, TurnReference(turns, result.rests))])
    std = np.array([fit.std[f"bias.{axis}"] for axis in "xyz"])
    assert np.all(np.abs(fit.bias_rad_s - bias) < 2.0 * std)
    assert std == pytest.approx(quantum / np.sqrt(12.0), rel=0.1)


def event(time_ns: int, kind: EventKind, phase: str, text: str = "") -> SessionEvent:
    return SessionEvent(time_ns, kind, phase, text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"axis": [1, 0], "angle_rad": 1, "std_rad": 1}',
        '{"axis": [2, 0, 0], "angle_rad": 1, "std_rad": 1}',
        '{"axis": [1, 0, 0], "angle_rad": NaN, "std_rad": 1}',
        '{"axis": [1, 0, 0], "angle_rad": 1, "std_rad": 0}',
    ],
)
def test_invalid_turns_are_rejected(text: str) -> None:
    events = [
        event(0, EventKind.PHASE_BEGIN, "turn", text),
        event(10**9, EventKind.PHASE_END, "turn", text),
    ]
    with pytest.raises(InputError, match=r"turn at 0\.0 s"):
        read_turns(events, 0)


def test_interrupted_phases_are_not_used() -> None:
    text = '{"axis": [0, 0, 1], "angle_rad": 6.28, "std_rad": 0.1}'
    second = 10**9
    events = [
        event(0, EventKind.PHASE_BEGIN, "static"),
        event(5 * second, EventKind.PHASE_END, "static"),
        event(5 * second, EventKind.PHASE_BEGIN, "turn", text),
        event(8 * second, EventKind.FAULT, "", "it hung up"),
        event(8 * second, EventKind.PHASE_END, "turn", "aborted"),
        event(9 * second, EventKind.PHASE_BEGIN, "static"),
        event(12 * second, EventKind.PHASE_END, "static", "aborted"),
    ]
    result = read_turns(events, 0)
    assert result.turns == ()
    assert result.rests == (TimeInterval(0.0, 5.0),)


@given(
    st.lists(
        st.tuples(
            st.integers(0, 10**9), st.integers(0, 3), st.sampled_from(["static", "turn", "x"])
        ),
        max_size=20,
    )
)
def test_events_in_any_order_never_crash(output: list[tuple[int, int, str]]) -> None:
    text = '{"axis": [0, 0, 1], "angle_rad": -6.28, "std_rad": 0.1}'
    events = [event(t, EventKind(kind), phase, text) for t, kind, phase in output]
    result = read_turns(events, 0)
    assert all(i.end_s > i.begin_s for i in result.rests)


# 99.9 % of a chi-square of 60 values lies below 99.6, and 0.1 % below 30.3.
CHI2_60_LIMITS = (30.3, 99.6)


def turns_after_rest(
    make: Maker, seed: int, rest_s: float, noise_dps: float, correlation: float = 0.0
) -> tuple[GyroSamples, TurnReference]:
    """One rest, and then a turn of 6 s forth and back about each axis; the bias is zero.

    The true angles and axes are off by what is stated of them.
    """
    rng = np.random.default_rng(seed)
    rest_samples = round(100 * rest_s)
    phase = (np.arange(600) + 0.5) / 600.0
    angle_std_rad = float(np.radians(0.2))
    rates, turns, begin_s = [np.zeros((rest_samples, 3))], [], rest_s
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        true_axis = axis + np.cross(rng.normal(size=3) * STD_RAD, axis)
        angle_rad = 2.0 * np.pi + rng.normal() * angle_std_rad
        speed = angle_rad / 6.0 * (1.0 - np.cos(2.0 * np.pi * phase))
        rates.append(speed[:, None] * true_axis)
        interval = TimeInterval(begin_s, begin_s + 5.99)
        turns.append(KnownTurn(interval, axis, 2.0 * np.pi, angle_std_rad))
        begin_s += 6.0
    rate = np.concatenate(rates)
    noise = rng.normal(size=rate.shape) * np.radians(noise_dps)
    for k in range(1, len(noise)):
        noise[k] += correlation * noise[k - 1]
    rests = (TimeInterval(0.0, rest_s - 0.01),) if rest_samples else ()
    samples = make(np.arange(len(rate)) / 100.0, rate + noise)
    return samples, TurnReference(tuple(turns), rests)


@pytest.mark.parametrize(
    ("rest_s", "noise_dps", "correlation"),
    [(0.5, 0.2, 0.0), (2.0, 0.2, 0.0), (10.0, 0.05, 0.9)],
    ids=["half a second", "two seconds", "correlated noise"],
)
def test_the_noise_of_a_rest_is_part_of_the_uncertainty_of_the_bias(
    samples_of: Maker, rest_s: float, noise_dps: float, correlation: float
) -> None:
    scores = []
    for seed in range(20):
        fit = fit_turns([turns_after_rest(samples_of, seed, rest_s, noise_dps, correlation)])
        scores.append(fit.bias_rad_s / [fit.std[f"bias.{axis}"] for axis in "xyz"])
    assert CHI2_60_LIMITS[0] < np.sum(np.square(scores)) < CHI2_60_LIMITS[1]


def test_a_recording_without_a_rest_can_have_another_bias(samples_of: Maker) -> None:
    resting, turns = turns_after_rest(samples_of, 0, 30.0, 0.05)
    rest = (resting, TurnReference((), turns.rests))
    scores = []
    for seed in range(20):
        samples, reference = turns_after_rest(samples_of, seed, 0.0, 0.05)
        bias_rad_s = np.random.default_rng(100 + seed).normal(size=3) * np.radians(0.1)
        turned = (samples_of(samples.time_s, samples.rate_rad_s + bias_rad_s), reference)
        fit = fit_turns([rest, turned])
        std = np.array([fit.std[f"bias.{axis}"] for axis in "xyz"])
        scores.append((fit.bias_rad_s - bias_rad_s) / std)
        assert np.abs((fit.gain - np.eye(3)) / fit.gain_std).max() < 4.5
        # The recording at rest keeps the accuracy of its bias.
        assert np.degrees(fit.recordings[0].bias_std_rad_s).max() < 0.02
    assert CHI2_60_LIMITS[0] < np.sum(np.square(scores)) < CHI2_60_LIMITS[1]
    assert any(
        "never rests in these recordings, numbered in the given order: 2." in text
        for text in fit.warnings
    )
