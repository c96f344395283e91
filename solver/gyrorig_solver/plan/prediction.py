"""Predicted uncertainties of a calibration with a program.

The program is simulated (`program_timeline`). The solver's fit of the motion processes the
simulated replies, and the solver's normal equations give the information. As in a solve, the moves'
start times, speeds and accelerations and the rests' positions within one step are unknowns.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import (
    PARAMETER_NAMES,
    TYPICAL_MOUNT,
    UNIT_REMEDIES,
    ObservabilityAnalysis,
    ObservabilityReport,
    Series,
    analyse_observability,
    choose_grids,
    derive_parameters,
    expected_estimate,
)
from gyrorig_solver.estimate.derived_parameters import DerivedParameters
from gyrorig_solver.estimate.information import add_parameter_noise, motion_information
from gyrorig_solver.estimate.series import MIN_SERIES_BLOCKS
from gyrorig_solver.model import FACTOR_NAMES, GAIN_NAMES, factor_jacobian, factorise
from gyrorig_solver.plan.program_timeline import ProgramTimeline, simulate_program
from gyrorig_solver.plan.sensor_model import SensorModel
from gyrorig_solver.plan.unit_model import UnitModel
from gyrorig_solver.reference import PanTiltReference
from gyrorig_solver.reference.unit.move_fit import fit_moves
from gyrorig_solver.reference.unit.unit_moves import MotionReader

CALIBRATION_PARAMETERS = (*FACTOR_NAMES, *PARAMETER_NAMES[9:])
STATED_PARAMETERS = (*CALIBRATION_PARAMETERS, *GAIN_NAMES)


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedSession:
    """A simulated recording of a program: timeline, sample series and reference."""

    timeline: ProgramTimeline
    series: Series
    reference: PanTiltReference


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """The predicted uncertainties of a calibration with a program."""

    program: MotionProgram
    session: SimulatedSession
    duration_s: float
    move_count: int
    decision: ObservabilityAnalysis  # of gain, bias and time offset
    # predicted standard deviations; the values are those of an ordinary board
    summary: DerivedParameters
    motion_offset_std_s: float  # of the time offset, from the motion alone
    bias_floor_rad_s: FloatArray  # (3,), standard deviation of the mean from noise alone

    @property
    def observability(self) -> ObservabilityReport:
        """The observability of the parameters, as in a calibration."""
        return self.summary.observability

    @property
    def std(self) -> dict[str, float]:
        """Standard uncertainties by parameter name, SI units; nan if not observable."""
        return self.summary.std

    @property
    def gain_std(self) -> FloatArray:
        """Standard uncertainties of the gain's entries, (3, 3); nan if not observable."""
        return self.summary.gain_std

    @property
    def stated_std(self) -> FloatArray:
        """Standard uncertainties of `STATED_PARAMETERS`, (22,); inf if the value is null.

        The entries of the gain count only if a factor is null; otherwise the factors contain them.
        """
        factors = np.array([self.std[name] for name in CALIBRATION_PARAMETERS])
        is_complete = bool(np.isfinite(factors[: len(FACTOR_NAMES)]).all())
        entries = np.full(9, np.inf) if is_complete else self.gain_std.ravel()
        std = np.concatenate([factors, entries])
        return np.where(np.isfinite(std), std, np.inf)

    @property
    def stated_jacobian(self) -> FloatArray:
        """Derivatives of `STATED_PARAMETERS` by gain, bias and time offset, (22, 13)."""
        jacobian = np.eye(len(PARAMETER_NAMES))
        jacobian[:9, :9] = factor_jacobian(
            factorise(expected_estimate(self.decision)[:9].reshape(3, 3))
        )
        return np.vstack([jacobian, np.eye(9, len(PARAMETER_NAMES))])


def predict_program(program: MotionProgram, unit: UnitModel, sensor: SensorModel) -> Prediction:
    """Predict the uncertainties of a calibration with a program.

    Raises:
        UsageError: a step leaves the unit's limits, or the program is too short.
    """
    timeline = simulate_program(program, unit)
    series = _simulated_series(timeline.duration_s, sensor, program.name)
    reference = simulate_reference(timeline, unit)
    information = motion_information(series, reference, sensor.noise, TYPICAL_MOUNT)
    motion_only = analyse_observability(information, PARAMETER_NAMES)
    common_std_s = float(np.hypot(reference.common_shift_std_s, sensor.timestamp_std_s))
    decision = analyse_observability(
        add_parameter_noise(information, 12, common_std_s), PARAMETER_NAMES
    )
    return Prediction(
        program=program,
        session=SimulatedSession(timeline, series, reference),
        duration_s=timeline.duration_s,
        move_count=len(reference.move_fit.moves),
        decision=decision,
        summary=derive_parameters(
            expected_estimate(decision), PARAMETER_NAMES, decision, UNIT_REMEDIES
        ),
        motion_offset_std_s=float(np.sqrt(motion_only.covariance[12, 12])),
        bias_floor_rad_s=np.sqrt(
            sensor.noise.dct_variance(series.block_count)[0] / series.block_count
        ),
    )


def simulate_reference(timeline: ProgramTimeline, unit: UnitModel) -> PanTiltReference:
    """Return the reference motion that the solver would fit from the simulated replies."""
    motion = MotionReader(timeline.settings, (0, 0)).read(timeline.orders)
    polls = timeline.simulate_polls(unit)
    rad_per_step = (unit.pan.step_rad, unit.tilt.step_rad)
    span_s = (0.0, timeline.duration_s)
    return PanTiltReference.of(motion, fit_moves(motion, polls), rad_per_step, span_s)


def _simulated_series(duration_s: float, sensor: SensorModel, name: str) -> Series:
    block, fine = choose_grids(sensor.odr_hz, sensor.bandwidth_hz)
    count = int(duration_s * sensor.odr_hz)
    if count < MIN_SERIES_BLOCKS * block:
        least_s = MIN_SERIES_BLOCKS * block / sensor.odr_hz
        raise UsageError(
            f"the motion program {name} lasts {duration_s:.1f} s, but a calibration needs at least "
            f"{least_s:.1f} s",
            "add rests and moves to the program",
        )
    return Series(
        time_s=np.asarray((np.arange(count) + 0.5) / sensor.odr_hz, dtype=np.float64),
        raw=np.zeros((count, 3)),
        good=np.ones(count, dtype=np.bool_),
        samples_per_block=block,
        intervals_per_sample=fine,
        bandwidth_hz=sensor.bandwidth_hz,
    )
