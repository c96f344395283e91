"""The methods, one function each: a table of both sides in, a gain, a bias and an offset out.

What to use when: `peers` for all that run here, `ours` for the fit they stand beside. Each peer
is written as its own users would write it. Each returns two rows of 13, in the order of
`Recording.truth`: what it found, and the standard deviations that it states; nan stands for
what it does not estimate, or does not state.
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
ROUNDS = 3  # of Gauss-Newton; two are enough
HIDDEN = 1e-6  # variance in hidden directions from which an entry has no value
OURS = "gyrorig"
PINV = "eq. 7 (pseudo-inverse) of integrated body rates"
NO_OFFSET = "does not estimate the time offset"
NO_ROLL = "estimates neither roll nor the time offset"
UNDETECTED = "does not detect that a column is unobservable"
UNNAMED = "does not report which column is unobservable"


@dataclass(frozen=True, slots=True, eq=False)
class Peer:
    """One other way of calibrating."""

    name: str
    run: Callable[[Table], FloatArray]
    limitation: str  # what it does not estimate or report, in words
    any_reference: bool  # False: it wants a pan-tilt unit


def peers() -> tuple[Peer, ...]:
    """Every peer that runs here."""
    methods = [
        Peer(PINV, pinv, f"{NO_OFFSET}, which makes its gain wrong", True),
        Peer("paper, as printed", paper, NO_ROLL, False),
        Peer("paper, interpretation of Table 3", paper_as_tabled, NO_ROLL, False),
        Peer("angles between rests only", rests_only, NO_OFFSET, False),
        Peer("SciPy, numeric Jacobian", numeric, UNDETECTED, True),
    ]
    if factor_graph.installed():
        named = f"GTSAM {factor_graph.version()}"
        methods.append(Peer(named, factor_graph.solve, UNNAMED, True))
    return tuple(methods)


def ours(recording: Recording) -> FloatArray:
    """The whole fit, its reference made of the orders and answers."""
    fit = fit_motion(recording.samples, recording.reference(), UNIT_REMEDIES)
    value = np.concatenate([fit.gain.ravel(), fit.bias_rad_s, [fit.time_offset_s]])
    bias_std = [fit.std[f"bias.{axis}"] for axis in "xyz"]
    return np.stack([value, [*fit.gain_std.ravel(), *bias_std, fit.std["time_offset"]]])


def unstated(value: FloatArray) -> FloatArray:
    """Return a value whose method states no standard deviation."""
    return np.stack([value, np.full(value.size, np.nan)])


def pinv(table: Table) -> FloatArray:
    """Eq. 7 alone, on integrated rates of both sides, with the bias of the static rest.

    The friendliest reading: eq. 12 is replaced by what the stage really turned.
    """
    measured_rad, stage_rad = integrated(table)
    gain = gain_by_pseudoinverse(measured_rad.T, stage_rad.T).gain
    return unstated(np.concatenate([gain.ravel(), _static_bias(table), [np.nan]]))


def integrated(table: Table) -> tuple[FloatArray, FloatArray]:
    """Return the integrals of both sides' rates, shape (n - 1, 3) each."""
    both = table.use[1:] & table.use[:-1]
    step_s = (np.diff(table.time_s) * both)[:, None]
    measured, stage = (
        np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step_s, axis=0)
        for rate in (table.raw_rad_s - _static_bias(table), table.stage_rad_s)
    )
    return measured, stage


def _static_bias(table: Table) -> FloatArray:
    return np.asarray(table.raw_rad_s[table.static].mean(axis=0))


def paper(table: Table, reading: PaperReading | None = None) -> FloatArray:
    """Eq. 6 to 12 with the bias of the quasi-static test, as `--method paper` runs them."""
    calibration = calibrate_as_printed(
        table.time_s, table.raw_rad_s, table.pan_rad, table.tilt_rad, table.static, reading=reading
    )
    return unstated(np.concatenate([calibration.STM.ravel(), calibration.bias_rad_s, [np.nan]]))


def paper_as_tabled(table: Table) -> FloatArray:
    """The same read so that its result has the form of the paper's Table 3."""
    return paper(table, READING_OF_TABLE_3)


def numeric(table: Table) -> FloatArray:
    """SciPy's Levenberg-Marquardt with a numeric Jacobian: S, T, M, bias and offset."""
    stage = CubicSpline(table.time_s, table.stage_rad_s)
    time_s, measured = table.time_s[table.use], table.measured_rad_s[table.use]

    def residual(values: FloatArray) -> FloatArray:
        turned = np.asarray(stage(time_s - values[12]))
        return np.asarray((measured - turned @ as_gain(values[:9]).T - values[9:12]).ravel())

    start = np.concatenate([np.ones(3), np.zeros(10)])
    solution = least_squares(residual, start, method="lm", x_scale="jac")
    # Its covariance as everybody makes it: the residual taken for white.
    white = 2.0 * solution.cost / (solution.fun.size - 13)
    jacobian = np.asarray(solution.jac, dtype=np.float64)
    covariance = white * np.linalg.pinv(jacobian.T @ jacobian)
    turn = np.zeros((13, 13))
    turn[9:, 9:] = np.eye(4)
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        change = as_gain(solution.x[:9] + step) - as_gain(solution.x[:9] - step)
        turn[:9, k] = change.ravel() / 2e-6
    value = np.concatenate([as_gain(solution.x[:9]).ravel(), solution.x[9:]])
    return np.stack([value, np.sqrt(np.diag(turn @ covariance @ turn.T))])


def as_gain(factors: FloatArray) -> FloatArray:
    """G = S T M of three scales, three skews and a rotation vector."""
    lower = np.eye(3)
    lower[[1, 2, 2], [0, 0, 1]] = factors[3:6]
    turn = Rotation.from_rotvec(factors[6:9]).as_matrix()
    return np.asarray(np.diag(factors[:3]) @ lower @ turn)


def rests_only(table: Table) -> FloatArray:
    """Our second opinion as the only estimator: what turned from rest to rest."""
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
    for _ in range(ROUNDS):
        information, score = np.zeros((12, 12)), np.zeros(12)
        for turn in turns:
            left, jacobian = rest_to_rest._linearise(turn, gain, bias)
            information += jacobian.T @ jacobian / turn.variance_rad2
            score += jacobian.T @ left / turn.variance_rad2
        decision = analyse_observability(information, rest_to_rest.GAIN_AND_BIAS_NAMES)
        step = decision.pseudo_inverse @ score
        gain, bias = gain + step[:9].reshape(3, 3), bias + step[9:]
    result = np.stack([np.append(gain.ravel(), bias), np.sqrt(np.diag(decision.covariance))])
    result[:, np.diag(decision.unobservable_covariance) > HIDDEN] = np.nan
    return np.column_stack([result, [np.nan, np.nan]])
