"""The fleet's page in a real browser, from a disk and from a server: load, search, sort, open."""

import contextlib
import json
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from tests.bench.fleet.parts import ERROR
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_solver.fleet.constants import in_words
from gyrorig_solver.fleet.overview import PARAMETERS, Overview, overview, read_origins
from gyrorig_solver.fleet.page import write_page

pytestmark = pytest.mark.pages
ROOT = Path(__file__).resolve().parents[2]
BOARDS, RIGS, LOTS = 5_000, 8, 4
PHONE_PX = 390
_PATIENCE_S = 300.0  # for what never comes true
Fleet = tuple[Path, Overview]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    """A store of 5000 boards with a page, and what is known of it."""
    store = tmp_path_factory.mktemp("fleet") / "store"
    plan = FleetPlan(
        boards=BOARDS,
        nights=15,
        rigs=RIGS,
        lots=LOTS,
        rig_drift=(3, "misalignment_x", 11, 3e-4),
        odd_board=(33, "scale_x", 0.2),
        temperature_per_c={"bias_z": 1e-3},
    )
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(ERROR, "time", 0.8e-3)  # some calibrations say less of it than the fleet
        table = write_fleet(store, plan)
    found = overview(store, read_origins(table))
    write_page(store, found)
    return store, found


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two real sessions of one emulated board, with a page, as commands make them."""
    folder = tmp_path_factory.mktemp("solved")
    rig, program = ROOT / "config" / "rig.yaml", ROOT / "config" / "programs" / "survey-40.yaml"
    record = ["record", "--simulated-time", "--config", rig, "--program", program, "--out"]
    store = folder / "store"
    for number in range(2):
        command("gyrorigd", *record, folder / "spool" / str(number))
    command("gyrorig", "batch", "--spool", folder / "spool", "--store", store, "--workers", "1")
    command("gyrorig", "fleet", store)
    return store


def command(program: str, *words: object) -> None:
    path = Path(sys.executable).with_name(program)
    subprocess.run([str(path), *map(str, words)], check=True, capture_output=True)


class WithoutListings(SimpleHTTPRequestHandler):
    """A server that gives files and shows no folder, as many are set up."""

    def list_directory(self, path: Any) -> None:
        self.send_error(404)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the library's
        pass


@contextlib.contextmanager
def at(store: Path, place: str) -> Iterator[str]:
    """Give the address of a store's page, on this disk or from a server."""
    if place == "disk":
        yield (store / "fleet" / "index.html").as_uri()
        return
    handler = partial(WithoutListings, directory=str(store))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/fleet/index.html"
        server.shutdown()


@pytest.fixture(scope="module", params=["disk", "server"])
def address(request: pytest.FixtureRequest, fleet: Fleet) -> Iterator[str]:
    with at(fleet[0], request.param) as address:
        yield address


@pytest.fixture
def opened(browser: Any, address: str) -> Any:
    return shown(browser, address)


def shown(browser: Any, address: str) -> Any:
    browser.get("about:blank")
    browser.get(address)
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
    script = "return [...document.querySelectorAll(arguments[0])].map((one) => one.textContent)"
    return list(browser.execute_script(script, selector))


def click(browser: Any, selector: str, number: int = 0) -> None:
    """Click what may be drawn anew between looking and clicking."""
    script = "document.querySelectorAll(arguments[0])[arguments[1]].click()"
    browser.execute_script(script, selector, number)


def choose(browser: Any, selector: str, value: str) -> None:
    browser.execute_script(
        "const one = document.querySelector(arguments[0]); one.value = arguments[1];"
        "one.dispatchEvent(new Event('change'))",
        selector,
        value,
    )


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


def test_it_says_what_is_the_same_on_every_unit(opened: Any, fleet: Fleet) -> None:
    lines = texts(opened, "#same li")
    told = in_words(fleet[1].constants)
    assert told
    assert [line.lower() for line in lines] == [f"{line.lower()}." for line in told]


def test_only_rows_in_sight_are_drawn(opened: Any) -> None:
    assert 10 < len(find(opened, ".row")) < 80
    opened.execute_script("document.getElementById('rows').scrollTop = 1e9")
    until(lambda: "B004999" in texts(opened, ".row")[-1])


def test_a_search_and_a_sort(opened: Any) -> None:
    search(opened, "rig:rig-3 lot-3 trust:limited")
    # letter by letter: at half a word nothing is found
    until(lambda: all_like(texts(opened, ".row"), "rig-3", "lot-3", "limited"))
    search(opened, 'lot:"lot-2" RIG:rig-6')  # in quotes it may have blanks
    until(lambda: all_like(texts(opened, ".row"), "lot-2", "rig-6"))
    search(opened, "is:odd")
    until(lambda: 0 < len(texts(opened, ".row")) < 5)
    assert any("B000033" in one for one in texts(opened, ".row"))
    search(opened, "no such board")
    until(lambda: texts(opened, "#window") == ["No board is like that."])
    search(opened, "x")
    find(opened, "#search")[0].clear()
    opened.execute_script("document.getElementById('search').dispatchEvent(new Event('input'))")
    until(lambda: texts(opened, "#count") == [""])
    find(opened, "#head button")[6].click()
    most = [int(one) for one in texts(opened, ".row span:nth-child(7)")]
    assert most == sorted(most, reverse=True)


def test_boards_that_say_less_than_the_fleet_are_found(opened: Any, fleet: Fleet) -> None:
    wanted = int(fleet[1].prior_dominated.any(axis=1).sum())
    assert 100 < wanted < BOARDS - 100
    search(opened, "is:prior")
    until(lambda: texts(opened, "#count") == [f"{wanted:,} of 5,000"])
    first = int(np.flatnonzero(fleet[1].prior_dominated.any(axis=1))[0])
    click(opened, ".row")
    until(lambda: len(find(opened, "#board figure")) == len(PARAMETERS))
    assert texts(opened, "#board h3") == [f"B{first:06d}"]
    told = [one for one in texts(opened, "#board figure") if "more the fleet's than its own" in one]
    assert len(told) == int(fleet[1].prior_dominated[first].sum())


def test_a_board_opens_with_its_charts_on_axes(opened: Any, fleet: Fleet) -> None:
    found = fleet[1]
    click(opened, ".row", 2)
    until(lambda: len(find(opened, "#board figure")) == len(PARAMETERS))
    assert texts(opened, "#board h3") == ["B000002"]
    points = found.boards.versions[2]
    assert len(find(opened, "#board figure:first-of-type .dot")) == points
    assert len(find(opened, "#board .band")) == len(find(opened, "#board .line")) == 13
    assert len(find(opened, "#board .base")) == 13
    ticks = texts(opened, "#board figure:first-of-type .tick")
    dates = [one for one in ticks if one.startswith("2026-01-")]
    assert dates[0].startswith("2026-01-0")  # its first night
    assert len(ticks) - len(dates) >= 2
    captions = texts(opened, "#board figcaption:first-of-type")
    assert sum(" rad/s" in one for one in captions) == 3
    # the page's own numbers are those of the statistics
    of = "return nightsOf(histories.get(boards.shard[2]).B000002.chart[arguments[0]]).at(-1)"
    for which, one in enumerate(found.charts):
        _, ewma, std = opened.execute_script(of, which)
        unit = float(np.sqrt(one.variance[2]))
        assert ewma == pytest.approx(one.base[2] + one.moved[2], abs=0.011 * unit)
        assert std == pytest.approx(unit, rel=0.01)


def test_temperature_is_taken_off_what_is_drawn(opened: Any, fleet: Fleet) -> None:
    which = PARAMETERS.index("bias_z")
    click(opened, ".row", 4)
    until(lambda: len(find(opened, "#board figure")) == len(PARAMETERS))
    drawn = [
        float(one.split(": ")[1])
        for one in texts(opened, f"#board figure:nth-of-type({which + 1}) .dot title")
    ]
    raw = opened.execute_script(
        "return histories.get(boards.shard[4]).B000004.points.map((one) => one[3 + arguments[0]])",
        which,
    )
    assert len(drawn) == len(raw) == fleet[1].boards.versions[4]
    assert np.std(drawn) < 0.5 * np.std(raw)  # 3e-3 of season against 4e-4 of a night's scatter


def test_a_board_of_a_drifting_rig_is_said_to_be_the_rigs(opened: Any) -> None:
    opened.execute_script(
        "open(boards.rig.of.findIndex((one) => boards.rig.names[one] === 'rig-3'))"
    )
    until(lambda: len(find(opened, "#board figure")) == len(PARAMETERS))
    (told,) = [one for one in texts(opened, "#board figure") if "not its own" in one]
    assert "misalignment x" in told
    assert "rig rig-3's, not its own: +0.00" in told


def test_lots_and_rigs_are_tables_that_sort_and_lead_to_their_boards(opened: Any) -> None:
    assert [len(find(opened, f"#groups-{kind} tbody tr")) for kind in ("rig", "lot", "site")] == [
        RIGS,
        LOTS,
        2,
    ]
    assert find(opened, "#group-column")[0].get_attribute("value") == "misalignment_x"
    assert texts(opened, "#groups-rig tbody tr:first-child td:first-child") == ["rig-3"]
    # and none of the lots and sites that its boards are of
    moved = texts(opened, "#groups-rig tbody tr:first-child td:nth-child(4)")
    assert texts(opened, "#groups td.flag") == moved
    assert texts(opened, "#groups-rig tbody tr:first-child td:nth-child(2)") == ["625"]
    states = texts(opened, "#groups-rig tbody tr:first-child td:nth-child(3)")[0]
    assert sum(int(one.split()[0].replace(",", "")) for one in states.split(", ")) >= 625
    click(opened, "#groups-rig thead button", 0)
    names = texts(opened, "#groups-rig tbody td:first-child")
    assert names == sorted(names)
    choose(opened, "#group-column", "bias_x")
    assert "mean, rad/s" in texts(opened, "#groups-lot thead button")
    click(opened, "#groups-lot tbody tr:nth-child(2) td:nth-child(2) button")
    until(lambda: texts(opened, "#count") == ["1,250 of 5,000"])
    assert find(opened, "#search")[0].get_attribute("value") == "lot:lot-1"


def test_a_rig_opens_with_its_charts(opened: Any, fleet: Fleet) -> None:
    click(opened, "#groups-rig tbody tr:first-child td:first-child button")
    until(lambda: len(find(opened, "#group figure")) == len(PARAMETERS))
    assert texts(opened, "#group h3") == ["rig-3"]
    first = texts(opened, "#group figure:first-of-type figcaption span")
    assert first[0] == "misalignment x"
    (move,) = [one for one in fleet[1].moved if one.kind == "rig"]
    score = float(first[1].split(", ")[1].removesuffix(" sd"))
    assert score == pytest.approx(move.z, rel=0.03)
    assert "rad" in first[1]
    assert find(opened, "#group figure:first-of-type .out")  # beyond its limits
    assert not find(opened, "#group figure:nth-of-type(2) .out")
    assert any(one.startswith("2026-01-1") for one in texts(opened, "#group .tick"))
    click(opened, "#group button.link", 1)
    until(lambda: texts(opened, "#count") == ["625 of 5,000"])


def test_a_page_without_groups_has_no_such_section(
    browser: Any, fleet: Fleet, tmp_path: Path
) -> None:
    write_page(fleet[0], fleet[1], tmp_path)
    script = (tmp_path / "data.js").read_text(encoding="utf-8")
    data = json.loads(script.removeprefix("FLEET(").rstrip().removesuffix(");"))
    del data["groups"]
    (tmp_path / "data.js").write_text(f"FLEET({json.dumps(data)});", encoding="utf-8")
    shown(browser, (tmp_path / "index.html").as_uri())
    assert not find(browser, "#groups-section")[0].is_displayed()
    assert find(browser, ".row")


def test_a_name_in_the_address_opens_its_board(opened: Any, address: str) -> None:
    opened.get(address + "#B000033")
    opened.refresh()
    until(lambda: texts(opened, "#board h3") == ["B000033"])


def test_a_phone_need_not_scroll_sideways(opened: Any) -> None:
    size = {"width": PHONE_PX, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        opened.refresh()
        until(lambda: opened.execute_script("return document.body.dataset.ready") == "yes")
        click(opened, ".row", 2)
        click(opened, "#groups-rig tbody tr:first-child td:first-child button")
        until(lambda: len(find(opened, "aside figure")) == 2 * len(PARAMETERS))
        width = "return document.documentElement.scrollWidth"
        assert opened.execute_script(width) <= PHONE_PX
        chart = "return document.querySelector('#board svg.chart').getBoundingClientRect().width"
        assert 300 < opened.execute_script(chart) <= PHONE_PX
    finally:
        opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_nothing_goes_wrong_on_the_way(opened: Any) -> None:
    search(opened, "south")
    find(opened, "#head button")[8].click()
    choose(opened, "#column", "bias_x")
    click(opened, ".row")
    click(opened, "#groups-site tbody button")
    until(lambda: len(find(opened, "aside figure")) == 2 * len(PARAMETERS))
    assert complaints(opened) == []


def complaints(browser: Any) -> list[Any]:
    return [one for one in browser.get_log("browser") if one["level"] in ("SEVERE", "WARNING")]


@pytest.mark.parametrize("place", ["disk", "server"])
def test_every_link_of_a_solved_board_leads_to_a_file(
    browser: Any, solved: Path, place: str
) -> None:
    with at(solved, place) as address:
        shown(browser, address)
        complaints(browser)  # those of before
        click(browser, ".row")
        until(lambda: bool(find(browser, "#board figure")))
        links = browser.execute_script(
            "return [...document.querySelectorAll('#board a')]"
            ".map((one) => [one.textContent, one.href])"
        )
        assert [words for words, _ in links] == ["report", "calibration", "v0001"]
        for _, link in links:
            if place == "disk":
                assert Path(unquote(urlsplit(link).path)).is_file(), link
            else:
                with urllib.request.urlopen(link) as answer:  # noqa: S310 - ours, on this machine
                    assert (answer.status, len(answer.read()) > 1000) == (200, True)
        for _, link in (links[0], links[2]):
            browser.get(link)
            assert "GY80-1" in browser.title + "".join(texts(browser, "h1"))
        assert complaints(browser) == []
