"""A headless Chromium as the fleet's page is tested and measured in."""

import shutil
from pathlib import Path
from typing import Any

WORDS = (
    "headless",
    "no-sandbox",
    "disable-gpu",
    "disable-quic",
    "no-first-run",
    "disable-background-networking",
    "disable-component-update",
    "disable-sync",
    "hide-scrollbars",
)
PATIENCE_S = 300.0  # for what hangs; a page takes a second on a quiet machine


def chromium(profile: Path, width: int = 1300, height: int = 1400) -> Any | None:
    """Return a driven browser, None where there is none to drive."""
    try:
        from selenium import webdriver  # noqa: PLC0415
    except ImportError:
        return None
    program, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if program is None or driver is None:
        return None
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for word in (*WORDS, f"window-size={width},{height}", f"user-data-dir={profile}"):
        options.add_argument(f"--{word}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options, webdriver.ChromeService(driver))
    browser.set_page_load_timeout(PATIENCE_S)
    return browser
