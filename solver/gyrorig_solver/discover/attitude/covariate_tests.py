"""Nameless tests of what a fit against reference attitudes leaves: on what does it depend?

Smooth functions of each covariate, projected off all that the fit can follow, like a cause;
and what is no function of a rate at an instant: how quickly the rates change (a low-pass, on
either side, or the reference's own smoothing) and how the axis turns between two attitudes.

What to use when: `attitude_dependence_tests`.

Source of the turning axis: the mean rate that a rotation vector gives over a step lacks
w x dw/dt dt^2/12 of the mean of the rate (Bortz 1971, "A new mathematical formulation for
strapdown inertial navigation", IEEE Trans. AES-7, eq. 38 to second order).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gyrorig_solver.data.arrays import FloatArray
from gyrorig_solver.discover.attitude.attitude_terms import MovingBias
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.score_tests import ScoreTest
from gyrorig_solver.estimate.attitude.attitude_projector import AttitudeProjector
from gyrorig_solver.model.signal_arrays import split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import start_values
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.numerics import chi2_upper_tail

KNOTS, FEW_KNOTS = 7, 6


@dataclass(frozen=True, slots=True, eq=False)
class CovariateTest:
    """One test of the dependence on a covariate."""

    covariate: str
    description: str
    signal: Callable[[SignalState], FloatArray]  # to (k, blocks, 3)


def covariate_tests(scenes: Sequence[SignalState]) -> list[CovariateTest]:
    """Return the tests that some recordings allow."""
    largest = np.max([np.abs(scene.sensor_rate_rad_s).max(axis=0) for scene in scenes], axis=0)
    begin = min(float(scene.edges_s[0]) for scene in scenes)
    end = max(float(scene.edges_s[-1]) for scene in scenes)
    fastest = max(float(_speed(scene).max()) for scene in scenes)
    speeds, times = np.linspace(0.0, fastest, KNOTS), np.linspace(begin, end, KNOTS)
    bias_knots = np.linspace(begin, end, FEW_KNOTS)
    moving = partial(_term_effect, MovingBias())
    return [
        CovariateTest(
            "own_rate", "on the rate about the same axis", partial(_own_rate_signals, largest)
        ),
        CovariateTest(
            "speed", "on the speed (the gain changes)", partial(_gain_signals, _speed, speeds)
        ),
        CovariateTest(
            "time", "on the time (the gain changes)", partial(_gain_signals, _time, times)
        ),
        CovariateTest(
            "bias_time",
            "on the time (the bias changes)",
            partial(_bias_signals, _time, bias_knots),
        ),
        CovariateTest("moving_bias", "on whether the board moves (the bias changes)", moving),
        CovariateTest(
            "frequency", "on how quickly the rates change (effect of a filter)", _rate_derivatives
        ),
        CovariateTest("turning_axis", "on how the axis turns between attitudes", _turning_axis),
    ]


def attitude_dependence_tests(space: AttitudeProjector) -> list[DependenceTest]:
    """Return all dependence tests of a residual against attitudes, the smallest p-value first."""
    tests = covariate_tests(space.states)
    results = []
    for test in tests:
        statistics = space.score_statistics(space.evaluate_signals(test.signal))
        score_test = ScoreTest.of(statistics)
        if not score_test.degrees_of_freedom:
            continue
        p_value = chi2_upper_tail(score_test.statistic, score_test.degrees_of_freedom)
        results.append(
            DependenceTest(
                test.covariate,
                test.description,
                score_test.statistic,
                score_test.degrees_of_freedom,
                min(1.0, p_value * len(tests)),
            )
        )
    return sorted(results, key=lambda result: (result.p_value, -result.statistic))


def _time(scene: SignalState) -> FloatArray:
    return scene.time_s


def _speed(scene: SignalState) -> FloatArray:
    return np.asarray(np.linalg.norm(scene.rate_rad_s, axis=1), dtype=np.float64)


def _hat_functions(x: FloatArray, knots: FloatArray) -> FloatArray:
    """Return linear hat functions, 1 at their own knot and 0 at the others, (k, n)."""
    width = max(float(knots[1] - knots[0]), 1e-12)
    return np.asarray(np.clip(1.0 - np.abs(x - knots[:, None]) / width, 0.0, None), np.float64)


def _gain_signals(
    of: Callable[[SignalState], FloatArray], knots: FloatArray, scene: SignalState
) -> FloatArray:
    return scene.sample_output(
        _hat_functions(of(scene), knots)[:, :, None] * scene.sensor_rate_rad_s
    )


def _bias_signals(
    of: Callable[[SignalState], FloatArray], knots: FloatArray, scene: SignalState
) -> FloatArray:
    seen = scene.sample_output(np.repeat(_hat_functions(of(scene), knots)[:, :, None], 3, axis=2))
    return np.concatenate([split_axes(signal) for signal in seen])


def _own_rate_signals(largest: FloatArray, scene: SignalState) -> FloatArray:
    rate, signals = scene.sensor_rate_rad_s, []
    for axis in range(3):
        hats = np.zeros((KNOTS, scene.interval_count, 3))
        knots = np.linspace(-largest[axis], largest[axis], KNOTS)
        hats[:, :, axis] = _hat_functions(rate[:, axis], knots)
        signals.append(scene.sample_output(hats))
    return np.concatenate(signals)


def _term_effect(term: LinearTerm, scene: SignalState) -> FloatArray:
    return term.basis_signals(scene, start_values(term))


def _rate_derivatives(scene: SignalState) -> FloatArray:
    """Return each axis' second and third derivative: gain and delay by the frequency squared.

    Of block means, whose differences hold less of what is faster than the band.
    """
    step_s = scene.step_s * scene.instants_per_block
    second = np.gradient(np.gradient(scene.sample_output(scene.sensor_rate_rad_s), axis=0), axis=0)
    third = np.gradient(second, axis=0)
    return np.concatenate([split_axes(second / step_s**2), split_axes(third / step_s**3)])


def _turning_axis(scene: SignalState) -> FloatArray:
    rate = scene.rate_rad_s
    across = np.cross(rate, np.gradient(rate, scene.step_s, axis=0))
    return split_axes(scene.sample_output(np.asarray(across @ scene.gain.T, dtype=np.float64)))
