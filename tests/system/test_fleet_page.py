"""The fleet's page in a real browser, from a disk: load, search, sort, open, nothing red."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.bench.fleet.browser import chromium
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
    return Path(write_page(store, overview(store, read_origins(table))))


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    one = chromium(tmp_path_factory.mktemp("profile"))
    if one is None:
        pytest.skip("no Chromium to drive: apt-get install chromium chromium-driver, selenium")
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


def all_like(rows: list[str], *words: str) -> bool:
    return bool(rows) and all(word in row for row in rows for word in words)


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
    # letter by letter: at half a word nothing is found
    until(lambda: all_like(texts(opened, ".row"), "rig-3", "lot-3", "limited"))
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
