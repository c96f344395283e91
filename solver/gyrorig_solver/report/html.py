"""The report: one HTML file that needs nothing else, made from a report's data.

What to use when: `render` for the text; the caller writes it. Everything that came from
outside is escaped, and the page forbids scripts and every outside resource.
"""

from functools import cache
from importlib.resources import files
from typing import Any

import jinja2

from gyrorig_solver.calibration.document import Calibration
from gyrorig_solver.calibration.wording import collapsed, nothing_text
from gyrorig_solver.report import view
from gyrorig_solver.report.data import ReportData
from gyrorig_solver.report.pictures import pictures


def render(data: ReportData) -> str:
    """Return the report's page."""
    return placed("page.html.j2", _page(data))


def placed(template: str, view: Any) -> str:
    """Return a page: a template of this package filled with a view of the same name."""
    style = files("gyrorig_solver.report").joinpath("page.css").read_text(encoding="utf-8")
    return _compiled(template).render(view=view, style=style)


@cache  # a batch makes thousands of reports; to compile a template takes as long as to fill it
def _compiled(template: str) -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    source = files("gyrorig_solver.report").joinpath(template).read_text(encoding="utf-8")
    return environment.from_string(source)


def _page(data: ReportData) -> dict[str, Any]:
    calibration = data.calibration
    seen = calibration.observability
    title, text = view.verdict(calibration)
    config = calibration.board.config
    scale = config.gyro_scale_rad_s
    return {
        "board": calibration.board.id,
        "sensor": calibration.board.sensor,
        "version": f"version {calibration.version}",
        "created": calibration.created,
        "verdict": calibration.trust.verdict,
        "verdict_title": title,
        "verdict_text": text,
        "reasons": calibration.trust.reasons,
        "tiles": view.tiles(data),
        "pictures": pictures(data, view.inverse_gain(calibration)),
        "noise": view.noise_rows(data),
        "findings": view.findings_text(calibration),
        "groups": view.groups(data),
        "nothing": nothing_text(calibration),
        "has_profile": data.profile is not None,
        "observability": (
            f"The motion showed {seen.rank} of {seen.of} parameters"
            + (f"; condition number {seen.condition:.3g}." if seen.condition is not None else ".")
        ),
        "unobservable": collapsed(seen.unobservable),
        "level": view.level_text(calibration),
        "apart": view.apart_rows(calibration),
        "clock": view.clock_rows(data.clock) if data.clock is not None else [],
        "reference": data.reference.rstrip("."),
        "nominal_scale": f"{scale:.9g} rad/s" if scale else "the nominal scale",
        "lag_text": view.lag_text(calibration),
        "validity": _validity(calibration),
        "matrix_text": view.matrix_text(calibration),
        "inputs": [_input(row) for row in calibration.inputs],
        "provenance": _provenance(calibration),
        "warnings": calibration.quality.warnings,
    }


def _validity(calibration: Calibration) -> str:
    low, high = calibration.validity.rate_rad_s
    text = f"rates from {low:.3g} to {high:.3g} rad/s"
    if calibration.validity.temperature_degc is not None:
        cold, warm = calibration.validity.temperature_degc
        text += f", {cold:.1f} to {warm:.1f} °C"
    return text + ", and the board's settings below"


def _input(row: Any) -> dict[str, str]:
    return {
        "name": row.name,
        "sha256": row.sha256,
        "duration": f"{row.duration_s:.1f}",
        "samples": str(row.samples),
        "lost": str(row.lost),
    }


def _provenance(calibration: Calibration) -> list[tuple[str, str]]:
    board, solver, config = calibration.board, calibration.solver, calibration.board.config
    settings = {
        "output rate": config.odr_hz and f"{config.odr_hz:g} Hz",
        "bandwidth": config.bandwidth_hz and f"{config.bandwidth_hz:g} Hz",
        "full scale": config.gyro_full_scale_dps and f"{config.gyro_full_scale_dps:g} deg/s",
        "settings' hash": config.config_hash,
    }
    rows = [("board", f"{board.id}, uid {board.uid}"), ("sensor", board.sensor)]
    rows += [(name, str(value)) for name, value in settings.items() if value]
    rows += [
        ("solver", f"gyrorig {solver.version}, method {solver.method}"),
        ("terms", ", ".join(solver.terms)),
        ("solver's settings", solver.config_sha256),
        ("previous version", calibration.previous or "none"),
    ]
    return rows
