"""What the solver is given: samples, an exact reference, or a unit's orders and answers.

The only module here that knows the solver's types.
"""

from dataclasses import dataclass

import numpy as np
from tests.bench.accuracy.board import Board, Counts
from tests.bench.accuracy.profile import RAD_PER_STEP, FloatArray, Path
from tests.bench.accuracy.unit import COUNTER_HZ, Session

from gyrorig_solver.data.clocks.clock_map import ClockMap
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.numerics import ArrowheadMatrix
from gyrorig_solver.reference import ReferenceMotion
from gyrorig_solver.reference.reference_motion import EvaluatedMotion
from gyrorig_solver.reference.unit.controller_counter import counter_instants
from gyrorig_solver.reference.unit.move_fit import UnitPolls
from gyrorig_solver.reference.unit.pan_tilt_recording import choose_reference
from gyrorig_solver.reference.unit.recorded_orders import UnitExchange, translate_exchanges
from gyrorig_solver.reference.unit.unit_moves import MotionReader


@dataclass(frozen=True, slots=True, eq=False)
class ExactReference:
    """A stage whose motion is known; nothing of it is left to be fitted."""

    path: Path

    @property
    def description(self) -> str:
        """One sentence: what the rates are compared with."""
        return "the simulated motion itself"

    @property
    def information(self) -> ArrowheadMatrix:
        """There are no unknowns."""
        return ArrowheadMatrix.zero(0, 0)

    @property
    def prior_offset(self) -> FloatArray:
        """There are no unknowns."""
        return np.zeros(0)

    @property
    def common_shift_std_s(self) -> float:
        """Its times are exact."""
        return 0.0

    @property
    def is_differentiated(self) -> bool:
        """False: the motion is exact."""
        return False

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> EvaluatedMotion:
        """Return the mean stage rate between consecutive times."""
        del derivatives
        rate = self.path.mean_rate_rad_s(edges_s)
        return EvaluatedMotion(rate, (), np.zeros((0, edges_s.size - 1, 3)))

    def with_step(self, step: FloatArray) -> "ExactReference":
        """Return the same: there is nothing to change."""
        del step
        return self


def answered_reference(session: Session) -> ReferenceMotion:
    """Return the reference that the solver makes of a unit's orders and answers."""
    answers = session.answers
    valid = np.column_stack([answers.axis == 0, answers.axis == 1])
    steps = np.column_stack([np.where(valid[:, k], answers.steps, 0.0) for k in (0, 1)])
    polls = UnitPolls(answers.lo_s, answers.hi_s, steps, valid)
    if answers.ticks is not None:
        instants = counter_instants(
            answers.ticks[::2], polls.earliest_s[::2], polls.latest_s[::2], COUNTER_HZ
        )
        if instants is not None:
            at_s = np.repeat(instants.at_s, 2)
            polls = UnitPolls(at_s, at_s, steps, valid, instants.width_s)
    exchanges = [
        UnitExchange(command, answered, True, text) for command, answered, text in session.orders
    ]
    motion = MotionReader(session.settings, (0, 0), polls.count_at_rest).read(
        translate_exchanges(exchanges)
    )
    return choose_reference(motion, polls, (RAD_PER_STEP, RAD_PER_STEP))


def samples_of(board: Board, counts: Counts) -> GyroSamples:
    """Return the samples as loaded from a recording whose clock is known."""
    n = counts.time_s.size
    segment, number = np.zeros(n, dtype=np.int64), np.arange(n)
    clock = ClockMap(
        time_s=counts.time_s,
        segment=segment,
        late=np.zeros(n, dtype=np.bool_),
        skew_ppm=0.0,
        wander_bound_s=0.0,
        latency_s=np.zeros(3),
        restarts=0,
        wraps=0,
    )
    return GyroSamples(
        board="simulated",
        metadata={"bandwidth_hz": repr(board.bandwidth_hz)},
        origin_ns=0,
        time_s=counts.time_s,
        host_s=counts.time_s,
        number=number,
        segment=segment,
        rate_rad_s=counts.rate_rad_s,
        usable=np.ones(n, dtype=np.bool_),
        accel_m_s2=None,
        temperature_degc=None,
        quantum_rad_s=board.levels[0].quantum_rad_s,
        clock=clock,
        latency_bounds=None,
        lost=0,
        repeated=0,
        late=0,
    )
