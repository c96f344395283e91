"""Fit of gain columns and bias to turns by known angles.

What to use when: `fit_turns` for one board in one or more recordings with `turn` phases. Rests can
be in the same recording or in another one of the same board.

Theory of operation. The integral of y - b over a turn about an axis that is fixed in the stage
frame is G times axis times angle, at any speed. Each turn therefore gives three linear equations in
a column of G, and each rest three in b. Four quantities are uncertain: the angle (as stated), the
direction of the axis, the bias during the turn, and the noise of turns and rests. The axis at a
table edge is less accurate than a spindle; `AXIS_STD_RAD`, unless stated otherwise, tilts the
column but does not change its length.
A turn has no information about the columns perpendicular to its axis.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.fit_summary import (
    FitOutcome,
    build_gyro_fit,
    warn_of_unchecked_times,
)
from gyrorig_solver.estimate.gyro_fit import GyroFit, RecordingFit
from gyrorig_solver.estimate.information import PARAMETER_NAMES
from gyrorig_solver.estimate.observability import (
    analyse_observability,
    analyse_scaled_observability,
)
from gyrorig_solver.estimate.parameter_layout import (
    SESSION_PARAMETERS,
    ParameterLayout,
    eliminate_parameters,
)
from gyrorig_solver.estimate.rest_mean import RestMean, measure_rest
from gyrorig_solver.estimate.turn_checks import (
    MeasuredTurn,
    check_turn_unit,
    describe_contradiction,
    describe_cut_turns,
    find_reversed_turns,
)
from gyrorig_solver.estimate.turn_integral import IntegratedTurn, integrate_turn
from gyrorig_solver.model import cross_matrix
from gyrorig_solver.numerics import chi2_quantile
from gyrorig_solver.reference import TurnReference

# Difference between true and stated axis, per direction: a board held by hand
# against the edge of a table (an assumption; a rate table is far better).
AXIS_STD_RAD = float(np.radians(1.0))
# Minimum change of the bias between rests of one session: the bias
# instability of a consumer part over minutes (data sheets: 3 to 10 deg/h and more).
MIN_BIAS_STD_RAD_S = float(np.radians(0.003))
# Change of the bias from one recording to another, if it has no rest: the sensor can have been off
# between them. Source: the limit of the bias in `uncertainty/default_settings.yaml`.
POWER_UP_BIAS_STD_RAD_S = float(np.radians(0.1))
MAX_ITERATIONS = 4
REASON_TEXTS = {
    "x": "the recordings have no turn about the x axis of the reference; add one",
    "y": "the recordings have no turn about the y axis of the reference; add one",
    "z": "the recordings have no turn about the z axis of the reference; add one",
    "bias": "the board never rests before, between or after the turns; add a recording at rest",
    "time_offset": (
        "the total angle of a turn does not show the time offset; use a reference that gives the "
        "motion over time"
    ),
}


def fit_turns(recordings: Sequence[tuple[GyroSamples, TurnReference]]) -> GyroFit:
    """Calibrate one board with known turns.

    Args:
        recordings: samples and phases of each recording of the board.

    Returns:
        The fit; it has no columns of G without a turn.

    Raises:
        InputError: there is no turn or no rest, they have no samples, or the rates have a wrong
            unit.
    """
    integrated_turns = [
        integrate_turn(k, samples, turn)
        for k, (samples, reference) in enumerate(recordings)
        for turn in reference.turns
    ]
    rests = [
        [measure_rest(samples, interval) for interval in reference.rests]
        for samples, reference in recordings
    ]
    if not integrated_turns:
        raise InputError(
            "the recordings contain no turn with a known angle",
            "write the axis and angle of each turn under `turns` in the import map, and import the "
            "data again",
        )
    if not any(map(len, rests)):
        raise InputError(
            "the solver estimates the bias at rest, but the board never rests in these recordings",
            "add a recording of this board at rest",
        )
    solver = _TurnSolver(integrated_turns, rests)
    check_turn_unit(solver.measured_turns())
    solver.run()
    reduced_chi2, degrees_of_freedom = solver.reduced_chi2()
    is_tested = degrees_of_freedom > 0
    inflation = max(1.0, reduced_chi2) if is_tested else 1.0
    chi2_limit = (
        chi2_quantile(0.01, degrees_of_freedom) / degrees_of_freedom if is_tested else np.inf
    )
    is_contradiction = is_tested and reduced_chi2 > chi2_limit
    outcome = FitOutcome(
        estimate=solver.estimate,
        observability=analyse_observability(
            solver.information(len(recordings) - 1) / inflation, PARAMETER_NAMES
        ),
        reduced_chi2=reduced_chi2 if is_tested else float("nan"),
        chi2_limit=chi2_limit,
        outliers=0,
        rms_before_rad_s=solver.rms_rad_s(nominal=True),
        rms_after_rad_s=solver.rms_rad_s(nominal=False),
        reference=f"{len(integrated_turns)} turns by known angles, {sum(map(len, rests))} rests",
        reason_texts=REASON_TEXTS | (_contradiction_texts(solver) if is_contradiction else {}),
        warnings=(
            *_warnings(solver, integrated_turns[0].turn.std_rad, is_tested),
            *describe_cut_turns(solver.measured_turns()),
            *warn_of_unchecked_times([samples for samples, _ in recordings]),
        ),
        limited_reasons=_reasons(solver, is_contradiction),
        recordings=solver.recording_fits(inflation) if len(recordings) > 1 else (),
    )
    return build_gyro_fit(outcome, [samples for samples, _ in recordings])


def _reasons(solver: "_TurnSolver", is_contradiction: bool) -> tuple[str, ...]:
    turns = solver.measured_turns()
    contradiction = describe_contradiction(turns, solver.residual_sigma) if is_contradiction else ""
    return tuple(filter(None, (contradiction, find_reversed_turns(turns, solver.gain))))


def _contradiction_texts(solver: "_TurnSolver") -> dict[str, str]:
    """Return why turns about an axis do not determine its column."""
    text = "the stated turns contradict each other; correct them as stated above"
    return {
        axis: text for axis, is_turned in zip("xyz", solver.axis_turned, strict=True) if is_turned
    }


def _warnings(solver: "_TurnSolver", std_rad: float, is_checked: bool) -> tuple[str, ...]:
    text = (
        f"the uncertainties of the stated angles ({np.degrees(std_rad):.2g} deg) and of the stated "
        f"axes ({np.degrees(AXIS_STD_RAD):.2g} deg) limit the accuracy of the result"
    )
    text += "" if is_checked else "; the recordings cannot check these uncertainties"
    unseen_axes = "".join(
        axis for axis, is_turned in zip("xyz", solver.axis_turned, strict=True) if not is_turned
    )
    texts = (text, *_bias_warnings(solver))
    if not unseen_axes:
        return texts
    return *texts, (
        "the board did not turn about all axes. For the columns of the gain without a turn "
        f"({', '.join(unseen_axes)}), the solver assumes the nominal values with an uncertainty of "
        "0.1"
    )


def _bias_warnings(solver: "_TurnSolver") -> Iterator[str]:
    numbers = [str(k + 1) for k, has_rest in enumerate(solver.has_rest) if not has_rest]
    if numbers:
        yield (
            "the board never rests in these recordings, numbered in the given order: "
            f"{', '.join(numbers)}. The solver takes their bias from the rests of the other "
            "recordings, with a standard uncertainty of "
            f"{np.degrees(POWER_UP_BIAS_STD_RAD_S):.2g} deg/s for the change of the bias at a "
            "power-up. A rest in each recording makes the result more accurate"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _BiasAtRest:
    """The bias at the rests of one recording."""

    mean_rad_s: FloatArray  # (3,)
    mean_std_rad_s: FloatArray  # (3,)
    rounding_std_rad_s: FloatArray  # (3,), of the error by rounding that all rests share
    change_std_rad_s: FloatArray  # (3,), of the bias between rests
    angle_variance_rad2_s: FloatArray  # (3,), of the integral of the noise, per second

    @classmethod
    def of(cls, rests: Sequence[RestMean]) -> "_BiasAtRest":
        """Return the weighted mean of at least one rest."""
        rates = np.array([rest.rate_rad_s for rest in rests])
        noise_variances = np.array([rest.noise_std_rad_s for rest in rests]) ** 2
        scatter = np.var(rates, axis=0, ddof=1) if len(rests) > 1 else np.zeros(3)
        change_variance = np.maximum(scatter - noise_variances.mean(axis=0), MIN_BIAS_STD_RAD_S**2)
        weights = 1.0 / (change_variance + noise_variances)
        rounding_std = np.median([rest.rounding_std_rad_s for rest in rests], axis=0)
        return cls(
            mean_rad_s=np.sum(weights * rates, axis=0) / weights.sum(axis=0),
            mean_std_rad_s=np.hypot(weights.sum(axis=0) ** -0.5, rounding_std),
            rounding_std_rad_s=np.asarray(rounding_std, dtype=np.float64),
            change_std_rad_s=np.sqrt(change_variance),
            angle_variance_rad2_s=np.mean([rest.angle_variance_rad2_s for rest in rests], axis=0),
        )

    def after_power_up(self) -> "_BiasAtRest":
        """Return what these rests state of the bias in another recording."""
        std_rad_s = np.hypot(self.mean_std_rad_s, POWER_UP_BIAS_STD_RAD_S)
        return replace(self, mean_std_rad_s=std_rad_s)


class _TurnSolver:
    """Gauss-Newton over G and each recording's b; only the weights depend on G."""

    def __init__(
        self, integrated_turns: list[IntegratedTurn], rests: Sequence[list[RestMean]]
    ) -> None:
        """Start with the nominal gain and the mean rates of the rests.

        Args:
            integrated_turns: of all recordings.
            rests: of each recording. A recording without a rest gets the bias of the others, with
                their scatter and the change at a power-up.
        """
        self._integrated_turns = integrated_turns
        self.has_rest = [len(recording_rests) > 0 for recording_rests in rests]
        pooled = _BiasAtRest.of([rest for recording_rests in rests for rest in recording_rests])
        self._layout = ParameterLayout.of([()], len(rests))
        self._biases_at_rest = [
            _BiasAtRest.of(recording_rests) if recording_rests else pooled.after_power_up()
            for recording_rests in rests
        ]
        self.gain = np.eye(3)
        self._biases = np.array([bias.mean_rad_s for bias in self._biases_at_rest])
        axes = np.array([integrated.turn.axis for integrated in integrated_turns])
        self.axis_turned = np.linalg.norm(axes, axis=0) > 0.1

    @property
    def estimate(self) -> FloatArray:
        """G, b of the last recording, and an unknown time offset, shape (13,)."""
        return np.concatenate([self.gain.ravel(), self._biases[-1], [0.0]])

    def measured_turns(self) -> list[MeasuredTurn]:
        """Return what the gyro shows of each turn."""
        return [self._measured_turn(integrated) for integrated in self._integrated_turns]

    @property
    def residual_sigma(self) -> list[float]:
        """The residual of each turn, in its standard deviations."""
        return [float(np.sqrt(self._chi2(integrated))) for integrated in self._integrated_turns]

    def run(self) -> None:
        """Solve with the weights of the last gain."""
        for _ in range(MAX_ITERATIONS):
            information, score = self._normal_equations()
            step = (
                analyse_scaled_observability(information, self._layout.prior_std).pseudo_inverse
                @ score
            )
            self.gain = self.gain + step[:9].reshape(3, 3)
            self._biases = self._biases + step[9:].reshape(-1, SESSION_PARAMETERS)[:, :3]

    def information(self, recording: int) -> FloatArray:
        """Return the information on G and one recording's (b, tau), shape (13, 13)."""
        information = eliminate_parameters(
            self._normal_equations()[0], self._layout.index(recording), self._layout.prior_std
        )
        return _limit_bias(information, self._biases_at_rest[recording].rounding_std_rad_s)

    def recording_fits(self, inflation: float) -> tuple[RecordingFit, ...]:
        """Return the bias of each recording."""
        fits = []
        for k, bias in enumerate(self._biases):
            analysis = analyse_observability(self.information(k) / inflation, PARAMETER_NAMES)
            std = np.sqrt(np.diag(analysis.covariance)[9:12])
            fits.append(RecordingFit(bias, std, float("nan"), float("nan")))
        return tuple(fits)

    def reduced_chi2(self) -> tuple[float, int]:
        """Return the turns' reduced chi-square and its degrees of freedom."""
        total = sum(map(self._chi2, self._integrated_turns))
        degrees_of_freedom = 3 * (len(self._integrated_turns) - int(self.axis_turned.sum()))
        return (total / degrees_of_freedom if degrees_of_freedom > 0 else 1.0), degrees_of_freedom

    def rms_rad_s(self, nominal: bool) -> float:
        """Return the rms rate error over the turns, fitted or with the nominal gain."""
        gain = np.eye(3) if nominal else self.gain
        errors = [
            (
                integrated.integral
                - self._biases[integrated.recording] * integrated.span_s
                - gain @ integrated.turn.axis * integrated.turn.angle_rad
            )
            / integrated.span_s
            for integrated in self._integrated_turns
        ]
        return float(np.sqrt(np.mean(np.square(errors))))

    def _measured_turn(self, integrated: IntegratedTurn) -> MeasuredTurn:
        turn = integrated.turn
        # Contradicting turns shift the fitted bias.
        bias = self._biases_at_rest[integrated.recording].mean_rad_s
        edge_rates = np.linalg.norm(integrated.edge_rate_rad_s - bias, axis=1)
        return MeasuredTurn(
            begin_s=turn.interval.begin_s,
            axis=turn.axis,
            angle_rad=turn.angle_rad,
            std_rad=turn.std_rad,
            rotation_rad=np.asarray(integrated.integral - bias * integrated.span_s, np.float64),
            edge_rad=float(edge_rates.max()) * integrated.period_s,
        )

    def _chi2(self, integrated: IntegratedTurn) -> float:
        residual = self._residual(integrated)
        return float(residual @ np.linalg.solve(self._covariance(integrated), residual))

    def _residual(self, integrated: IntegratedTurn) -> FloatArray:
        predicted = self.gain @ integrated.turn.axis * integrated.turn.angle_rad
        bias = self._biases[integrated.recording]
        return np.asarray(integrated.integral - bias * integrated.span_s - predicted, np.float64)

    def _covariance(self, integrated: IntegratedTurn) -> FloatArray:
        """Return the covariance of a turn's integral: angle, axis, change of the bias, noise."""
        turn = integrated.turn
        by_angle = self.gain @ turn.axis
        by_axis = self.gain @ cross_matrix(turn.axis) * turn.angle_rad * AXIS_STD_RAD
        at_rest = self._biases_at_rest[integrated.recording]
        by_bias = (at_rest.change_std_rad_s * integrated.span_s) ** 2
        by_noise = at_rest.angle_variance_rad2_s * integrated.span_s
        return np.asarray(
            np.outer(by_angle, by_angle) * turn.std_rad**2
            + by_axis @ by_axis.T
            + np.diag(by_bias + by_noise),
            dtype=np.float64,
        )

    def _normal_equations(self) -> tuple[FloatArray, FloatArray]:
        size = self._layout.size
        information, score = np.zeros((size, size)), np.zeros(size)
        for integrated in self._integrated_turns:
            jacobian = np.zeros((3, size))
            index = self._layout.index(integrated.recording)
            for i in range(3):
                jacobian[i, index[3 * i : 3 * i + 3]] = (
                    integrated.turn.axis * integrated.turn.angle_rad
                )
                jacobian[i, index[9 + i]] = integrated.span_s
            weighted = np.linalg.solve(self._covariance(integrated), jacobian)
            information += jacobian.T @ weighted
            score += weighted.T @ self._residual(integrated)
        for k, at_rest in enumerate(self._biases_at_rest):
            bias = self._layout.index(k)[9:12]
            information[bias, bias] += at_rest.mean_std_rad_s**-2.0
            score[bias] += (at_rest.mean_rad_s - self._biases[k]) / at_rest.mean_std_rad_s**2
        return information, score


def _limit_bias(information: FloatArray, least_std_rad_s: FloatArray) -> FloatArray:
    """Return the information, with a standard uncertainty of the bias by rounding or more.

    An axis across a turn measures the same rate as at rest, with the same error by rounding. The
    turns therefore do not reduce it. This adds a diagonal matrix to the covariance (Woodbury).
    """
    bias = slice(9, 12)
    variance = np.diag(analyse_observability(information, PARAMETER_NAMES).covariance)[bias]
    added_std = np.sqrt(np.maximum(least_std_rad_s**2 - variance, 0.0))
    scaled = added_std[:, None] * information[bias]
    inner = np.eye(3) + scaled[:, bias] * added_std
    return np.asarray(information - scaled.T @ np.linalg.solve(inner, scaled), dtype=np.float64)
