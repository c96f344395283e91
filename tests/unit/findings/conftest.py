"""Findings by hand: one cause of the unit, one fault of the stream, a rest, limits."""

import numpy as np
import pytest

from gyrorig_solver.data.stream.count_stream import CheckResult, StreamFinding
from gyrorig_solver.discover import CauseFindings, HeldOutGain, NamedCause
from gyrorig_solver.discover.cause_findings import (
    CalibrationChange,
    ConfidenceInterval,
    DependenceTest,
    DetectionLimit,
    FittedValue,
    RivalCause,
    UnexplainedResidual,
    UntestableCause,
)
from gyrorig_solver.estimate import FittedTerm
from gyrorig_solver.findings.findings_builder import FindingsOrigin, RawChecks
from gyrorig_solver.findings.findings_document import BoardEntry, InputEntry
from gyrorig_solver.model import find_term

GAIN = HeldOutGain(
    how="every other cycle left out",
    log_likelihood=ConfidenceInterval(37.5, 20.25, 54.75),
    rms_before=0.0125,
    rms_after=0.00625,
    turn_error_before_rad=0.002,
    turn_error_after_rad=0.0005,
    rms_change=ConfidenceInterval(-0.00625, -0.007, -0.0055),
)
CHANGES = (
    CalibrationChange("scale.z", 1.03125, 1.03, 0.0005, "1"),
    CalibrationChange("misalignment.x", 0.0125, 0.012, 0.001, "rad"),
)


@pytest.fixture
def findings() -> CauseFindings:
    """A search that named the play of tilt's gears, and something is left."""
    play = find_term("backlash")
    named = NamedCause(
        term=play,
        where=("tilt",),
        extension=FittedTerm(play, np.array([0.0, 0.001, 0.0, 1.0]), np.array([1])),
        values=(FittedValue("gap.tilt", 0.001, 0.0001, "rad", 0.00087),),
        statistic=84.25,
        degrees_of_freedom=1,
        p_value=1e-19,
        posterior=0.97,
        one_of=(),
        rivals=(RivalCause("base_compliance", -31.0, 0.001, "it comes after reversals only"),),
        changes=CHANGES,
        gain=GAIN,
    )
    rest = DependenceTest("pan_angle", "on pan (the gain changes)", 60.0, 24, 1e-4)
    return CauseFindings(
        verdict="unexplained",
        causes=(named,),
        unexplained=UnexplainedResidual(
            rest, (DependenceTest("line", "on a line", 30.0, 2, 1e-3),), 0.9
        ),
        dependence_tests=(rest,),
        detection_limits=(
            DetectionLimit("tilt_sag", None, 0.0014, "rad", 0.0017, "scale.z", 36.0),
        ),
        untestable=(UntestableCause("thermal_bias", None, "it warmed by 0.3 K only; heat it"),),
        base_terms=("bias", "scale", "nonorthogonality", "misalignment", "time_offset"),
        base_reduced_chi2=3.25,
        base_whiteness_p=1e-12,
        gain=GAIN,
        changes=CHANGES,
        duration_s=5.0,
    )


@pytest.fixture
def raw() -> list[RawChecks]:
    """Two recordings: repeats in both, nothing else."""
    again = StreamFinding(
        "repeated_samples", "clock", (), 60, 12_000, 1e-30, "share", 0.005, "1",
        "60 of 12000 samples (0.5 %) repeat the one before", "read it at data-ready",
    )  # fmt: skip
    looks = (
        CheckResult("repeated samples", again.seen_as, (again,)),
        CheckResult("damaged words", "none among 36000 words"),
    )
    return [RawChecks("monday.mcap", looks), RawChecks("friday.mcap", looks)]


@pytest.fixture
def origin() -> FindingsOrigin:
    """One board, two recordings."""
    return FindingsOrigin(
        board=BoardEntry("GY80-0007", "L3G4200D"),
        recordings=[InputEntry("monday.mcap", "ab" * 32), InputEntry("friday.mcap", "cd" * 32)],
        created="2026-01-31T02:30:00Z",
        software="0.1.0",
    )
