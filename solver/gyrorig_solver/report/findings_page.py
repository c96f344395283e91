"""The explain report: one self-contained HTML file, made from findings."""

from collections.abc import Mapping

from gyrorig_solver.discover import CauseFindings
from gyrorig_solver.findings import UNEXPLAINED_FIGURE, FindingsDocument, figure_key
from gyrorig_solver.report import cause_figures
from gyrorig_solver.report.calibration_page import fill_template
from gyrorig_solver.report.findings_view import findings_view
from gyrorig_solver.report.report_series import ReportSeries


def render_findings(document: FindingsDocument, figures: Mapping[str, str]) -> str:
    """Return the explain report as HTML; figures by key, see `draw_findings_figures`."""
    return fill_template("explain.html.j2", findings_view(document, figures))


def draw_findings_figures(series: ReportSeries, findings: CauseFindings) -> dict[str, str]:
    """Draw all figures of the findings, SVG texts by key."""
    figures = {}
    for cause in findings.causes:
        key = figure_key(cause)
        figures[key] = cause_figures.cause_figure(series, cause.cause, key, cause.where)
    unexplained = findings.unexplained
    if unexplained is not None:
        axis = (
            "xyz".index(unexplained.leading.axis)
            if unexplained.leading.axis in ("x", "y", "z")
            else None
        )
        figures[UNEXPLAINED_FIGURE] = cause_figures.unexplained_figure(
            series, unexplained.leading.covariate, axis
        )
    figures["left"] = cause_figures.residual_over_time(series)
    figures["density"] = cause_figures.residual_spectrum(series)
    figures |= {
        f"on-{name}": text for name, text in cause_figures.dependence_figures(series).items()
    }
    return figures
