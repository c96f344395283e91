"""Short noise-free recordings of the rig simulator, with and without a large cause."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT))

from tests.bench.rigs.prior_sizes import HiddenCauses  # noqa: E402
from tests.bench.rigs.rig import SimulatedRig, simulate_rig  # noqa: E402

from gyrorig_protocol.program import MotionProgram, parse_program  # noqa: E402

Record = Callable[..., SimulatedRig]
SHORT_PROGRAM = """
schema: gyrorig/program/1
name: short
settings: {base_speed_deg_s: 3.0, acceleration_deg_s2: 200.0, default_speed_deg_s: 60.0}
steps:
- {rest: {seconds: 0.5}}
- {move: {pan_deg: 60.0}}
- {rest: {seconds: 0.8}}
- {move: {tilt_deg: 25.0}}
- {rest: {seconds: 0.8}}
- {move: {pan_deg: 0.0, speed_deg_s: 40.0}}
- {rest: {seconds: 0.8}}
- {move: {pan_deg: -50.0}}
- {rest: {seconds: 0.8}}
- {move: {pan_deg: 0.0}}
- {rest: {seconds: 0.8}}
"""


def short_program() -> MotionProgram:
    return parse_program(SHORT_PROGRAM, "short")


@pytest.fixture(scope="session")
def record() -> Record:
    """Return a function that simulates the same unit and board with given causes."""

    def simulate(
        causes: Mapping[str, Mapping[str, float]] | None = None, is_noisy: bool = False
    ) -> SimulatedRig:
        rng = np.random.default_rng(8)
        return simulate_rig(0, short_program(), HiddenCauses(causes or {}), rng, is_noisy)

    return simulate


@pytest.fixture(scope="session")
def plain(record: Record) -> SimulatedRig:
    """The recording without a cause."""
    return record()
