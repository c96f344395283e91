"""Results of one board: its fit with criticism, and its findings with their report.

What to use when: `check_raw_streams` and `check_fitted_gain` for the `RawChecks` of a board's
samples.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import find_profile
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.stream.gain_checks import check_gain
from gyrorig_solver.data.stream.stream_checks import check_stream
from gyrorig_solver.discover import (
    AttitudeFitSpace,
    CauseFindings,
    FitCriticism,
    FitExplanation,
)
from gyrorig_solver.estimate import ConvergedFit, GyroFit
from gyrorig_solver.findings.findings_builder import RawChecks
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.plan import NextExperiment
from gyrorig_solver.report import ReportSeries

if TYPE_CHECKING:  # an explanation contains a curve
    from gyrorig_solver.pipeline.rest_temperature import RestTemperature

NO_CAUSE_REMARK = "the search named no cause, so the program tested no cause on {}"
ALL_RECORDINGS = "all recordings"  # subject of the check of their common gain


@dataclass(frozen=True, slots=True, eq=False)
class BoardExplanation:
    """The findings of one board, with the data for its document and its report."""

    board: BoardId
    recordings: tuple[Recording, ...]
    findings: CauseFindings
    raw_checks: tuple[RawChecks, ...]
    report_series: ReportSeries | None  # None if there is no residual to draw
    remarks: tuple[str, ...]
    fit_explanation: FitExplanation | None  # None if the reference is not a unit's motion
    fit: GyroFit | None = None  # if the reference is not a unit's motion; with the named causes
    attitude_space: AttitudeFitSpace | None = None  # if the reference is attitudes
    temperature: "RestTemperature | None" = None  # if the bias at rest depends on the temperature
    next_experiment: NextExperiment | None = None  # if sets of causes are stated

    @property
    def link(self) -> str:
        """The way on which the samples arrived, as in the metadata of the first recording."""
        return self.recordings[0].metadata.get(f"gyrorig.board.{self.board}", {}).get("link", "")


@dataclass(frozen=True, slots=True, eq=False)
class CriticisedFit:
    """One board's fit with the result of its search, or with that of significance tests."""

    fit: GyroFit
    solution: ConvergedFit | None  # None if the reference gives no rate at each time
    explanation: BoardExplanation | None = None  # if causes were searched for
    criticism: FitCriticism | None = None  # if the user requested the model
    attitude_space: AttitudeFitSpace | None = None  # if the reference is attitudes
    disputed_causes: tuple[str, ...] = ()  # of the unit, about which its boards disagree

    @property
    def is_adequate(self) -> bool:
        """Whether no test detects an effect in the residual of the fit."""
        if self.explanation is not None:
            return self.explanation.findings.unexplained is None
        return self.criticism is None or self.criticism.is_adequate


def check_raw_streams(data: BoardData) -> list[RawChecks]:
    """Return the checks of the samples of each recording."""
    return [
        RawChecks(name, check_stream(samples))
        for name, samples in zip(data.names, data.samples, strict=True)
    ]


def check_fitted_gain(data: BoardData, gain: FloatArray) -> RawChecks:
    """Return the checks of the gain that was fitted to all recordings."""
    first = data.recordings[0]
    name = data.names[0] if len(data.recordings) == 1 else ALL_RECORDINGS
    sensor = first.metadata.get(f"gyrorig.board.{data.board}", {}).get("sensor", "")
    profile = find_profile(sensor)
    tolerance = None if profile is None else profile.scale_tolerance
    return RawChecks(name, check_gain(np.asarray(gain), tolerance, data.samples[0].link))
