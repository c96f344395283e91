"""The explain report: one HTML file that needs nothing else, made from findings."""

from collections.abc import Mapping

from gyrorig_solver.discover.result import Findings
from gyrorig_solver.findings.build import UNEXPLAINED, figure_key
from gyrorig_solver.findings.document import FindingsDocument
from gyrorig_solver.report import cause_figures
from gyrorig_solver.report.course import Course
from gyrorig_solver.report.explain_view import view_of
from gyrorig_solver.report.html import placed


def render_findings(document: FindingsDocument, figures: Mapping[str, str]) -> str:
    """Return the page of one board's findings; figures by key, as `figures_of` draws them."""
    return placed("explain.html.j2", view_of(document, figures))


def figures_of(course: Course, findings: Findings) -> dict[str, str]:
    """Draw all figures of what a search found, SVG texts by key."""
    drawn = {}
    for cause in findings.causes:
        key = figure_key(cause.cause, cause.where)
        drawn[key] = cause_figures.cause_figure(course, cause.cause, key, cause.where)
    rest = findings.unexplained
    if rest is not None:
        axis = "xyz".index(rest.best.axis) if rest.best.axis in ("x", "y", "z") else None
        drawn[UNEXPLAINED] = cause_figures.rest_figure(course, rest.best.covariate, axis)
    drawn["left"] = cause_figures.left_over_time(course)
    drawn["density"] = cause_figures.spectrum(course)
    drawn |= {f"on-{name}": text for name, text in cause_figures.dependences(course).items()}
    return drawn
