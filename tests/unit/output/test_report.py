"""The report: one file, nothing from outside, hostile names harmless, every part there."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gyrorig_protocol.profile import SensorProfile, parse_profile
from gyrorig_solver.calibration.build import Provenance, calibration_of
from gyrorig_solver.calibration.document import (
    Calibration,
    Findings,
    Level,
    OwnOfRecording,
    Parameter,
)
from gyrorig_solver.clocks.course import ClockCourse
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.report import html
from gyrorig_solver.report.data import ReportData
from gyrorig_solver.report.html import render

BOARDS = Path(__file__).parents[3] / "config" / "boards"
EVIL = "<script>alert(1)</script>\"'><img src=x onerror=alert(1)> {{7*7}} $x^2$"


class Page(HTMLParser):
    """What a browser would find in the page."""

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


def made(fit: GyroFit, origin: Provenance) -> Calibration:
    return calibration_of(fit, origin, version=1, previous=None, created="2026-01-31T02:30:00Z")


def report(fit: GyroFit, origin: Provenance) -> str:
    profile = parse_profile((BOARDS / "L3G4200D.yaml").read_text(), "L3G4200D.yaml")
    document = made(fit, origin)
    return render(ReportData(document, fit.diagnostics, fit.clock, profile, fit.reference))


@pytest.mark.parametrize("name", ["good", "limited"])
def test_the_page_needs_nothing_from_outside(
    name: str, request: pytest.FixtureRequest, provenance: Provenance
) -> None:
    page = page_of(report(request.getfixturevalue(f"{name}_fit"), provenance))
    assert not {"script", "link", "iframe", "object", "img", "base"} & set(page.tags)
    links = [v for n, v in page.attributes if n.split(":")[-1] in ("href", "src", "data")]
    assert all(link.startswith("#") for link in links)
    assert not re.search(r"url\((?!#)", " ".join(v for _, v in page.attributes))


def test_references_inside_the_figures_resolve_and_are_unique(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    page = page_of(report(good_fit, provenance))
    names = [v for n, v in page.attributes if n == "id"]
    used = {v[1:] for n, v in page.attributes if n.endswith("href")}
    used |= set(re.findall(r"url\(#([^)]+)\)", " ".join(v for _, v in page.attributes)))
    assert len(set(names)) == len(names)
    assert used <= set(names)


def test_the_verdict_comes_first_then_the_numbers(
    good_fit: GyroFit, limited_fit: GyroFit, provenance: Provenance
) -> None:
    words = " ".join(page_of(report(good_fit, provenance)).words)
    assert words.index("Good") < words.index("Before and after") < words.index("What was found")
    assert "+1.03125" in words
    assert "12 of 12" in words
    limited = " ".join(page_of(report(limited_fit, provenance)).words)
    assert "Limited" in limited
    assert "sweep it too" in limited
    assert limited.count("not observable from this motion") == 9


def test_a_refused_result_is_not_offered_for_use(good_fit: GyroFit, provenance: Provenance) -> None:
    refused = " ".join(page_of(report(replace(good_fit, reduced_chi2=400.0), provenance)).words)
    assert "Refused" in refused
    assert "How to use it" not in refused
    assert "How to use it" in " ".join(page_of(report(good_fit, provenance)).words)


def test_hostile_names_are_only_text(good_fit: GyroFit, provenance: Provenance) -> None:
    document = made(replace(good_fit, warnings=(EVIL,), distrust=(EVIL,)), provenance)
    board = msgspec.structs.replace(document.board, id=EVIL, uid=EVIL, sensor=EVIL)
    inputs = [msgspec.structs.replace(document.inputs[0], name=EVIL)]
    document = msgspec.structs.replace(document, board=board, inputs=inputs)
    text = render(ReportData(document, good_fit.diagnostics, good_fit.clock, None, EVIL))
    page = page_of(text)
    assert not {"script", "img"} & set(page.tags)
    assert not any(name.startswith("on") for name, _ in page.attributes)
    assert "{{7*7}}" in "".join(page.words)


def test_a_fit_without_arrays_or_clock_still_has_a_page(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    bare = replace(good_fit, diagnostics=None, clock=None, noise=None)
    words = " ".join(page_of(render(ReportData(made(bare, provenance)))).words)
    assert "Before and after" not in words
    assert "What was found" in words


def test_the_same_fit_makes_the_same_page(good_fit: GyroFit, provenance: Provenance) -> None:
    assert report(good_fit, provenance) == report(good_fit, provenance)


def test_level_and_what_is_each_recordings_own_are_said(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    level = Level(0.0035, 0.0002, [0.01, -0.002], [0.001, 0.001], 14)
    own = [
        OwnOfRecording("a.mcap", [0.01, None, -0.02], [0.001, None, 0.001], 0.004, 1e-5),
        OwnOfRecording("b.mcap", [0.011, 0.0, -0.02], [0.001, 0.001, 0.001], None, None),
    ]
    document = made(good_fit, provenance)
    plain = render(ReportData(document, None, None, None, ""))
    assert "How the unit stands" not in plain
    quality = msgspec.structs.replace(document.quality, level=level, recordings=own)
    fuller = msgspec.structs.replace(document, quality=quality)
    said = " ".join(page_of(render(ReportData(fuller, None, None, None, ""))).words)
    assert "14 rests" in said
    assert "+0.201 ± 0.011°" in said  # 0.0035 rad
    assert "+4.000 ± 0.010" in said  # ms
    assert "not shown" in said


def test_every_part_that_people_look_for_is_there(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    course = ClockCourse(*[np.linspace(0.0, 1.0, 50)] * 4)
    assert good_fit.clock is not None
    assert good_fit.diagnostics is not None
    angle = np.stack([np.sin(good_fit.diagnostics.time_s), np.cos(good_fit.diagnostics.time_s)])
    fit = replace(
        good_fit,
        clock=replace(good_fit.clock, course=course),
        diagnostics=replace(good_fit.diagnostics, angle_rad=angle),
    )
    found = msgspec.structs.replace(
        made(fit, provenance),
        findings=Findings(verdict="explained", causes=["backlash"], file="v0001.findings.yaml"),
    )
    profile = parse_profile((BOARDS / "L3G4200D.yaml").read_text(), "L3G4200D.yaml")
    page = page_of(render(ReportData(found, fit.diagnostics, fit.clock, profile, fit.reference)))
    words = " ".join(page.words)
    for part in (
        *("seconds of integration", "Allan deviation", "pan, deg", "tilt, deg", "late by, ms"),
        *("the data sheet allows -25.0 to 25.0 deg/s", "white noise (angle random walk)"),
        *("taken into the fit: backlash", "v0001.findings.html", "not seen"),
    ):
        assert part in words, part
    assert page.tags.count("figure") == 8


def sheet(name: str) -> SensorProfile:
    return parse_profile((BOARDS / f"{name}.yaml").read_text(), name)


def test_the_bias_is_held_against_the_range_of_its_full_scale(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    document = made(good_fit, provenance)
    config = msgspec.structs.replace(document.board.config, gyro_full_scale_dps=500.0)
    board = msgspec.structs.replace(document.board, config=config)
    wide = msgspec.structs.replace(document, board=board)
    page = page_of(render(ReportData(wide, None, None, sheet("L3G4200D"), "")))
    assert "the data sheet allows -37.5 to 37.5 deg/s" in " ".join(page.words)


def test_causes_and_noise_are_held_against_the_data_sheet(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    more = {
        "thermal_bias.slope": Parameter([1e-4, -2e-4, 9e-4], [1e-5] * 3, "rad/s/K"),
        "thermal_scale": Parameter([1e-5, 0.0, 0.0], [1e-6] * 3, "1/K"),
        "g_sensitivity": Parameter([None, 1e-5, 9e-3] * 3, [None, 1e-6, 1e-6] * 3, "rad/s/(m/s^2)"),
    }
    document = made(good_fit, provenance)
    document = msgspec.structs.replace(document, parameters=document.parameters | more)
    page = page_of(render(ReportData(document, None, None, sheet("BMI088"), "")))
    words = " ".join(page.words)
    # 0.015 deg/s/K; 0.03 %/K; 0.1 deg/s of 1 g
    assert "the data sheet allows -0.000262 to 0.000262 rad/s/K" in words
    assert "the data sheet allows -0.000300 to 0.000300 1/K" in words
    assert "the data sheet allows -0.000178 to 0.000178 rad/s/(m/s^2)" in words
    labels = [v for n, v in page.attributes if n == "aria-label" and "data sheet" in v]
    assert [v.split(" ")[0] for v in labels if "rad/s/K" in v] == ["inside", "inside", "outside"]
    assert [v.split(" ")[0] for v in labels if "(m/s^2)" in v] == ["inside", "outside"] * 3
    best = page_of(render(ReportData(document, None, None, sheet("ADIS16470"), "")))
    assert "12.0 (Allan floor 8.00)" in best.words  # 8 deg/h in run


def test_a_phone_shows_each_interval_under_its_value(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    """The column of intervals has no room there; the same text stands under each value."""
    text = report(good_fit, provenance)
    column = re.findall(r'<td class="n wide">([^<]+)</td>', text)
    under = re.findall(r'<td class="n">[^<]+<small class="under">([^<]+)</small></td>', text)
    assert len(column) == 13
    assert under == column
    style = (Path(html.__file__).parent / "page.css").read_text()
    narrow = style[style.index("@media (max-width: 40rem)") :]
    assert ".under { display:none }" in style[: style.index("@media (max-width")]
    assert ".wide { display:none } .under { display:block" in narrow


def test_what_a_recording_does_not_have_is_left_out(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    page = page_of(report(good_fit, provenance))
    words = " ".join(page.words)
    assert "pan, deg" not in words
    assert "late by, ms" not in words
    assert "What a search for causes found" not in words
    nothing = render(ReportData(made(good_fit, provenance)))
    assert "<figure" not in nothing
    assert "white noise" in nothing
