"""Measure the speed of the fleet page with many boards, in a headless Chromium and from a disk.

The page measures each time from an event to the frame that shows the result.

Run: python tests/bench/bench_fleet_page.py [--boards 100000] [--pictures FOLDER]
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.fleet.browser import PATIENCE_S, chromium
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_solver.fleet.drift import build_overview
from gyrorig_solver.fleet.drift.fleet_overview import read_origins
from gyrorig_solver.fleet.page import write_fleet_page

FREEZE_MS = 500.0  # the user notices a longer time
LOAD_MS = 10_000.0
_TIMED = """
const done = arguments[arguments.length - 1], begin = performance.now();
(() => { %s })();
requestAnimationFrame(() => setTimeout(() => done(performance.now() - begin), 0));
"""
# the effect of typing a search text
_SEARCH = "const box = document.getElementById('search'); box.value = '%s'; refresh()"
STEPS = {
    "search for a name": _SEARCH % "B0500",
    "filter by rig and trust": _SEARCH % "rig:rig-3 trust:limited",
    "filter what drifts": _SEARCH % "is:drifting",
    "show all again": _SEARCH % "",
    "sort by a number": "document.querySelectorAll('#head button')[9].click()",
    "sort by a name": "document.querySelectorAll('#head button')[3].click()",
    "scroll to the end": "document.getElementById('rows').scrollTop = 1e9",
    "show all lots and rigs": "for (const one of [...document.querySelectorAll('#groups .more')])"
    " one.click()",
    "sort lots and rigs": "document.querySelectorAll('#groups-rig th button')[4].click()",
}
_OPEN = """
const done = arguments[arguments.length - 1], begin = performance.now();
document.querySelectorAll('%s')[%d].click();
(function look() {
  if (document.querySelectorAll('%s figure').length) done(performance.now() - begin);
  else setTimeout(look, 1);
})();
"""
OPEN_BOARD = _OPEN % (".row", 5, "#board")
OPEN_GROUP = _OPEN % ("#groups-rig td button", 0, "#group")
PICTURED_FLEET = FleetPlan(  # enough nights for charts
    boards=2_000,
    nights=40,
    rigs=12,
    lots=6,
    rig_drift=(3, "misalignment_x", 28, 2e-4),
    board_drift=(17, "scale_y", 25, 4e-4),
    bad_lot=(2, "scale_z", 0.012),
    odd_board=(33, "scale_x", 0.2),
    temperature_per_c={"bias_x": 1e-3, "bias_z": -4e-4},
)


def plan_timed_fleet(boards: int) -> FleetPlan:
    """Return the plan of the fleet whose page is timed."""
    return FleetPlan(
        boards=boards,
        nights=10,
        rigs=64,
        lots=20,
        rig_drift=(3, "misalignment_x", 7, 6e-4),
        board_drift=(17, "scale_y", 6, 2e-3),
        bad_lot=(2, "scale_z", 0.004),
        odd_board=(33, "scale_x", 0.2),
    )


def write_page(folder: Path, plan: FleetPlan) -> tuple[Path, dict[str, float]]:
    """Write the page of a fleet; return it, its times and its sizes."""
    store = folder / "store"
    table = write_fleet(store, plan)
    start_s = time.process_time()
    overview = build_overview(store, read_origins(table))
    overview_end_s = time.process_time()
    page = Path(write_fleet_page(store, overview))
    return page, {
        "overview, s of CPU": overview_end_s - start_s,
        "page, s of CPU": time.process_time() - overview_end_s,
        "data.js, MB": (page.parent / "data.js").stat().st_size / 1e6,
        "histories, MB": sum(script.stat().st_size for script in page.parent.glob("history/*.js"))
        / 1e6,
    }


def measure_steps(browser: Any, page: Path) -> dict[str, float]:
    """Return the time of each step, ms."""
    browser.set_script_timeout(PATIENCE_S)
    browser.get(page.as_uri())
    ready = "return document.body.dataset.ready === 'yes'"
    while not browser.execute_script(ready):
        time.sleep(0.02)  # polling period
    figures = {"load, ms": float(browser.execute_script("return performance.now()"))}
    for name, script in STEPS.items():
        figures[f"{name}, ms"] = min(
            float(browser.execute_async_script(_TIMED % script)) for _ in range(3)
        )
    figures["open a board, ms"] = float(browser.execute_async_script(OPEN_BOARD))
    figures["open a rig, ms"] = float(browser.execute_async_script(OPEN_GROUP))
    return figures


def take_pictures(browser: Any, page: Path, folder: Path) -> None:
    """Take pictures of the page in light, dark and phone layout, with an open board and rig."""
    browser.set_script_timeout(PATIENCE_S)
    folder.mkdir(parents=True, exist_ok=True)
    for name, width, scheme in (
        ("light", 1300, "light"),
        ("dark", 1300, "dark"),
        ("phone", 390, "light"),
        ("phone-dark", 390, "dark"),
    ):
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.get("about:blank")
        browser.get(page.as_uri())
        while not browser.execute_script("return document.body.dataset.ready === 'yes'"):
            time.sleep(0.02)  # polling period
        browser.execute_script("document.getElementById('search').value = 'is:drifting'; refresh()")
        browser.execute_async_script(_OPEN % (".row", 0, "#board"))
        browser.execute_async_script(OPEN_GROUP)
        height = browser.execute_script("return document.documentElement.scrollHeight")
        size["height"] = height
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.save_screenshot(str(folder / f"fleet-{name}.png"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 if a step is too slow or the browser reports a message."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--boards", type=int, default=100_000, help="with 0, measure nothing")
    parser.add_argument(
        "--pictures", type=Path, help="write pictures of a second, small fleet to this folder"
    )
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        browser = chromium(folder / "profile")
        if browser is None:
            sys.stdout.write(
                "Chromium is not installed: apt-get install chromium chromium-driver\n"
            )
            return 0
        try:
            figures: dict[str, float] = {}
            if options.boards:
                page, figures = write_page(folder, plan_timed_fleet(options.boards))
                figures |= measure_steps(browser, page)
            if options.pictures is not None:
                take_pictures(
                    browser, write_page(folder / "pictured", PICTURED_FLEET)[0], options.pictures
                )
            complaints = [
                entry
                for entry in browser.get_log("browser")
                if entry["level"] in ("SEVERE", "WARNING")
            ]
        finally:
            browser.quit()
    sys.stdout.write(json.dumps({**figures, "complaints": len(complaints)}, indent=1) + "\n")
    slow = [
        name
        for name, value in figures.items()
        if name.endswith(", ms") and value > (LOAD_MS if name.startswith("load") else FREEZE_MS)
    ]
    for name in slow:
        sys.stderr.write(f"{name}: {figures[name]:.0f} is too slow\n")
    return int(bool(slow or complaints))


if __name__ == "__main__":
    sys.exit(main())
