"""The explain page and its figures: nothing from outside, planted shapes drawn as they are."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import msgspec
import numpy as np
import pytest
from scipy.stats import linregress

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover import CauseFindings
from gyrorig_solver.findings import build_findings_document
from gyrorig_solver.findings.findings_builder import FindingsOrigin, RawChecks
from gyrorig_solver.model import BinnedDependence
from gyrorig_solver.report import ReportSeries, draw_findings_figures, render_findings
from gyrorig_solver.report.binned_dependence import (
    DEPENDENCE_OF_SIGNATURE,
    regress_in_bins,
)
from gyrorig_solver.report.cause_figures import cause_figure, unexplained_figure
from gyrorig_solver.report.figure_layout import standalone_svg

EVIL = "<script>alert(1)</script>\"'><img src=x onerror=alert(1)> {{7*7}}"
RNG = np.random.default_rng(11)
N = 9000


def course(left: FloatArray | None = None) -> ReportSeries:
    """A pan that swings over its range at three tilts, with a given residual."""
    time_s = np.arange(N) / 50.0
    pan = 2.0 * np.sin(0.9 * time_s)
    tilt = np.repeat([-0.5, 0.0, 0.5], N // 3)
    rate = np.gradient(pan, 0.02)
    stage = np.column_stack([np.zeros(N), np.sin(tilt) * rate, np.cos(tilt) * rate])
    noise = 1e-3 * RNG.normal(size=(N, 3))
    effect = np.zeros((N, 3)) if left is None else left
    frequency = np.geomspace(0.05, 25.0, 40)
    density = np.full((40, 3), 1e-6 / 25.0)
    return ReportSeries(
        time_s=time_s,
        measured_rad_s=stage + effect + noise,
        base_rad_s=stage,
        extended_rad_s=stage + effect,
        rate_rad_s=stage,
        angle_rad=np.stack([pan, tilt]),
        temperature_degc=np.full(N, np.nan),
        effects={"backlash-tilt": effect},
        frequency_hz=frequency,
        spectrum_base=density,
        spectrum_extended=density,
        spectrum_model=density,
    )


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


def drawn(findings: CauseFindings) -> dict[str, str]:
    effect = np.zeros((N, 3))
    effect[4000:4010, 2] = 0.02
    return draw_findings_figures(course(effect), findings)


def test_page_is_self_contained(
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    page = page_of(render_findings(build_findings_document(findings, raw, origin), drawn(findings)))
    assert not {"script", "link", "iframe", "object", "img", "base"} & set(page.tags)
    links = [v for n, v in page.attributes if n.split(":")[-1] in ("href", "src", "data")]
    assert all(link.startswith("#") for link in links)
    names = [v for n, v in page.attributes if n == "id"]
    used = {v[1:] for n, v in page.attributes if n.endswith("href")}
    used |= set(re.findall(r"url\(#([^)]+)\)", " ".join(v for _, v in page.attributes)))
    assert len(set(names)) == len(names)
    assert used <= set(names)


def test_verdict_effect_and_remedy_come_first(
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    words = " ".join(
        page_of(render_findings(build_findings_document(findings, raw, origin), {})).words
    )
    order = [
        *("Not fully explained: the gears have backlash, on tilt", "standard uncertainties (scale"),
        *("Have the worm adjusted", "p < 1e-12; posterior probability 0.97", "Causes"),
        *("Comparison with the alternatives", "Unexplained residual", "Not found"),
        *("Not testable with this recording", "Raw-stream checks"),
    ]
    places = [words.index(text) for text in order]
    assert places == sorted(places)
    assert "+37.5 nats" in words
    assert "it comes after reversals only" in words


def test_each_compared_cause_has_its_probability_as_a_bar(
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    text = render_findings(build_findings_document(findings, raw, origin), {})
    comparison = text[text.index("Comparison with the alternatives") :]
    bars = re.findall(r'<rect width="([\d.]+)" height="10" fill="var\(--z\)"/>', comparison)
    cause = findings.causes[0]
    stated = [cause.posterior, *(rival.posterior for rival in cause.rivals)]
    assert [float(bar) for bar in bars[: len(stated)]] == pytest.approx(
        [100.0 * posterior for posterior in stated], abs=0.05
    )


def test_hostile_names_are_escaped(
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    document = build_findings_document(findings, raw, origin, remarks=(EVIL,))
    board = msgspec.structs.replace(document.board, id=EVIL, sensor=EVIL)
    recording = [msgspec.structs.replace(document.recording[0], name=EVIL)]
    document = msgspec.structs.replace(document, board=board, recording=recording)
    page = page_of(render_findings(document, {}))
    assert not {"script", "img"} & set(page.tags)
    assert "{{7*7}}" in "".join(page.words)


def test_page_without_findings(findings: CauseFindings, origin: FindingsOrigin) -> None:
    empty = replace(
        findings, verdict="adequate", causes=(), unexplained=None, gain=None, changes=()
    )
    words = " ".join(page_of(render_findings(build_findings_document(empty, [], origin), {})).words)
    assert "No error found" in words
    assert "Comparison with the alternatives" not in words


def test_standalone_figure_has_its_own_style(findings: CauseFindings) -> None:
    text = standalone_svg(drawn(findings)["backlash-tilt"])
    assert text.startswith("<?xml")
    assert 'xmlns="http://www.w3.org/2000/svg"' in text
    assert "prefers-color-scheme" in text


def test_binned_gain_matches_a_known_gain() -> None:
    series = course()
    rate = series.rate_rad_s[:, 2]
    planted = np.zeros((N, 3))
    planted[:, 2] = 0.01 * np.cos(series.angle_rad[0]) * rate
    bins = regress_in_bins(series, planted, BinnedDependence("gain", "pan"), axis=2)
    upright = float(np.mean(np.cos(series.angle_rad[1])))  # z takes part of pan's rate
    wanted = upright * np.cos(np.radians(bins.centre))
    assert bins.value[1:-1] == pytest.approx(wanted[1:-1], abs=0.02)


def test_binned_delay_is_in_milliseconds() -> None:
    series = course()
    late = -0.002 * np.gradient(series.base_rad_s, 0.02, axis=0)
    bins = regress_in_bins(series, late, BinnedDependence("lag", "time", 8), axis=2)
    assert bins.value == pytest.approx(np.full(bins.value.size, 2.0), abs=1e-6)


def test_one_bin_equals_scipy_regression() -> None:
    series = course()
    left = series.base_residual_rad_s
    by = np.sin(series.angle_rad[1]) * series.rate_rad_s[:, 1]
    by = by + np.cos(series.angle_rad[1]) * series.rate_rad_s[:, 2]
    is_large = np.abs(by) > 0.05 * np.abs(by).max()
    bins = regress_in_bins(series, left, BinnedDependence("gain", "pan", 1), axis=2)
    both = np.concatenate([by[is_large], -by[is_large]])  # through the origin
    wanted = linregress(both, np.concatenate([left[is_large, 2], -left[is_large, 2]]))
    assert bins.value[0] == pytest.approx(100.0 * wanted.slope, rel=1e-9)
    assert bins.bar[0] == pytest.approx(196.0 * wanted.stderr * np.sqrt(2.0), rel=1e-2)


@pytest.mark.parametrize("cause", ["worm_error", "scale_cubic", "clock_skew", "ringing", "warm_up"])
def test_every_kind_of_figure_is_drawn(cause: str) -> None:
    effect = 0.001 * RNG.normal(size=(N, 3)) + 0.01 * course().rate_rad_s ** 2
    shown = replace(course(effect), effects={"own": effect})
    text = cause_figure(shown, cause, "own", ("pan",))
    assert text.startswith("<svg")
    assert "with the cause" in text


def test_without_angles_a_cause_is_drawn_by_its_effect() -> None:
    effect = 0.01 * np.sin(np.arange(N))[:, None] * np.ones((1, 3))
    bare = replace(course(effect), effects={"own": effect}, angle_rad=np.full((2, N), np.nan))
    text = cause_figure(bare, "reference_smoothing", "own", ())
    assert "predicted effect" in text
    assert "without the cause, deg/s" in text


def test_other_causes_are_in_both_models_of_a_figure() -> None:
    """A large other cause must not show in the figure of a small one."""
    own_effect, other = np.zeros((N, 3)), np.zeros((N, 3))
    own_effect[4000:4010, 2], other[:, 2] = 0.01, 1.0
    series = course(own_effect + other)
    shown = replace(series, effects={"own": own_effect})
    flat = replace(course(own_effect), effects={"own": own_effect})
    assert close_scale(cause_figure(shown, "ringing", "own", ())) == close_scale(
        cause_figure(flat, "ringing", "own", ())
    )


def close_scale(text: str) -> list[str]:
    """The lower panel's numbers: what is left."""
    return [w for w in page_of(text).words if w.strip().startswith("0.")][-3:]


@pytest.mark.parametrize("covariate", [*DEPENDENCE_OF_SIGNATURE, "line", "pan_transient", "moving"])
def test_unexplained_residual_is_drawn_against_any_covariate(covariate: str) -> None:
    assert unexplained_figure(course(), covariate, 2).startswith("<svg")
