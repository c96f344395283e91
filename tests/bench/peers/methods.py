"""Fit gain, bias and time offset with each method, one function per method.

What to use when: `list_peers` for all peers that can run, `fit_ours` for the fit of this project.
Each peer is written as its users would write it. Each function returns two rows of 13 values in
the order of `Recording.truth`: the estimates and their stated standard deviations. A value is NaN
if the method does not estimate or state it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from tests.bench.accuracy.profile import FloatArray
from tests.bench.peers import factor_graph
from tests.bench.peers.recording import Recording, Table

from gyrorig_solver.estimate import (
    UNIT_REMEDIES,
    analyse_observability,
    calibrate_as_printed,
    fit_motion,
    rest_to_rest,
)
from gyrorig_solver.estimate.paper.paper_matrices import gain_by_pseudoinverse
from gyrorig_solver.estimate.paper.paper_method import READING_OF_TABLE_3, PaperReading

STILL_RAD_S = 1e-3
ITERATIONS = 3  # of Gauss-Newton; two are enough
UNOBSERVABLE_VARIANCE = 1e-6  # largest variance in unobservable directions with a value
OURS = "gyrorig"
PINV = "eq. 7 (pseudo-inverse) of integrated body rates"
NO_OFFSET = "does not estimate the time offset"
NO_ROLL = "estimates neither roll nor the time offset"
UNDETECTED = "does not detect that a column is unobservable"
UNNAMED = "does not report which column is unobservable"


@dataclass(frozen=True, slots=True, eq=False)
class Peer:
    """One method of others."""

    name: str
    run: Callable[[Table], FloatArray]
    limitation: str  # a text about what it does not estimate or report
    any_reference: bool  # False: it needs a pan-tilt unit


def list_peers() -> tuple[Peer, ...]:
    """Return every peer whose packages are installed."""
    methods = [
        Peer(PINV, fit_pseudo_inverse, f"{NO_OFFSET}, which makes its gain wrong", True),
        Peer("paper, as printed", fit_paper, NO_ROLL, False),
        Peer("paper, interpretation of Table 3", fit_paper_table_3, NO_ROLL, False),
        Peer("angles between rests only", fit_rest_to_rest, NO_OFFSET, False),
        Peer("SciPy, numeric Jacobian", fit_numeric, UNDETECTED, True),
    ]
    if factor_graph.is_installed():
        name = f"GTSAM {factor_graph.read_version()}"
        methods.append(Peer(name, factor_graph.solve, UNNAMED, True))
    return tuple(methods)


def fit_ours(recording: Recording) -> FloatArray:
    """Fit with the whole estimator of this project, including its reference."""
    fit = fit_motion(recording.samples, recording.reference(), UNIT_REMEDIES)
    value = np.concatenate([fit.gain.ravel(), fit.bias_rad_s, [fit.time_offset_s]])
    bias_std = [fit.std[f"bias.{axis}"] for axis in "xyz"]
    return np.stack([value, [*fit.gain_std.ravel(), *bias_std, fit.std["time_offset"]]])


def append_unknown_std(value: FloatArray) -> FloatArray:
    """Return the estimates of a method that states no standard deviation, with NaN."""
    return np.stack([value, np.full(value.size, np.nan)])


def fit_pseudo_inverse(table: Table) -> FloatArray:
    """Fit eq. 7 alone to the integrated rates of both sides, with the bias of the static rest.

    This interpretation is the most favourable one: the real rotation of the stage replaces eq. 12.
    """
    measured_rad, stage_rad = integrate_rates(table)
    gain = gain_by_pseudoinverse(measured_rad.T, stage_rad.T).gain
    return append_unknown_std(np.concatenate([gain.ravel(), _mean_static_rate(table), [np.nan]]))


def integrate_rates(table: Table) -> tuple[FloatArray, FloatArray]:
    """Return the integrals of the measured and reference rates, shape (n - 1, 3) each."""
    both_used = table.use[1:] & table.use[:-1]
    step_s = (np.diff(table.time_s) * both_used)[:, None]
    measured, stage = (
        np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step_s, axis=0)
        for rate in (table.raw_rad_s - _mean_static_rate(table), table.stage_rad_s)
    )
    return measured, stage


def _mean_static_rate(table: Table) -> FloatArray:
    return np.asarray(table.raw_rad_s[table.static].mean(axis=0))


def fit_paper(table: Table, reading: PaperReading | None = None) -> FloatArray:
    """Fit eq. 6 to 12 with the bias of the quasi-static test, as `--method paper` does."""
    calibration = calibrate_as_printed(
        table.time_s, table.raw_rad_s, table.pan_rad, table.tilt_rad, table.static, reading=reading
    )
    return append_unknown_std(
        np.concatenate([calibration.STM.ravel(), calibration.bias_rad_s, [np.nan]])
    )


def fit_paper_table_3(table: Table) -> FloatArray:
    """Fit the same equations, interpreted so that the result has the form of Table 3."""
    return fit_paper(table, READING_OF_TABLE_3)


def fit_numeric(table: Table) -> FloatArray:
    """Fit S, T, M, bias and time offset with SciPy: Levenberg-Marquardt, numeric Jacobian."""
    stage = CubicSpline(table.time_s, table.stage_rad_s)
    time_s, measured = table.time_s[table.use], table.measured_rad_s[table.use]

    def residual(values: FloatArray) -> FloatArray:
        rate = np.asarray(stage(time_s - values[12]))
        return np.asarray((measured - rate @ compose_gain(values[:9]).T - values[9:12]).ravel())

    start = np.concatenate([np.ones(3), np.zeros(10)])
    solution = least_squares(residual, start, method="lm", x_scale="jac")
    # The usual covariance, which assumes that the residuals are white.
    variance = 2.0 * solution.cost / (solution.fun.size - 13)
    jacobian = np.asarray(solution.jac, dtype=np.float64)
    covariance = variance * np.linalg.pinv(jacobian.T @ jacobian)
    derivative = np.zeros((13, 13))
    derivative[9:, 9:] = np.eye(4)
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        change = compose_gain(solution.x[:9] + step) - compose_gain(solution.x[:9] - step)
        derivative[:9, k] = change.ravel() / 2e-6
    value = np.concatenate([compose_gain(solution.x[:9]).ravel(), solution.x[9:]])
    return np.stack([value, np.sqrt(np.diag(derivative @ covariance @ derivative.T))])


def compose_gain(factors: FloatArray) -> FloatArray:
    """Return G = S T M from three scales, three skews and a rotation vector."""
    lower = np.eye(3)
    lower[[1, 2, 2], [0, 0, 1]] = factors[3:6]
    rotation = Rotation.from_rotvec(factors[6:9]).as_matrix()
    return np.asarray(np.diag(factors[:3]) @ lower @ rotation)


def fit_rest_to_rest(table: Table) -> FloatArray:
    """Fit only the rotations from rest to rest, with the code of our second method."""
    path = rest_to_rest.BoardPath(
        time_s=table.time_s,
        rate_rad_s=table.raw_rad_s,
        used=table.use,
        moving=np.linalg.norm(table.stage_rad_s, axis=1) > STILL_RAD_S,
        angles_rad=np.stack([table.pan_rad, table.tilt_rad]),
    )
    static = table.raw_rad_s[table.static]
    turns = rest_to_rest._turns_between_rests(
        path, 2.0 * float(static.var(axis=0).max()) / table.rate_hz, 1e-9
    )
    gain, bias = np.eye(3), static.mean(axis=0)
    for _ in range(ITERATIONS):
        information, score = np.zeros((12, 12)), np.zeros(12)
        for turn in turns:
            residual, jacobian = rest_to_rest._linearise(turn, gain, bias)
            information += jacobian.T @ jacobian / turn.variance_rad2
            score += jacobian.T @ residual / turn.variance_rad2
        decision = analyse_observability(information, rest_to_rest.GAIN_AND_BIAS_NAMES)
        step = decision.pseudo_inverse @ score
        gain, bias = gain + step[:9].reshape(3, 3), bias + step[9:]
    result = np.stack([np.append(gain.ravel(), bias), np.sqrt(np.diag(decision.covariance))])
    result[:, np.diag(decision.unobservable_covariance) > UNOBSERVABLE_VARIANCE] = np.nan
    return np.column_stack([result, [np.nan, np.nan]])
