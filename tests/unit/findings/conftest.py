"""Findings by hand: one cause of the unit, one fault of the stream, a rest, limits."""

import numpy as np
import pytest

from gyrorig_solver.discover.result import (
    CalibrationChange,
    Findings,
    Gain,
    Interval,
    Limit,
    NamedCause,
    NotTestable,
    Rival,
    Signature,
    Unexplained,
    Value,
)
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.findings.build import Origin, RawEvidence
from gyrorig_solver.findings.document import Input, Subject
from gyrorig_solver.model.terms.catalogue import term
from gyrorig_solver.raw.result import Look, RawFinding

GAIN = Gain(
    how="every other cycle left out",
    log_likelihood=Interval(37.5, 20.25, 54.75),
    rms_before=0.0125,
    rms_after=0.00625,
    turn_error_before_rad=0.002,
    turn_error_after_rad=0.0005,
    rms_change=Interval(-0.00625, -0.007, -0.0055),
)
CHANGES = (
    CalibrationChange("scale.z", 1.03125, 1.03, 0.0005, "1"),
    CalibrationChange("misalignment.x", 0.0125, 0.012, 0.001, "rad"),
)


@pytest.fixture
def findings() -> Findings:
    """A search that named the play of tilt's gears, and something is left."""
    play = term("backlash")
    named = NamedCause(
        term=play,
        where=("tilt",),
        extension=Extension(play, np.array([0.0, 0.001, 0.0, 1.0]), np.array([1])),
        values=(Value("gap.tilt", 0.001, 0.0001, "rad", 0.00087),),
        statistic=84.25,
        degrees_of_freedom=1,
        p_value=1e-19,
        posterior=0.97,
        one_of=(),
        rivals=(Rival("base_compliance", -31.0, 0.001, "it comes after reversals only"),),
        changes=CHANGES,
        gain=GAIN,
    )
    rest = Signature("pan_angle", "on pan, as a gain", 60.0, 24, 1e-4)
    return Findings(
        verdict="unexplained",
        causes=(named,),
        unexplained=Unexplained(rest, (Signature("line", "on a line", 30.0, 2, 1e-3),), 0.9),
        signatures=(rest,),
        absent=(Limit("tilt_sag", None, 0.0014, "rad", 0.0017, "scale.z", 36.0),),
        not_testable=(NotTestable("thermal_bias", None, "it warmed by 0.3 K only; heat it"),),
        base_terms=("bias", "scale", "nonorthogonality", "misalignment", "time_offset"),
        base_reduced_chi2=3.25,
        base_whiteness_p=1e-12,
        extended_reduced_chi2=1.0625,
        gain=GAIN,
        changes=CHANGES,
        seconds=5.0,
    )


@pytest.fixture
def raw() -> list[RawEvidence]:
    """Two recordings: repeats in both, nothing else."""
    again = RawFinding(
        "repeated_samples", "clock", (), 60, 12_000, 1e-30, "share", 0.005, "1",
        "60 of 12000 samples (0.5 %) repeat the one before", "read it at data-ready",
    )  # fmt: skip
    looks = (
        Look("repeated samples", again.seen_as, (again,)),
        Look("damaged words", "none among 36000 words"),
    )
    return [RawEvidence("monday.mcap", looks), RawEvidence("friday.mcap", looks)]


@pytest.fixture
def origin() -> Origin:
    """One board, two recordings."""
    return Origin(
        board=Subject("GY80-0007", "L3G4200D"),
        recordings=[Input("monday.mcap", "ab" * 32), Input("friday.mcap", "cd" * 32)],
        created="2026-01-31T02:30:00Z",
        software="0.1.0",
    )
