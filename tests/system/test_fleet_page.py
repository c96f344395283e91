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

from gyrorig_solver.fleet.drift import (
    PARAMETER_COLUMNS,
    FleetOverview,
    build_overview,
    describe_offsets,
)
from gyrorig_solver.fleet.drift.fleet_overview import read_origins
from gyrorig_solver.fleet.page import write_fleet_page

pytestmark = pytest.mark.pages
ROOT = Path(__file__).resolve().parents[2]
BOARDS, RIGS, LOTS = 5_000, 8, 4
PHONE_PX = 390
_PATIENCE_S = 300.0  # for what never comes true
Fleet = tuple[Path, FleetOverview]


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
    overview = build_overview(store, read_origins(table))
    write_fleet_page(store, overview)
    return store, overview


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
def address_of(store: Path, storage: str) -> Iterator[str]:
    """Give the address of a store's page, on this disk or from a server."""
    if storage == "disk":
        yield (store / "fleet" / "index.html").as_uri()
        return
    handler = partial(WithoutListings, directory=str(store))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/fleet/index.html"
        server.shutdown()


@pytest.fixture(scope="module", params=["disk", "server"])
def address(request: pytest.FixtureRequest, fleet: Fleet) -> Iterator[str]:
    with address_of(fleet[0], request.param) as address:
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


def test_hidden_faults_are_the_first_alerts(opened: Any) -> None:
    first = texts(opened, "#alerts li b")
    assert first[0].startswith("rig-3: misalignment.x has shifted by +0.0")
    assert any("B000033 is an outlier" in item for item in first)
    assert texts(opened, ".tile b")[0] == "5,000"


def test_common_offsets_are_listed(opened: Any, fleet: Fleet) -> None:
    lines = texts(opened, "#offsets li")
    descriptions = describe_offsets(fleet[1].offset_comparisons)
    assert descriptions
    assert [line.lower() for line in lines] == [f"{line.lower()}." for line in descriptions]


def test_a_drifting_board_is_not_shown_in_green(opened: Any, fleet: Fleet) -> None:
    drifting = int(fleet[1].drifting.any(axis=1).sum())
    search(opened, "is:drifting")
    until(lambda: len(texts(opened, ".row")) == drifting)
    verdicts = texts(opened, ".row span:nth-child(2)")
    assert all(verdict.endswith(", drifting") for verdict in verdicts)
    assert not find(opened, ".row span:nth-child(2).good")


def test_only_visible_rows_are_drawn(opened: Any) -> None:
    assert 10 < len(find(opened, ".row")) < 80
    opened.execute_script("document.getElementById('rows').scrollTop = 1e9")
    until(lambda: "B004999" in texts(opened, ".row")[-1])


def test_a_search_and_a_sort(opened: Any) -> None:
    search(opened, "rig:rig-3 lot-3 verdict:limited")
    # letter by letter: at half a word nothing is found
    until(lambda: all_like(texts(opened, ".row"), "rig-3", "lot-3", "limited"))
    search(opened, 'lot:"lot-2" RIG:rig-6')  # in quotes it may have blanks
    until(lambda: all_like(texts(opened, ".row"), "lot-2", "rig-6"))
    search(opened, "is:outlier")
    until(lambda: 0 < len(texts(opened, ".row")) < 5)
    assert any("B000033" in item for item in texts(opened, ".row"))
    search(opened, "no such board")
    until(lambda: texts(opened, "#window") == ["No board matches."])
    search(opened, "x")
    find(opened, "#search")[0].clear()
    opened.execute_script("document.getElementById('search').dispatchEvent(new Event('input'))")
    until(lambda: texts(opened, "#count") == [""])
    find(opened, "#head button")[6].click()
    most = [int(item) for item in texts(opened, ".row span:nth-child(7)")]
    assert most == sorted(most, reverse=True)


def test_prior_dominated_boards_are_found(opened: Any, fleet: Fleet) -> None:
    wanted = int(fleet[1].prior_dominated.any(axis=1).sum())
    assert 100 < wanted < BOARDS - 100
    search(opened, "is:prior")
    until(lambda: texts(opened, "#count") == [f"{wanted:,} of 5,000"])
    first = int(np.flatnonzero(fleet[1].prior_dominated.any(axis=1))[0])
    click(opened, ".row")
    until(lambda: len(find(opened, "#board figure")) == len(PARAMETER_COLUMNS))
    assert texts(opened, "#board h3") == [f"B{first:06d}"]
    items = [item for item in texts(opened, "#board figure") if "mostly the fleet's mean" in item]
    assert len(items) == int(fleet[1].prior_dominated[first].sum())


def test_a_board_opens_with_its_charts_on_axes(opened: Any, fleet: Fleet) -> None:
    overview = fleet[1]
    click(opened, ".row", 2)
    until(lambda: len(find(opened, "#board figure")) == len(PARAMETER_COLUMNS))
    assert texts(opened, "#board h3") == ["B000002"]
    points = overview.boards.version_count[2]
    assert len(find(opened, "#board figure:first-of-type .dot")) == points
    assert len(find(opened, "#board .band")) == len(find(opened, "#board .line")) == 13
    assert len(find(opened, "#board .base")) == 13
    ticks = texts(opened, "#board figure:first-of-type .tick")
    dates = [item for item in ticks if item.startswith("2026-01-")]
    assert dates[0].startswith("2026-01-0")  # its first night
    assert len(ticks) - len(dates) >= 2
    captions = texts(opened, "#board figcaption:first-of-type")
    assert sum(" deg/s" in item for item in captions) == 3
    # the page's own numbers are those of the statistics
    of = "return nightsOf(histories.get(boards.shard[2]).B000002.chart[arguments[0]]).at(-1)"
    for which, item in enumerate(overview.charts):
        _, ewma, std = opened.execute_script(of, which)
        unit = float(np.sqrt(item.variance[2]))
        assert ewma == pytest.approx(item.baseline[2] + item.shift[2], abs=0.011 * unit)
        assert std == pytest.approx(unit, rel=0.01)


def test_drawn_values_are_corrected_for_temperature(opened: Any, fleet: Fleet) -> None:
    which = PARAMETER_COLUMNS.index("bias_z")
    click(opened, ".row", 4)
    until(lambda: len(find(opened, "#board figure")) == len(PARAMETER_COLUMNS))
    drawn = [
        float(item.split(": ")[1])
        for item in texts(opened, f"#board figure:nth-of-type({which + 1}) .dot title")
    ]
    raw = opened.execute_script(
        "return histories.get(boards.shard[4]).B000004.points.map((one) => one[3 + arguments[0]])",
        which,
    )
    assert len(drawn) == len(raw) == fleet[1].boards.version_count[4]
    raw_deg_s = np.rad2deg(raw)
    assert np.std(drawn) < 0.5 * np.std(
        raw_deg_s
    )  # 3e-3 of season against 4e-4 of a night's scatter


def test_a_board_of_a_drifting_rig_shows_the_shift_of_the_rig(opened: Any) -> None:
    opened.execute_script(
        "open(boards.rig.of.findIndex((one) => boards.rig.names[one] === 'rig-3'))"
    )
    until(lambda: len(find(opened, "#board figure")) == len(PARAMETER_COLUMNS))
    (shift_item,) = [item for item in texts(opened, "#board figure") if "not of this board" in item]
    assert "misalignment.x" in shift_item
    assert "shift of rig rig-3, not of this board: +0.0" in shift_item


def test_tables_of_lots_and_rigs_sort_and_select_their_boards(opened: Any) -> None:
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
    assert sum(int(item.split()[0].replace(",", "")) for item in states.split(", ")) >= 625
    click(opened, "#groups-rig thead button", 0)
    names = texts(opened, "#groups-rig tbody td:first-child")
    assert names == sorted(names)
    choose(opened, "#group-column", "bias_x")
    assert "mean, deg/s" in texts(opened, "#groups-lot thead button")
    click(opened, "#groups-lot tbody tr:nth-child(2) td:nth-child(2) button")
    until(lambda: texts(opened, "#count") == ["1,250 of 5,000"])
    assert find(opened, "#search")[0].get_attribute("value") == "lot:lot-1"


def test_a_rig_opens_with_its_charts(opened: Any, fleet: Fleet) -> None:
    click(opened, "#groups-rig tbody tr:first-child td:first-child button")
    until(lambda: len(find(opened, "#group figure")) == len(PARAMETER_COLUMNS))
    assert texts(opened, "#group h3") == ["rig-3"]
    first = texts(opened, "#group figure:first-of-type figcaption span")
    assert first[0] == "misalignment.x"
    (move,) = [item for item in fleet[1].group_shifts if item.kind == "rig"]
    score = float(first[1].split(", ")[1].removesuffix(" \N{GREEK SMALL LETTER SIGMA}"))
    assert score == pytest.approx(move.z, rel=0.03)
    assert " deg," in first[1]
    assert find(opened, "#group figure:first-of-type .out")  # beyond its limits
    assert not find(opened, "#group figure:nth-of-type(2) .out")
    assert any(item.startswith("2026-01-1") for item in texts(opened, "#group .tick"))
    click(opened, "#group button.link", 1)
    until(lambda: texts(opened, "#count") == ["625 of 5,000"])


def test_a_page_without_groups_has_no_such_section(
    browser: Any, fleet: Fleet, tmp_path: Path
) -> None:
    write_fleet_page(fleet[0], fleet[1], tmp_path)
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


def test_a_broken_address_opens_no_board_and_raises_no_error(opened: Any, address: str) -> None:
    opened.get_log("browser")  # empties it
    opened.get(address + "#%E0%A4%A")
    opened.refresh()
    until(lambda: opened.execute_script("return document.body.dataset.ready") == "yes")
    assert not find(opened, "#board")[0].is_displayed()
    assert [entry for entry in opened.get_log("browser") if entry["level"] == "SEVERE"] == []


def test_a_phone_need_not_scroll_sideways(opened: Any) -> None:
    size = {"width": PHONE_PX, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        opened.refresh()
        until(lambda: opened.execute_script("return document.body.dataset.ready") == "yes")
        click(opened, ".row", 2)
        click(opened, "#groups-rig tbody tr:first-child td:first-child button")
        until(lambda: len(find(opened, "aside figure")) == 2 * len(PARAMETER_COLUMNS))
        width = "return document.documentElement.scrollWidth"
        assert opened.execute_script(width) <= PHONE_PX
        chart = "return document.querySelector('#board svg.chart').getBoundingClientRect().width"
        assert 300 < opened.execute_script(chart) <= PHONE_PX
    finally:
        opened.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_the_browser_console_has_no_errors(opened: Any) -> None:
    search(opened, "south")
    find(opened, "#head button")[8].click()
    choose(opened, "#column", "bias_x")
    click(opened, ".row")
    click(opened, "#groups-site tbody button")
    until(lambda: len(find(opened, "aside figure")) == 2 * len(PARAMETER_COLUMNS))
    assert complaints(opened) == []


def complaints(browser: Any) -> list[Any]:
    return [item for item in browser.get_log("browser") if item["level"] in ("SEVERE", "WARNING")]


@pytest.mark.parametrize("storage", ["disk", "server"])
def test_every_link_of_a_solved_board_leads_to_a_file(
    browser: Any, solved: Path, storage: str
) -> None:
    with address_of(solved, storage) as address:
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
            if storage == "disk":
                assert Path(unquote(urlsplit(link).path)).is_file(), link
            else:
                with urllib.request.urlopen(link) as answer:  # noqa: S310 - ours, on this machine
                    assert (answer.status, len(answer.read()) > 1000) == (200, True)
        for _, link in (links[0], links[2]):
            browser.get(link)
            assert "GY80-1" in browser.title + "".join(texts(browser, "h1"))
        assert complaints(browser) == []
