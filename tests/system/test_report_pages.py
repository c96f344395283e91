"""Reports in a real browser: the verdict first, nothing red, readable on a phone and on paper."""

import base64
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.bench.fleet.browser import chromium

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
PHONE, DESK = (390, 844, True), (1300, 1400, False)
DONE, NOT_IDENTIFIABLE, REFUSED = 0, 4, 3


def record(out: Path, program: str, *more: str) -> Path:
    command = [BIN / "gyrorigd", "record", "--simulated-time", "--seed", "2", "--out", out]
    command += ["--config", ROOT / "config" / "rig.yaml"]
    command += ["--program", ROOT / "config" / "programs" / f"{program}.yaml"]
    subprocess.run([*map(str, command), *more], check=True, capture_output=True)
    return next(out.glob("*.mcap"))


def made(out: Path, *command: str | Path) -> Path:
    """Run a command that writes one page into `out`, and return the page."""
    words = [str(BIN / "gyrorig"), *map(str, command), "--out", str(out)]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    assert done.returncode in (DONE, NOT_IDENTIFIABLE, REFUSED), done.stderr
    (page,) = out.rglob("*.html")
    return page


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("reports")
    sound = record(folder / "sound", "quick")
    worn = record(folder / "worn", "quick", "--hide", "backlash@tilt")
    still = record(folder / "still", "static")
    return {
        "Good": made(folder / "good", "solve", sound),
        "Limited": made(folder / "limited", "solve", still),
        "Refused": made(folder / "refused", "solve", sound, "--method", "paper"),
        "Explained": made(folder / "explained", "explain", worn),
    }


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    one = chromium(tmp_path_factory.mktemp("profile"))
    if one is None:
        pytest.skip("no Chromium to drive: apt-get install chromium chromium-driver, selenium")
    yield one
    one.quit()


def opened(browser: Any, page: Path, size: tuple[int, int, bool], scheme: str = "light") -> None:
    width, height, mobile = size
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile},
    )
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    browser.get(page.as_uri())


def asked(browser: Any, script: str) -> Any:
    return browser.execute_script(script)


@pytest.mark.parametrize("verdict", ["Good", "Limited", "Refused", "Explained"])
def test_the_verdict_comes_first_and_every_picture_is_drawn(
    browser: Any, pages: dict[str, Path], verdict: str
) -> None:
    opened(browser, pages[verdict], DESK)
    first = "return document.querySelector('section, h2').querySelector('strong').innerText"
    assert asked(browser, first) == verdict
    sizes = asked(
        browser,
        "return [...document.querySelectorAll('svg')].map(one => one.getBoundingClientRect())"
        ".filter(box => box.bottom > 0).map(box => [box.width, box.height])",
    )
    assert sizes
    assert all(width > 0.0 and height > 0.0 for width, height in sizes)
    assert browser.get_log("browser") == []


@pytest.mark.parametrize("verdict", ["Good", "Limited", "Refused", "Explained"])
def test_nothing_leaves_a_phones_screen(browser: Any, pages: dict[str, Path], verdict: str) -> None:
    opened(browser, pages[verdict], PHONE)
    widths = asked(browser, "return [document.documentElement.scrollWidth, window.innerWidth]")
    assert widths == [PHONE[0], PHONE[0]]


@pytest.mark.parametrize("verdict", ["Good", "Explained"])
def test_dark_is_dark_and_words_stand_out(
    browser: Any, pages: dict[str, Path], verdict: str
) -> None:
    def lightness(what: str) -> float:
        colour = asked(browser, f"return getComputedStyle(document.body).{what}")
        return sum(float(part) for part in colour.split("(")[1].rstrip(")").split(",")[:3]) / 3.0

    opened(browser, pages[verdict], DESK, "dark")
    assert lightness("backgroundColor") < 64.0
    assert lightness("color") > 160.0
    opened(browser, pages[verdict], DESK, "light")
    assert lightness("backgroundColor") > 224.0
    assert lightness("color") < 96.0


def test_a_report_goes_on_paper(browser: Any, pages: dict[str, Path]) -> None:
    opened(browser, pages["Good"], DESK, "dark")
    told = browser.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.69})
    paper = base64.b64decode(told["data"])
    assert paper.startswith(b"%PDF-")
    assert 2 <= paper.count(b"/Type /Page\n") <= 12
