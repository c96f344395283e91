"""Reports in a real browser: verdict first, no errors, readable on a phone and on paper."""

import base64
import io
from pathlib import Path
from typing import Any

import pytest
from selenium.common.exceptions import WebDriverException
from tests.bench.pictures import LOOKS, opened, reports

pytestmark = pytest.mark.pages
VERDICTS = ("Good", "Limited", "Refused", "Problem found", "Not fully explained")
PRINT_ATTEMPTS = 3
LEAST_CONTRAST = 4.5  # WCAG 2.2, 1.4.3, of text in normal size


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    report_pages = reports(tmp_path_factory.mktemp("reports"))
    assert set(report_pages) == set(VERDICTS)
    return report_pages


def run_script(browser: Any, script: str) -> Any:
    return browser.execute_script(script)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_verdict_comes_first_and_every_figure_is_drawn(
    browser: Any, pages: dict[str, Path], verdict: str
) -> None:
    opened(browser, pages[verdict], "light")
    first = "return document.querySelector('section, h2').querySelector('strong').innerText"
    assert run_script(browser, first).split(":")[0] == verdict
    sizes = run_script(
        browser,
        "return [...document.querySelectorAll('svg')].map(one => one.getBoundingClientRect())"
        ".filter(box => box.bottom > 0).map(box => [box.width, box.height])",
    )
    assert sizes
    assert all(width > 0.0 and height > 0.0 for width, height in sizes)
    assert browser.get_log("browser") == []


@pytest.mark.parametrize("verdict", VERDICTS)
def test_page_fits_a_phone_screen(browser: Any, pages: dict[str, Path], verdict: str) -> None:
    opened(browser, pages[verdict], "phone")
    width = LOOKS["phone"][0]
    widths = run_script(browser, "return [document.documentElement.scrollWidth, window.innerWidth]")
    assert widths == [width, width]


@pytest.mark.parametrize("verdict", VERDICTS)
def test_dark_mode_is_dark_and_has_contrast(
    browser: Any, pages: dict[str, Path], verdict: str
) -> None:
    def lightness(what: str) -> float:
        colour = run_script(browser, f"return getComputedStyle(document.body).{what}")
        return sum(float(part) for part in colour.split("(")[1].rstrip(")").split(",")[:3]) / 3.0

    opened(browser, pages[verdict], "dark")
    assert lightness("backgroundColor") < 64.0
    assert lightness("color") > 160.0
    opened(browser, pages[verdict], "light")
    assert lightness("backgroundColor") > 224.0
    assert lightness("color") < 96.0


# Contrast of each element that has text of its own against its background.
CONTRASTS = """
const channel = c => c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
const parts = text => text.match(/[\\d.]+/g).map(Number);
const light = c => [0.2126, 0.7152, 0.0722].reduce((s, w, k) => s + w * channel(c[k] / 255), 0);
const behind = one => {
  for (; one; one = one.parentElement) {
    const c = parts(getComputedStyle(one).backgroundColor);
    if (c.length < 4 || c[3] > 0.5) return c;
  }
  return [255, 255, 255];
};
const found = [];
for (const one of document.querySelectorAll('body *:not(svg *)')) {
  const own = [...one.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
  if (!own || !one.getClientRects().length) continue;
  const [a, b] = [light(parts(getComputedStyle(one).color)), light(behind(one))];
  const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  found.push([ratio, one.textContent.trim().slice(0, 40)]);
}
return found;
"""


@pytest.mark.parametrize("look", ["light", "dark"])
@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_text_has_enough_contrast(
    browser: Any, pages: dict[str, Path], verdict: str, look: str
) -> None:
    opened(browser, pages[verdict], look)
    contrasts = run_script(browser, CONTRASTS)
    assert len(contrasts) > 20
    assert [entry for entry in contrasts if entry[0] < LEAST_CONTRAST] == []


@pytest.mark.parametrize("verdict", VERDICTS)
def test_report_can_be_printed(browser: Any, pages: dict[str, Path], verdict: str) -> None:
    """A page printed in dark mode is dark on white, on a few sheets."""
    opened(browser, pages[verdict], "dark")
    paper = print_page(browser)
    assert paper.startswith(b"%PDF-")
    assert 1 <= paper.count(b"/Type /Page\n") <= 12
    media = {"media": "print", "features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    shot = base64.b64decode(
        browser.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})["data"]
    )
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert mean_lightness(shot) > 200.0


def print_page(browser: Any) -> bytes:
    """Return the page as a PDF on A4.

    Chromium's print service can answer "Printing failed" on a busy computer: once in CI, and in
    reports of other projects. Printing is tried again then.
    """
    size = {"paperWidth": 8.27, "paperHeight": 11.69}
    for _ in range(PRINT_ATTEMPTS - 1):
        try:
            return base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", size)["data"])
        except WebDriverException as error:
            if "Printing failed" not in str(error):
                raise
    return base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", size)["data"])


def mean_lightness(png: bytes) -> float:
    """Return the mean grey value of a PNG, 255 is white."""
    image = pytest.importorskip("PIL.Image", reason="no pillow: it comes with `make test`")
    with image.open(io.BytesIO(png)) as screenshot:
        counts = screenshot.convert("L").histogram()
    return float(sum(value * count for value, count in enumerate(counts)) / sum(counts))
