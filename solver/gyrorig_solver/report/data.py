"""What a report shows, apart from how it is drawn.

For the estimator: the page is made from the calibration document, the fit's
`FitDiagnostics` (rates, reference and residual on one uniform grid, and the spectrum
with the noise model) and its `Clock`. Nothing is drawn that is not in here; a part that
is None leaves its section out.
"""

from dataclasses import dataclass

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.calibration.document import Calibration
from gyrorig_solver.estimate.result import Clock, FitDiagnostics


@dataclass(frozen=True, slots=True, eq=False)
class ReportData:
    """Everything that one report shows."""

    calibration: Calibration
    diagnostics: FitDiagnostics | None = None
    clock: Clock | None = None
    profile: SensorProfile | None = None
    reference: str = ""  # one sentence: what the rates were compared with
