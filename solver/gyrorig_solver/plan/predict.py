"""What a program will tell about a board: standard deviations before any motor moves.

The program is carried out on paper (`timeline`), its answers go through the solver's own
fit of the motion, and the solver's own normal equations give the information: starts,
rests within their steps, speeds and accelerations are unknowns here as they are there.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import MotionProgram
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.information import NAMES, loosened, motion_information
from gyrorig_solver.estimate.observability import Concluded, Decision, conclude, decide, prior_std
from gyrorig_solver.estimate.result import Observability
from gyrorig_solver.estimate.series import SHORTEST_SERIES, Series, grids
from gyrorig_solver.model.gain import FACTOR_NAMES, factor_jacobian, factorise
from gyrorig_solver.on_unit import PTU_WORDS
from gyrorig_solver.plan.sensor import MOUNT, SensorModel
from gyrorig_solver.plan.timeline import Timeline, lay_out
from gyrorig_solver.plan.unit import ARCSEC_PER_DEG, UnitModel
from gyrorig_solver.reference.moves import MotionReader
from gyrorig_solver.reference.polls import fit_starts
from gyrorig_solver.reference.ptu import PtuReference

ORDINARY = np.concatenate([MOUNT.ravel(), np.zeros(4)])
PARAMETERS = (*FACTOR_NAMES, *NAMES[9:])
NOMINAL = np.concatenate([np.eye(3).ravel(), np.zeros(4)])


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsal:
    """A program carried out on paper: what the solver would have of it."""

    timeline: Timeline
    series: Series
    reference: PtuReference


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What a calibration made with a program would say of itself."""

    program: MotionProgram
    made: Rehearsal
    duration_s: float
    moves: int
    decision: Decision  # what is seen of gain, bias and time offset
    concluded: Concluded  # standard deviations are predicted, values an ordinary board's
    motion_offset_std_s: float  # of the time offset, from the motion alone
    bias_floor_rad_s: FloatArray  # (3,), what the noise alone leaves of the mean

    @property
    def observability(self) -> Observability:
        """As in the calibration."""
        return self.concluded.observability

    @property
    def std(self) -> dict[str, float]:
        """By the names of the calibration, in its units; nan where it cannot be shown."""
        return self.concluded.std

    @property
    def gain_std(self) -> FloatArray:
        """Of the gain's entries, shape (3, 3); nan where they cannot be shown."""
        return self.concluded.gain_std

    @property
    def by_name(self) -> FloatArray:
        """How `PARAMETERS` change with gain, bias and time offset, shape (13, 13)."""
        found = np.eye(len(NAMES))
        found[:9, :9] = factor_jacobian(factorise(_found(self.decision)[:9].reshape(3, 3)))
        return found


def predict(program: MotionProgram, unit: UnitModel, sensor: SensorModel) -> Prediction:
    """Return what a program will tell about a sensor on a unit.

    Raises:
        UsageError: a step leaves the unit's limits, or the program is too short.
    """
    timeline = lay_out(program, unit)
    series = _series(timeline.duration_s, sensor, program.name)
    reference = reference_of(timeline, unit)
    information = motion_information(series, reference, sensor.noise, MOUNT)
    alone = decide(information, NAMES)
    common_s = float(np.hypot(reference.common_std_s, sensor.stamp_std_s))
    decision = decide(loosened(information, 12, common_s), NAMES)
    return Prediction(
        program=program,
        made=Rehearsal(timeline, series, reference),
        duration_s=timeline.duration_s,
        moves=len(reference.starts.moves),
        decision=decision,
        concluded=conclude(_found(decision), NAMES, decision, PTU_WORDS),
        motion_offset_std_s=float(np.sqrt(alone.covariance[12, 12])),
        bias_floor_rad_s=np.sqrt(sensor.noise.variance(series.blocks)[0] / series.blocks),
    )


def reference_of(timeline: Timeline, unit: UnitModel) -> PtuReference:
    """Return the motion as the solver will know it from the answers."""
    motion = MotionReader(timeline.settings, timeline.start_steps).read(timeline.exchanges)
    polls = timeline.polls(unit)
    pan, tilt = (np.radians(axis.resolution_arcsec / ARCSEC_PER_DEG) for axis in unit.axes)
    span_s = (0.0, timeline.duration_s)
    return PtuReference.of(motion, fit_starts(motion, polls), (float(pan), float(tilt)), span_s)


def _found(decision: Decision) -> FloatArray:
    """Return what a fit of an ordinary board finds: what it cannot see stays nominal."""
    unseen = decision.hidden @ ((ORDINARY - NOMINAL) / prior_std(NAMES) ** 2)
    return np.asarray(ORDINARY - unseen, dtype=np.float64)


def _series(duration_s: float, sensor: SensorModel, name: str) -> Series:
    block, fine = grids(sensor.odr_hz, sensor.bandwidth_hz)
    count = int(duration_s * sensor.odr_hz)
    if count < SHORTEST_SERIES * block:
        least_s = SHORTEST_SERIES * block / sensor.odr_hz
        raise UsageError(
            f"{name} lasts {duration_s:.1f} s, and a calibration needs {least_s:.1f} s",
            "give it more rests and moves",
        )
    return Series(
        time_s=np.asarray((np.arange(count) + 0.5) / sensor.odr_hz, dtype=np.float64),
        raw=np.zeros((count, 3)),
        good=np.ones(count, dtype=np.bool_),
        block=block,
        fine=fine,
        bandwidth_hz=sensor.bandwidth_hz,
    )
