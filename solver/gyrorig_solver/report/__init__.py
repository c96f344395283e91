"""Reports: one self-contained HTML page per calibration or per findings document.

What to use when: `calibration_page.render_calibration` for a calibration report,
`findings_page.render_findings` for an explain report. The view modules decide texts and units, the
figure modules draw, the templates place and escape.
"""

from gyrorig_solver.report.calibration_page import render_calibration
from gyrorig_solver.report.findings_page import draw_findings_figures, render_findings
from gyrorig_solver.report.report_data import ReportData
from gyrorig_solver.report.report_series import ReportSeries

__all__ = [
    "ReportData",
    "ReportSeries",
    "draw_findings_figures",
    "render_calibration",
    "render_findings",
]
