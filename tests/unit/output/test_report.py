"""The calibration report: one self-contained file, hostile names escaped, every section present."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gyrorig_protocol.profile import SensorProfile, parse_profile
from gyrorig_solver.calibration import CalibrationDocument, Parameter
from gyrorig_solver.calibration.calibration_builder import Provenance, build_calibration
from gyrorig_solver.calibration.calibration_document import (
    FindingsReference,
    LevelRecord,
    ParameterUncertainty,
    RecordingParameters,
    UncertaintyRecord,
)
from gyrorig_solver.data.clocks.clock_trace import ClockTrace
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.report import ReportData, calibration_page, render_calibration

BOARDS = Path(__file__).parents[3] / "config" / "boards"
EVIL = "<script>alert(1)</script>\"'><img src=x onerror=alert(1)> {{7*7}} $x^2$"


class Page(HTMLParser):
    """Tags, attributes and texts of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def page_of(text: str) -> Page:
    page = Page()
    page.feed(text)
    return page


def made(fit: GyroFit, origin: Provenance) -> CalibrationDocument:
    return build_calibration(fit, origin)


def report(fit: GyroFit, origin: Provenance) -> str:
    profile = parse_profile((BOARDS / "L3G4200D.yaml").read_text(), "L3G4200D.yaml")
    document = made(fit, origin)
    return render_calibration(
        ReportData(document, fit.diagnostics, fit.clock, profile, fit.reference)
    )


@pytest.mark.parametrize("name", ["good", "limited"])
def test_page_is_self_contained(
    name: str, request: pytest.FixtureRequest, provenance: Provenance
) -> None:
    page = page_of(report(request.getfixturevalue(f"{name}_fit"), provenance))
    assert not {"script", "link", "iframe", "object", "img", "base"} & set(page.tags)
    links = [v for n, v in page.attributes if n.split(":")[-1] in ("href", "src", "data")]
    assert all(link.startswith("#") for link in links)
    assert not re.search(r"url\((?!#)", " ".join(v for _, v in page.attributes))


def test_references_in_figures_resolve_and_are_unique(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    page = page_of(report(good_fit, provenance))
    names = [v for n, v in page.attributes if n == "id"]
    used = {v[1:] for n, v in page.attributes if n.endswith("href")}
    used |= set(re.findall(r"url\(#([^)]+)\)", " ".join(v for _, v in page.attributes)))
    assert len(set(names)) == len(names)
    assert used <= set(names)


def test_verdict_comes_before_numbers(
    good_fit: GyroFit, limited_fit: GyroFit, provenance: Provenance
) -> None:
    words = " ".join(page_of(report(good_fit, provenance)).words)
    assert words.index("Good") < words.index("Rate and angle error") < words.index("Parameters")
    assert "+1.03125" in words
    assert "12 of 12" in words
    limited = " ".join(page_of(report(limited_fit, provenance)).words)
    assert "Limited" in limited
    assert "sweep it too" in limited
    assert limited.count("not observable from this motion") == 9


def test_refused_result_has_no_application_section(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    refused = " ".join(page_of(report(replace(good_fit, reduced_chi2=400.0), provenance)).words)
    assert "Refused" in refused
    assert "Application" not in refused
    assert "Application" in " ".join(page_of(report(good_fit, provenance)).words)


def test_hostile_names_are_escaped(good_fit: GyroFit, provenance: Provenance) -> None:
    document = made(replace(good_fit, warnings=(EVIL,), limited_reasons=(EVIL,)), provenance)
    board = msgspec.structs.replace(document.board, id=EVIL, uid=EVIL, sensor=EVIL)
    inputs = [msgspec.structs.replace(document.inputs[0], name=EVIL)]
    document = msgspec.structs.replace(document, board=board, inputs=inputs)
    text = render_calibration(
        ReportData(document, good_fit.diagnostics, good_fit.clock, None, EVIL)
    )
    page = page_of(text)
    assert not {"script", "img"} & set(page.tags)
    assert not any(name.startswith("on") for name, _ in page.attributes)
    assert "{{7*7}}" in "".join(page.words)


def test_first_line_summarises_the_result(
    good_fit: GyroFit, limited_fit: GyroFit, provenance: Provenance
) -> None:
    words = " ".join(page_of(report(good_fit, provenance)).words)
    assert (
        "Calibrated on 2026-01-31. Fit for use from -57 to 72 deg/s. "
        "Scale factor error 3.12 % before, 0.0479 % after (95 %)."
    ) in words
    assert "rates from -57 to 72 deg/s" in words
    value = float(good_fit.scale[1])
    total = ParameterUncertainty(1e-4, 1e-3, 1e-3, [value - 1e-3, value + 2e-3], 2e-3, "1")
    document = msgspec.structs.replace(
        made(good_fit, provenance),
        uncertainty=UncertaintyRecord(2.0, {"scale.y": total}, [], "0" * 64),
    )
    page = page_of(render_calibration(ReportData(document, good_fit.diagnostics, None, None, "")))
    assert "% before, 0.200 % after (95 %)." in " ".join(page.words)
    at_rest = replace(limited_fit, rate_range_rad_s=(0.0, 0.0))
    resting = " ".join(page_of(report(at_rest, provenance)).words)
    assert "The board did not turn, so the calibration contains only values at rest." in resting
    assert "angle error after 1 s" not in resting
    refused = " ".join(page_of(report(replace(good_fit, reduced_chi2=400.0), provenance)).words)
    assert "Calibrated on 2026-01-31. Not fit for use." in refused


def test_fit_without_arrays_or_clock_has_a_page(good_fit: GyroFit, provenance: Provenance) -> None:
    bare = replace(good_fit, diagnostics=None, clock=None, noise=None)
    words = " ".join(page_of(render_calibration(ReportData(made(bare, provenance)))).words)
    assert "Rate and angle error" not in words
    assert "Parameters" in words


def test_report_is_deterministic(good_fit: GyroFit, provenance: Provenance) -> None:
    assert report(good_fit, provenance) == report(good_fit, provenance)


def test_leveling_and_values_per_recording_are_shown(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    level = LevelRecord(0.0035, 0.0002, [0.01, -0.002], [0.001, 0.001], 14)
    recordings = [
        RecordingParameters("a.mcap", [0.01, None, -0.02], [0.001, None, 0.001], 0.004, 1e-5),
        RecordingParameters("b.mcap", [0.011, 0.0, -0.02], [0.001, 0.001, 0.001], None, None),
    ]
    document = made(good_fit, provenance)
    plain = render_calibration(ReportData(document, None, None, None, ""))
    assert "Leveling" not in plain
    quality = msgspec.structs.replace(document.quality, level=level, recordings=recordings)
    fuller = msgspec.structs.replace(document, quality=quality)
    words = " ".join(page_of(render_calibration(ReportData(fuller, None, None, None, ""))).words)
    assert "14 static intervals" in words
    assert "+0.201 ± 0.011 deg" in words  # 0.0035 rad
    assert "+4.000 ± 0.010" in words  # ms
    assert "not observable" in words


def test_full_report_has_every_section(good_fit: GyroFit, provenance: Provenance) -> None:
    course = ClockTrace(*[np.linspace(0.0, 1.0, 50)] * 4)
    assert good_fit.clock is not None
    assert good_fit.diagnostics is not None
    angle = np.stack([np.sin(good_fit.diagnostics.time_s), np.cos(good_fit.diagnostics.time_s)])
    fit = replace(
        good_fit,
        clock=replace(good_fit.clock, course=course),
        diagnostics=replace(good_fit.diagnostics, angle_rad=angle),
    )
    calibration = made(fit, provenance)
    document = msgspec.structs.replace(
        calibration,
        solver=msgspec.structs.replace(
            calibration.solver, terms=[*calibration.solver.terms, "backlash"]
        ),
        findings=FindingsReference(
            verdict="explained",
            causes=["backlash", "sign_flip", "lost_samples"],
            file="v0001.findings.yaml",
        ),
    )
    profile = parse_profile((BOARDS / "L3G4200D.yaml").read_text(), "L3G4200D.yaml")
    page = page_of(
        render_calibration(ReportData(document, fit.diagnostics, fit.clock, profile, fit.reference))
    )
    words = " ".join(page.words)
    for part in (
        *("integration time, s", "Allan deviation", "pan, deg", "tilt, deg", "latency, ms"),
        *("the data sheet allows -25.0 to 25.0 deg/s", "angle random walk", "deg/√h", "one-sided"),
        *(
            "includes the identified causes: backlash. The gain",
            "the correction, includes the identified causes: sign flip. Identified",
            "not terms of the fit: lost samples",
        ),
        *("v0001.findings.html", "not estimated"),
    ):
        assert part in words, part
    assert page.tags.count("figure") == 8


def sheet(name: str) -> SensorProfile:
    return parse_profile((BOARDS / f"{name}.yaml").read_text(), name)


def test_bias_is_compared_with_the_range_of_its_full_scale(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    document = made(good_fit, provenance)
    config = msgspec.structs.replace(document.board.config, gyro_full_scale_dps=500.0)
    board = msgspec.structs.replace(document.board, config=config)
    wide = msgspec.structs.replace(document, board=board)
    page = page_of(render_calibration(ReportData(wide, None, None, sheet("L3G4200D"), "")))
    assert "the data sheet allows -37.5 to 37.5 deg/s" in " ".join(page.words)


def test_causes_and_noise_are_compared_with_the_data_sheet(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    more = {
        "thermal_bias.slope": Parameter([1e-4, -2e-4, 9e-4], [1e-5] * 3, "rad/s/K"),
        "thermal_scale": Parameter([1e-5, 0.0, 0.0], [1e-6] * 3, "1/K"),
        "g_sensitivity": Parameter([None, 1e-5, 9e-3] * 3, [None, 1e-6, 1e-6] * 3, "rad/s/(m/s^2)"),
    }
    document = made(good_fit, provenance)
    document = msgspec.structs.replace(document, parameters=document.parameters | more)
    page = page_of(render_calibration(ReportData(document, None, None, sheet("BMI088"), "")))
    words = " ".join(page.words)
    assert "the data sheet allows -0.0150 to 0.0150 deg/s/K" in words
    assert "the data sheet allows -300 to 300 ppm/K" in words
    assert "the data sheet allows -0.100 to 0.100 deg/s/g" in words
    labels = [v for n, v in page.attributes if n == "aria-label" and "data sheet" in v]
    assert [v.split(" ")[0] for v in labels if "deg/s/K" in v] == ["inside", "inside", "outside"]
    assert [v.split(" ")[0] for v in labels if "deg/s/g" in v] == ["inside", "outside"] * 3
    best = page_of(render_calibration(ReportData(document, None, None, sheet("ADIS16470"), "")))
    assert "12.0 (Allan minimum 8.00)" in best.words  # 8 deg/h in run


def test_a_parameter_without_a_unit_has_no_empty_brackets(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    begin = {"backlash.begin": Parameter([-1.0, None], [0.11, None], "")}
    document = made(good_fit, provenance)
    document = msgspec.structs.replace(document, parameters=document.parameters | begin)
    words = page_of(render_calibration(ReportData(document, None, None, sheet("BMI088"), ""))).words
    assert any("backlash.begin" in text for text in words)
    assert not any("()" in text for text in words)


def test_phone_shows_each_interval_below_its_value(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    """The column of intervals has no room there; its text is below each value."""
    text = report(good_fit, provenance)
    column = re.findall(r'<td class="n wide">([^<]+)</td>', text)
    under = re.findall(r'<td class="n">[^<]+<small class="under">([^<]+)</small></td>', text)
    assert len(column) == 13
    assert under == column
    style = (Path(calibration_page.__file__).parent / "page.css").read_text()
    narrow = style[style.index("@media (max-width: 40rem)") :]
    assert ".under { display:none }" in style[: style.index("@media (max-width")]
    assert ".wide { display:none } .under { display:block" in narrow


def test_missing_parts_are_omitted(good_fit: GyroFit, provenance: Provenance) -> None:
    page = page_of(report(good_fit, provenance))
    words = " ".join(page.words)
    assert "pan, deg" not in words
    assert "latency, ms" not in words
    assert "Causes of errors" not in words
    nothing = render_calibration(ReportData(made(good_fit, provenance)))
    assert "<figure" not in nothing
    assert "noise density" in nothing
