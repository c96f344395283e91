"""The calibration report: one self-contained HTML file.

What to use when: `render_calibration` for the text, which the caller writes. Everything that comes
from files is escaped, and the page forbids scripts and external resources.
"""

import math
import re
from functools import cache
from importlib.resources import files
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup, escape

from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.calibration.calibration_wording import (
    VERDICT_TITLES,
    collapse_groups,
    missing_value_text,
    temperature_sentences,
    verdict_sentence,
)
from gyrorig_solver.report import calibration_view, summary_tiles
from gyrorig_solver.report.calibration_figures import draw_figures, temperature_figure
from gyrorig_solver.report.report_data import ReportData

_COMMAND = re.compile(r"`([^`<>&]{1,120})`")


def render_calibration(data: ReportData) -> str:
    """Return the report as HTML."""
    return fill_template("page.html.j2", _page_view(data))


def fill_template(template: str, view: Any) -> str:
    """Return the HTML of one of this package's templates, filled with a view."""
    style = files("gyrorig_solver.report").joinpath("page.css").read_text(encoding="utf-8")
    return _compiled_template(template).render(view=view, style=style)


@cache  # a batch writes thousands of reports; compiling takes as long as filling
def _compiled_template(template: str) -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        finalize=_refuse_function,
    )
    environment.filters["code"] = _mark_commands
    source = files("gyrorig_solver.report").joinpath(template).read_text(encoding="utf-8")
    return environment.from_string(source)


def _refuse_function(value: Any) -> Any:
    """Return a value of a page.

    Raises:
        TypeError: it is a function, as `view.values` of a dictionary with the key `values` is.
    """
    if callable(value):
        raise TypeError(f"a page must not contain the function {value!r}")
    return value


def _mark_commands(text: str) -> Markup:
    """Return text as HTML, with commands in backticks as code."""
    return Markup(_COMMAND.sub(r"<code>\1</code>", str(escape(text))))  # noqa: S704 - escaped


def _page_view(data: ReportData) -> dict[str, Any]:
    calibration = data.calibration
    observability = calibration.observability
    config = calibration.board.config
    scale = config.gyro_scale_rad_s
    return {
        "board": calibration.board.id,
        "sensor": calibration.board.sensor,
        "version": f"version {calibration.version}",
        "created": calibration.created,
        "summary": summary_tiles.summary_line(calibration),
        "verdict": calibration.trust.verdict,
        "verdict_title": VERDICT_TITLES[calibration.trust.verdict],
        "verdict_text": verdict_sentence(calibration),
        "reasons": calibration.trust.reasons,
        "tiles": summary_tiles.summary_tiles(data),
        "pictures": draw_figures(data, summary_tiles.inverse_gain(calibration)),
        "temperature": _temperature(calibration),
        "noise": calibration_view.noise_rows(data),
        "findings": calibration_view.findings_text(calibration),
        "uncertainty": calibration_view.uncertainty_rows(calibration),
        "remedies": calibration_view.contribution_remedies(calibration),
        "groups": calibration_view.parameter_tables(data),
        "nothing": missing_value_text(calibration),
        "has_profile": data.profile is not None,
        "observability": (
            f"The motion determines {observability.rank} of {observability.of} parameters "
            "(the time offset is not counted)"
            + (
                f"; condition number {observability.condition:.3g}."
                if observability.condition is not None
                else "."
            )
        ),
        "unobservable": collapse_groups(observability.unobservable),
        "level": calibration_view.level_text(calibration),
        "apart": calibration_view.recording_rows(calibration),
        "clock": calibration_view.clock_rows(data.clock) if data.clock is not None else [],
        "reference": data.reference.rstrip("."),
        "nominal_scale": f"{scale:.9g} rad/s" if scale else "the nominal scale",
        "lag_text": calibration_view.time_offset_text(calibration),
        "validity": _validity(calibration),
        "matrix_text": calibration_view.matrix_text(calibration),
        "inputs": [_input_row(row) for row in calibration.inputs],
        "provenance": _provenance(calibration),
        "warnings": calibration.quality.warnings,
    }


def _temperature(calibration: CalibrationDocument) -> dict[str, Any] | None:
    record = calibration.temperature
    if record is None:
        return None
    bias = calibration.parameters["bias"].value
    values = np.array([math.nan if value is None else value for value in bias]
                      if isinstance(bias, list) else [math.nan] * 3)  # fmt: skip
    return {
        "picture": temperature_figure(record, values),
        "text": " ".join(temperature_sentences(record)),
    }


def _validity(calibration: CalibrationDocument) -> str:
    low, high = (math.degrees(value) for value in calibration.validity.rate_rad_s)
    if summary_tiles.is_rate_range(calibration):
        text = f"rates from {low:.0f} to {high:.0f} deg/s"
    else:
        text = "a board at rest"
    if calibration.validity.temperature_degc is not None:
        cold, warm = calibration.validity.temperature_degc
        text += f", {cold:.1f} to {warm:.1f} °C"
    return text + " and the board's settings below"


def _input_row(row: Any) -> dict[str, str]:
    return {
        "name": row.name,
        "sha256": row.sha256,
        "duration": f"{row.duration_s:.1f}",
        "samples": str(row.samples),
        "lost": str(row.lost),
    }


def _provenance(calibration: CalibrationDocument) -> list[tuple[str, str]]:
    board, solver, config = calibration.board, calibration.solver, calibration.board.config
    settings = {
        "output rate": config.odr_hz and f"{config.odr_hz:g} Hz",
        "bandwidth": config.bandwidth_hz and f"{config.bandwidth_hz:g} Hz",
        "full scale": config.gyro_full_scale_dps and f"{config.gyro_full_scale_dps:g} deg/s",
        "settings hash": config.config_hash,
    }
    rows = [("board", f"{board.id}, UID {board.uid}"), ("sensor", board.sensor)]
    rows += [(name, str(value)) for name, value in settings.items() if value]
    rows += [
        ("solver", f"gyrorig {solver.version}, method {solver.method}"),
        ("terms", ", ".join(solver.terms)),
        ("solver settings, SHA-256", solver.config_sha256),
        ("previous version", calibration.previous or "none"),
    ]
    return rows
