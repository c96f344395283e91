"""Every package that the project needs is pinned, and the pins are what runs here."""

import re
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[3]


def pinned() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line.split()[0].split("==") for line in lines if not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in pins}


def needed() -> dict[str, str]:
    """Name and installed version of everything that gyrorig with its extras needs here."""
    versions: dict[str, str] = {}
    waiting = [("gyrorig", frozenset({"solver", "dev"}))]
    visited = set()
    while waiting:
        name, extras = waiting.pop()
        if (name, extras) in visited:
            continue
        visited.add((name, extras))
        try:
            package = distribution(name)
        except PackageNotFoundError:
            continue
        versions[canonicalize_name(name)] = package.version
        for text in package.requires or []:
            requirement = Requirement(text)
            wanted = requirement.marker is None or any(
                requirement.marker.evaluate({"extra": extra}) for extra in (*extras, "")
            )
            if wanted:
                waiting.append((requirement.name, frozenset(requirement.extras)))
    del versions["gyrorig"]
    return versions


def test_every_line_is_a_version_and_digests() -> None:
    pin = r"[a-z0-9._-]+==[A-Za-z0-9.]+( --hash=sha256:[0-9a-f]{64})+"
    for line in (ROOT / "constraints.txt").read_text().splitlines():
        assert line.startswith("#") or re.fullmatch(pin, line), line


def test_everything_needed_is_pinned_to_what_runs_here() -> None:
    pins = pinned()
    assert {name: pins.get(name) for name in needed()} == needed()
