"""Gain columns and bias from turns by known angles.

What to use when: `fit_turns` for one board in one or more recordings with `turn` phases;
rests may be in the same recording or in another one of the same board.

Theory of operation. The integral of y - b over a turn about an axis that stands still in
the stage frame is G times axis times angle, whatever the speed was. So each turn gives
three linear equations in a column of G, and each rest three in b. What is uncertain: the
angle (as stated), the axis' direction (a table edge is no spindle: `AXIS_STD_RAD` unless
said otherwise, which tilts the column, not its length), and the bias over the turn. A turn
tells nothing about the columns across its axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.chance import chi2_limit
from gyrorig_solver.estimate.conclusion import NAMES, Evidence, gyro_fit
from gyrorig_solver.estimate.observability import decide
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.model.gain import cross_matrix
from gyrorig_solver.reference.turns import Interval, KnownTurn, TurnReference
from gyrorig_solver.samples import GyroSamples

# How far the true axis may lie from the stated one, per direction: a board held by hand
# against a table's edge (an assumption; a rate table is better by far).
AXIS_STD_RAD = float(np.radians(1.0))
# Bias over a whole rest moves by this much between rests of one session at least: the
# instability of a consumer part over minutes (data sheets say 3 to 10 deg/h and more).
BIAS_FLOOR_RAD_S = float(np.radians(0.003))
ROUNDS = 4
WORDS = {
    "x": "no turn about the stage's x axis; add one",
    "y": "no turn about the stage's y axis; add one",
    "z": "no turn about the stage's z axis; add one",
    "bias": "no rest before, between or after the turns; add a recording at rest",
    "time_offset": "the integral over a whole turn does not depend on it; use a moving reference",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Turned:
    """One turn as the gyro saw it."""

    turn: KnownTurn
    integral: FloatArray  # (3,), rad, bias still in it
    span_s: float


def fit_turns(
    recordings: Sequence[tuple[GyroSamples, TurnReference]], axis_std_rad: float = AXIS_STD_RAD
) -> GyroFit:
    """Calibrate one board by known turns.

    Args:
        recordings: samples and phases of each recording of the board.
        axis_std_rad: of the turns' axes, for each of the two directions across.

    Returns:
        The fit; columns of G that no turn was about are not given.

    Raises:
        InputError: there is no turn, no rest, or no sample in them.
    """
    turned = [_integrate(samples, turn) for samples, found in recordings for turn in found.turns]
    rests = [_rest(samples, over) for samples, found in recordings for over in found.rests]
    if not turned:
        raise InputError(
            "no recording has a turn by a known angle",
            "give its axis and angle under turns in the map of gyrorig import",
        )
    if not rests:
        raise InputError(
            "there is no rest to take the bias from", "add a recording of this board at rest"
        )
    work = _Work(turned, np.array(rests), axis_std_rad)
    work.run()
    spread, freedom = work.spread()
    inflation = max(1.0, spread) if freedom > 0 else 1.0
    evidence = Evidence(
        estimate=work.estimate,
        decision=decide(work.information() / inflation, NAMES),
        reduced_chi2=spread if freedom > 0 else float("nan"),
        chi2_limit=chi2_limit(0.01, freedom) / freedom if freedom > 0 else np.inf,
        outliers=0,
        rms_before_rad_s=work.rms_rad_s(nominal=True),
        rms_after_rad_s=work.rms_rad_s(nominal=False),
        reference=f"{len(turned)} turns by known angles, {len(rests)} rests",
        words=WORDS,
        warnings=_warnings(work, turned[0].turn.std_rad, axis_std_rad, freedom > 0),
    )
    return gyro_fit(evidence, [samples for samples, _ in recordings])


def _warnings(work: "_Work", std_rad: float, axis_std_rad: float, checked: bool) -> tuple[str, ...]:
    said = (
        f"angles and axes are as stated, to {np.degrees(std_rad):.2g} deg and "
        f"{np.degrees(axis_std_rad):.2g} deg: the result is no better than those"
    )
    said += "" if checked else "; nothing in the data checks them"
    hidden = "".join(axis for axis, seen in zip("xyz", work.seen, strict=True) if not seen)
    if not hidden:
        return (said,)
    return said, f"scale and misalignment take unseen columns ({hidden}) as nominal to 0.1"


def _inside(samples: GyroSamples, over: Interval) -> FloatArray:
    tolerance = 0.25 * samples.period_s
    picked = (samples.time_s >= over.begin_s - tolerance) & (
        samples.time_s <= over.end_s + tolerance
    )
    return np.flatnonzero(picked & samples.good).astype(np.float64)


def _integrate(samples: GyroSamples, turn: KnownTurn) -> _Turned:
    index = _inside(samples, turn.over).astype(np.int64)
    if index.size < 8:
        raise InputError(
            f"the turn at {turn.over.begin_s:.1f} s holds {index.size} good samples",
            "move its phase to where the board was turned, or take it out",
        )
    if np.any(np.diff(samples.segment[index]) != 0):
        raise InputError(
            f"the board restarted in the turn at {turn.over.begin_s:.1f} s",
            "check its supply and its cable, and record the turn again",
        )
    time_s, rate = samples.time_s[index], samples.rate_rad_s[index]
    # Half a period more at both ends: n samples stand for n periods.
    whole = np.trapezoid(rate, time_s, axis=0) + 0.5 * samples.period_s * (rate[0] + rate[-1])
    return _Turned(turn, whole, float(time_s[-1] - time_s[0]) + samples.period_s)


def _rest(samples: GyroSamples, over: Interval) -> FloatArray:
    """Return the mean rate of a rest, without the knocks in it."""
    rate = samples.rate_rad_s[_inside(samples, over).astype(np.int64)]
    if len(rate) < 8:
        raise InputError(
            f"the rest at {over.begin_s:.1f} s holds {len(rate)} good samples",
            "let it last longer, or take its phase out",
        )
    middle = np.median(rate, axis=0)
    # Not the median deviation: it is 0 where most samples are one and the same count.
    low, high = np.percentile(rate, (5.0, 95.0), axis=0)
    spread = (high - low) / 3.29 + samples.quantum_rad_s
    near = np.all(np.abs(rate - middle) < 6.0 * spread, axis=1)
    return np.asarray(rate[near].mean(axis=0), dtype=np.float64)


class _Work:
    """Gauss-Newton over (G, b); only the weights depend on G, so it settles at once."""

    def __init__(self, turned: list[_Turned], rests: FloatArray, axis_std_rad: float) -> None:
        self._turned, self._rests = turned, rests
        self._axis_std_rad = axis_std_rad
        scatter = np.std(rests, axis=0, ddof=1) if len(rests) > 1 else np.zeros(3)
        self._rest_std = np.maximum(scatter, BIAS_FLOOR_RAD_S)
        self._gain, self._bias = np.eye(3), rests.mean(axis=0)
        axes = np.array([t.turn.axis for t in turned])
        self.seen = np.linalg.norm(axes, axis=0) > 0.1

    @property
    def estimate(self) -> FloatArray:
        """G, b, and a time offset that is not known, shape (13,)."""
        return np.concatenate([self._gain.ravel(), self._bias, [0.0]])

    def run(self) -> None:
        """Solve, with the weights of the last gain."""
        for _ in range(ROUNDS):
            information, score = self._normal()
            step = decide(information, NAMES).inverse @ score
            self._gain = self._gain + step[:9].reshape(3, 3)
            self._bias = self._bias + step[9:12]

    def information(self) -> FloatArray:
        """Return the information on `NAMES`, shape (13, 13)."""
        return self._normal()[0]

    def spread(self) -> tuple[float, int]:
        """Return the turns' reduced chi-square and its degrees of freedom."""
        total = 0.0
        for one in self._turned:
            left = self._left(one)
            total += float(left @ np.linalg.solve(self._covariance(one), left))
        freedom = 3 * (len(self._turned) - int(self.seen.sum()))
        return (total / freedom if freedom > 0 else 1.0), freedom

    def rms_rad_s(self, nominal: bool) -> float:
        """Return the rms rate error over the turns: left over, or with the nominal gain."""
        gain = np.eye(3) if nominal else self._gain
        errors = [
            (t.integral - self._bias * t.span_s - gain @ t.turn.axis * t.turn.angle_rad) / t.span_s
            for t in self._turned
        ]
        return float(np.sqrt(np.mean(np.square(errors))))

    def _left(self, one: _Turned) -> FloatArray:
        turned = self._gain @ one.turn.axis * one.turn.angle_rad
        return np.asarray(one.integral - self._bias * one.span_s - turned, dtype=np.float64)

    def _covariance(self, one: _Turned) -> FloatArray:
        """Return what a turn's integral may be off by: the angle, the axis, the bias."""
        turn = one.turn
        along = self._gain @ turn.axis
        across = self._gain @ cross_matrix(turn.axis) * turn.angle_rad * self._axis_std_rad
        drift = np.diag((self._rest_std * one.span_s) ** 2)
        return np.asarray(
            np.outer(along, along) * turn.std_rad**2 + across @ across.T + drift, dtype=np.float64
        )

    def _normal(self) -> tuple[FloatArray, FloatArray]:
        information, score = np.zeros((13, 13)), np.zeros(13)
        for one in self._turned:
            jacobian = np.zeros((3, 13))
            for i in range(3):
                jacobian[i, 3 * i : 3 * i + 3] = one.turn.axis * one.turn.angle_rad
                jacobian[i, 9 + i] = one.span_s
            weighed = np.linalg.solve(self._covariance(one), jacobian)
            information += jacobian.T @ weighed
            score += weighed.T @ self._left(one)
        for rest in self._rests:
            information[9:12, 9:12] += np.diag(self._rest_std**-2.0)
            score[9:12] += (rest - self._bias) / self._rest_std**2
        return information, score
