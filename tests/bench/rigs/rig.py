"""One simulated rig: everything drawn from a seed, its recording, and its true parameters."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path as File
from typing import Any

import numpy as np
from tests.bench.accuracy.board import factors
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.gyroscope import Gyroscope, draw_gyroscope
from tests.bench.rigs.prior_sizes import HiddenCauses, draw_causes, draw_persistent_causes
from tests.bench.rigs.samples import BoardStream, StreamTruth, record_board
from tests.bench.rigs.serial_session import SerialSession, run_program
from tests.bench.rigs.stage_motion import StageMotion, StepTracks, stage_motion, step_tracks

from gyrorig_protocol.program import MotionProgram, parse_program

PROGRAMS = File(__file__).resolve().parents[3] / "config" / "programs"
# Name and how often it is drawn; the long one costs most.
PROGRAM_SHARES = (
    ("survey-40.yaml", 0.3),
    ("planned-75.yaml", 0.3),
    ("survey-130.yaml", 0.3),
    ("planned-300.yaml", 0.1),
)
MOST_CAUSES = 4
FINE_HZ = 4000.0
MARGIN_S = 1.0  # of the grid before and after the session
SAMPLES_AFTER_S, SAMPLES_BEFORE_S = 0.4, 0.4  # of the session's begin and end
LEAN_STD_RAD = float(np.radians(0.3))  # of the base
BAUDS = (115200.0, 115200.0, 57600.0, 9600.0)
COUNTER_SHARE = 0.7  # of the units whose replies have the controller's counter


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRig:
    """One rig and its session."""

    seed: int
    program: MotionProgram
    causes: HiddenCauses
    baud: float
    has_counter: bool
    session: SerialSession
    tracks: StepTracks
    motion: StageMotion
    gyroscope: Gyroscope
    stream: BoardStream
    stream_truth: StreamTruth
    counter_start: int
    counter_skew: float

    @property
    def truth(self) -> FloatArray:
        """True parameters in the order of `tests.bench.accuracy.board.NAMES`.

        The bias is the mean reading at rest over the recording; see also `stated_truth`. With a
        board slip the sensor matrix is the one before it.
        """
        return np.concatenate(
            [
                self.stream_truth.rest_bias_rad_s,
                factors(self.gyroscope.gain),
                [self.stream_truth.delay_s],
            ]
        )

    def description(self) -> dict[str, Any]:
        """Return what was drawn, ready for JSON."""
        return {
            "seed": self.seed,
            "program": self.program.name,
            "duration_s": round(self.session.end_s, 1),
            "rate_hz": self.gyroscope.nominal_hz,
            "bandwidth_hz": self.gyroscope.bandwidth_hz,
            "baud": self.baud,
            "counter": self.has_counter,
            "soak_k": self.gyroscope.warming.soak_k,
            "causes": {name: dict(sizes) for name, sizes in self.causes.values.items()},
        }


def draw_rig(seed: int, is_persistent: bool = False) -> SimulatedRig:
    """Return the rig of a seed with 0 to 4 causes, or with every persistent cause."""
    rng = np.random.default_rng([20_261, int(is_persistent), seed])
    if is_persistent:
        causes = draw_persistent_causes(rng)
    else:
        causes = draw_causes(int(rng.integers(MOST_CAUSES + 1)), rng)
    index = rng.choice(len(PROGRAM_SHARES), p=[share for _, share in PROGRAM_SHARES])
    program = PROGRAM_SHARES[int(index)][0]
    return simulate_rig(seed, read_program(program), causes, rng)


def simulate_rig(
    seed: int,
    program: MotionProgram,
    causes: HiddenCauses,
    rng: np.random.Generator,
    is_noisy: bool = True,
) -> SimulatedRig:
    """Return a rig with these causes; the rest is drawn from `rng`.

    Unit and board draw from separate streams: a cause of one does not change the other's draws.
    """
    unit_rng, board_rng, sample_rng = rng.spawn(3)
    baud = float(rng.choice(BAUDS))
    has_counter = bool(rng.uniform() < COUNTER_SHARE)
    session = run_program(program, causes, baud, has_counter, unit_rng)
    span_s = (SAMPLES_AFTER_S, session.end_s - SAMPLES_BEFORE_S)
    cells = int((session.end_s + 2.0 * MARGIN_S) * FINE_HZ)
    edges_s = -MARGIN_S + np.arange(cells + 1) / FINE_HZ
    tracks = step_tracks(session, causes, edges_s)
    lean = rng.normal(scale=LEAN_STD_RAD, size=2)
    motion = stage_motion(tracks, causes, span_s, lean)
    gyroscope = draw_gyroscope(board_rng, causes)
    stream, truth = record_board(gyroscope, motion, causes, span_s, sample_rng, is_noisy)
    return SimulatedRig(
        seed=seed,
        program=program,
        causes=causes,
        baud=baud,
        has_counter=has_counter,
        session=session,
        tracks=tracks,
        motion=motion,
        gyroscope=gyroscope,
        stream=stream,
        stream_truth=truth,
        counter_start=int(rng.integers(2**32)),
        counter_skew=float(rng.normal(scale=2e-5)),
    )


@cache
def read_program(name: str) -> MotionProgram:
    """Return a shipped program."""
    return parse_program((PROGRAMS / name).read_text(encoding="utf-8"), name)
