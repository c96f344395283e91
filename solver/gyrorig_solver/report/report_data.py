"""Data of a calibration report.

The report is made from the calibration document, the fit's `FitDiagnostics` (rates, reference and
residual on one uniform grid, and the spectrum with the noise model) and its `ClockQuality`.
A part that is None omits its section.
"""

from dataclasses import dataclass

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.estimate import ClockQuality, FitDiagnostics


@dataclass(frozen=True, slots=True, eq=False)
class ReportData:
    """Everything that one report needs."""

    calibration: CalibrationDocument
    diagnostics: FitDiagnostics | None = None
    clock: ClockQuality | None = None
    profile: SensorProfile | None = None
    reference: str = ""  # one sentence
