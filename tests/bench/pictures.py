# ruff: noqa: T201
"""What a person sees of the project, as pages made anew and as pictures of them.

What to use when: `reports` for one page of each verdict; as a program for docs/img, of which
docs/pictures.md is the list. Needs chromium, chromedriver and selenium.

Run: python tests/bench/pictures.py --pictures FOLDER [--all]
"""

import argparse
import html
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.fleet.browser import chromium

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
DONE, NOT_IDENTIFIABLE, REFUSED = 0, 4, 3
# What no cause of the catalogue is, at nine times its detectable size: the gain drops near one
# tilt. Drawn and sized by tests/hidden/truth, line 7001 of fast_tier.json.
OUTSIDE = 7001
# width and height in CSS pixels, whether it is a phone, and the colours asked for
LOOKS = {
    "light": (1000, 1250, False, "light"),
    "dark": (1000, 1250, False, "dark"),
    "phone": (390, 1250, True, "light"),
}
# of the page of pictures: file, page, look
SHOWN = (
    ("report-good", "Good", "light"),
    ("report-good-phone", "Good", "phone"),
    ("report-limited", "Limited", "light"),
    ("report-refused", "Refused", "light"),
    ("report-cause", "Problem found", "dark"),
    ("report-unexplained", "Not fully explained", "light"),
    ("status", "Status", "dark"),
)
COLOURS = 256  # of a picture's palette: a page is some 60 kB
STATUS_STEP = 12  # of the session that is watched
PATIENCE_S = 120.0
TERMINAL = """<!doctype html><meta charset="utf-8"><title>status</title><style>
html{background:#14181d}pre{color:#d8dee6;font:13px/1.5 "DejaVu Sans Mono",monospace;
margin:0;padding:22px;white-space:pre-wrap}b{color:#7fd1c7;font-weight:400}</style>
<pre><b>$ gyrorigd status</b>
%s</pre>"""


def record(out: Path, program: str, *more: str) -> Path:
    """Record a session of the emulated rig faster than time."""
    command = [BIN / "gyrorigd", "record", "--simulated-time", "--seed", "2", "--out", out]
    command += ["--config", ROOT / "config" / "rig.yaml"]
    command += ["--program", ROOT / "config" / "programs" / f"{program}.yaml"]
    subprocess.run([*map(str, command), *more], check=True, capture_output=True)
    return next(out.glob("*.mcap"))


def record_outside(folder: Path) -> Path:
    """Record a session with something in it that is in no catalogue, by another program."""
    folder.mkdir(parents=True)
    every = json.loads((ROOT / "tests" / "hidden" / "fast_tier.json").read_text(encoding="utf-8"))
    (line,) = (entry for entry in every if entry["seed"] == OUTSIDE)
    (folder / "lines.json").write_text(json.dumps([line]), encoding="utf-8")
    program = ROOT / "tests" / "hidden" / "record_fast.py"
    words = [sys.executable, program, "--out", folder, "--lines", folder / "lines.json"]
    subprocess.run([*map(str, words)], check=True, capture_output=True)
    return next(folder.glob("*.mcap"))


def made(out: Path, *command: str | Path) -> Path:
    """Run a command that writes a page into `out`, and return it, not that of its findings."""
    words = [str(BIN / "gyrorig"), *map(str, command), "--out", str(out)]
    process = subprocess.run(words, check=False, capture_output=True, text=True)
    if process.returncode not in (DONE, NOT_IDENTIFIABLE, REFUSED):
        raise RuntimeError(f"{' '.join(words)}: left with {process.returncode}: {process.stderr}")
    (page,) = (path for path in out.rglob("*.html") if not path.name.endswith(".findings.html"))
    return page


def reports(folder: Path) -> dict[str, Path]:
    """Make one report of each verdict; the names are the words that stand first in them."""
    sound = record(folder / "sound", "survey-40")
    short = record(folder / "short", "quick")
    worn = record(folder / "worn", "quick", "--hide", "backlash@tilt")
    still = record(folder / "still", "static")
    strange = record_outside(folder / "strange")
    return {
        "Good": made(folder / "good", "solve", sound),
        "Limited": made(folder / "limited", "solve", still),
        "Refused": made(folder / "refused", "solve", short, "--method", "paper"),
        "Problem found": made(folder / "explained", "explain", worn),
        "Not fully explained": made(folder / "unexplained", "explain", strange),
    }


def status_page(folder: Path) -> Path:
    """Watch a session of an emulated rig in real time; return the status as a page."""
    folder.mkdir(parents=True)
    # the sample's names are the page's; a path of a temporary folder says nothing to anybody
    rig, program = ROOT / "config" / "rig.yaml", ROOT / "config" / "programs" / "survey-130.yaml"
    gyrorigd = str(BIN / "gyrorigd")
    words = [gyrorigd, "run", "--config", str(rig), "--state", "rig", "--socket", "sock"]
    daemon = subprocess.Popen(words, cwd=folder, stderr=subprocess.DEVNULL)
    try:
        _until(daemon, (folder / "rig" / "metrics" / "gyrorig.prom").exists)
        order = [gyrorigd, "enqueue", "--program", str(program)]
        order += ["--session", "monday", "--state", "rig"]
        subprocess.run(order, cwd=folder, check=True, capture_output=True)

        def asked(*more: str) -> str:
            words = [gyrorigd, "status", "--socket", "sock", *more]
            return subprocess.run(
                words, cwd=folder, check=True, capture_output=True, text=True
            ).stdout

        def is_there() -> bool:
            session = json.loads(asked("--json"))["session"] or {}
            return int(session.get("step", 0)) >= STATUS_STEP

        _until(daemon, is_there)
        status = asked()
    finally:
        daemon.terminate()
        daemon.wait(PATIENCE_S)
    page = folder / "status.html"
    page.write_text(TERMINAL % html.escape(status), encoding="utf-8")
    return page


def _until(process: subprocess.Popen[bytes], so: Any) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not so():
        if process.poll() is not None or time.monotonic() > end_s:
            raise RuntimeError("the emulated rig is not in service")
        time.sleep(0.2)


def opened(browser: Any, page: Path, look: str) -> None:
    """Show a page as one of `LOOKS`."""
    width, height, mobile, scheme = LOOKS[look]
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile},
    )
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    browser.get(page.as_uri())


def picture(browser: Any, page: Path, look: str, path: Path) -> None:
    """Take a picture of the page's upper part, with a palette; a short page whole."""
    from PIL import Image  # noqa: PLC0415 - of the pictures alone

    opened(browser, page, look)
    path.parent.mkdir(parents=True, exist_ok=True)
    browser.save_screenshot(str(path))
    tall = int(browser.execute_script("return document.body.getBoundingClientRect().bottom")) + 1
    with Image.open(path) as taken:
        width, height = taken.size
        small = taken.convert("RGB").crop((0, 0, width, min(tall, height)))
    # a thin line's colour is rare, and has to stay
    small.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        path, optimize=True
    )


def every_look(pages: Mapping[str, Path]) -> list[tuple[str, str, str]]:
    """Return each page in each look, as `SHOWN` has them."""
    return [
        (f"{name.lower().replace(' ', '-')}-{look}", name, look) for name in pages for look in LOOKS
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the pages, and take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pictures", type=Path, required=True, help="where they go")
    parser.add_argument("--all", action="store_true", help="each page, light, dark and on a phone")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        browser = chromium(folder / "profile")
        if browser is None:
            print("no Chromium here: apt-get install chromium chromium-driver; selenium")
            return 1
        try:
            pages = {**reports(folder), "Status": status_page(folder / "service")}
            for name, page, look in every_look(pages) if options.all else SHOWN:
                path = options.pictures / f"{name}.png"
                picture(browser, pages[page], look, path)
                print(f"{path}: {path.stat().st_size / 1e3:.0f} kB", flush=True)
        finally:
            browser.quit()
    return 0


if __name__ == "__main__":
    sys.exit(main())
