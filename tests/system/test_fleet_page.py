"""The fleet's page in a real browser, from a disk: load, search, sort, open, nothing red."""

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_solver.fleet.overview import overview, read_origins
from gyrorig_solver.fleet.page import write_page

BOARDS = 5_000
_PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    store = tmp_path_factory.mktemp("fleet") / "store"
    plan = FleetPlan(
        boards=BOARDS,
        nights=15,
        rig_drift=(3, "misalignment_x", 11, 3e-4),
        odd_board=(33, "scale_x", 0.2),
    )
    table = write_fleet(store, plan)
    return write_page(store, store / "fleet", overview(store, read_origins(table)))


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("no Chromium here: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    profile = tmp_path_factory.mktemp("profile")
    for word in (
        "headless",
        "no-sandbox",
        "disable-gpu",
        "disable-quic",
        "no-first-run",
        "disable-background-networking",
        "disable-component-update",
        "disable-sync",
        "window-size=1300,1400",
        f"user-data-dir={profile}",
    ):
        options.add_argument(f"--{word}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    one = webdriver.Chrome(options, webdriver.ChromeService(driver))
    one.set_page_load_timeout(_PATIENCE_S)
    yield one
    one.quit()


@pytest.fixture
def opened(browser: Any, page: Path) -> Any:
    browser.get("about:blank")
    browser.get(page.as_uri())
    until(lambda: browser.execute_script("return document.body.dataset.ready") == "yes")
    return browser


def until(holds: Callable[[], bool]) -> None:
    end_s = time.monotonic() + _PATIENCE_S
    while not holds():
        assert time.monotonic() < end_s, "the page did not get there"
        time.sleep(0.02)  # between looks


def find(browser: Any, selector: str) -> list[Any]:
    return list(browser.find_elements("css selector", selector))


def texts(browser: Any, selector: str) -> list[str]:
    """Read them in one step: rows are drawn anew at any moment."""
    script = "return [...document.querySelectorAll(arguments[0])].map((one) => one.innerText)"
    return list(browser.execute_script(script, selector))


def search(browser: Any, words: str) -> None:
    (box,) = find(browser, "#search")
    box.clear()
    box.send_keys(words)


def test_it_says_first_what_was_hidden(opened: Any) -> None:
    first = texts(opened, "#worries li b")
    assert first[0].startswith("rig-3 has moved misalignment x")
    assert any("B000033 is unlike" in one for one in first)
    assert texts(opened, ".tile b")[0] == "5,000"


def test_only_rows_in_sight_are_drawn(opened: Any) -> None:
    assert 10 < len(find(opened, ".row")) < 80
    opened.execute_script("document.getElementById('rows').scrollTop = 1e9")
    until(lambda: "B004999" in texts(opened, ".row")[-1])


def test_a_search_and_a_sort(opened: Any) -> None:
    search(opened, "rig:rig-3 lot-3 trust:limited")
    until(lambda: "of 5,000" in texts(opened, "#count")[0])
    shown = texts(opened, ".row")
    assert shown
    assert all("rig-3" in one and "limited" in one for one in shown)
    search(opened, "is:odd")
    until(lambda: len(texts(opened, ".row")) < 5)
    assert any("B000033" in one for one in texts(opened, ".row"))
    search(opened, "no such board")
    until(lambda: texts(opened, "#window") == ["No board is like that."])
    search(opened, "x")
    find(opened, "#search")[0].clear()
    opened.execute_script("document.getElementById('search').dispatchEvent(new Event('input'))")
    until(lambda: texts(opened, "#count") == [""])
    version = find(opened, "#head button")[6]
    version.click()
    most = [int(one) for one in texts(opened, ".row span:nth-child(7)")]
    assert most == sorted(most, reverse=True)


def test_a_board_opens_with_its_history_and_links_to_its_files(opened: Any, page: Path) -> None:
    opened.execute_script("document.querySelectorAll('.row')[2].click()")
    until(lambda: len(find(opened, "#board figure")) == 13)
    assert texts(opened, "#board h3") == ["B000002"]
    points = find(opened, "#board polyline")[0].get_attribute("points").split()
    assert len(points) > 5
    report = str(find(opened, "#board a")[0].get_attribute("href"))
    assert report.startswith((page.parents[1] / "calib").as_uri())
    assert report.endswith(".report.html")
    opened.get(page.as_uri() + "#B000033")
    opened.refresh()
    until(lambda: texts(opened, "#board h3") == ["B000033"])


def test_nothing_goes_wrong_on_the_way(opened: Any) -> None:
    search(opened, "south")
    find(opened, "#head button")[8].click()
    opened.execute_script("document.getElementById('column').value = 'bias_x'")
    opened.execute_script("document.getElementById('column').dispatchEvent(new Event('change'))")
    assert [one for one in opened.get_log("browser") if one["level"] in ("SEVERE", "WARNING")] == []
