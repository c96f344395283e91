"""Writes constraints.txt: every package that the project and its extras need, with digests.

What to use when: `make lock`, after a change of pyproject.toml or to update a package. A version
that is in the file stays, unless the package is named (`make lock ARGS="--upgrade NAME"`) or a
requirement excludes it. Needs a package index and uv.

Theory of operation. uv resolves the requirements once for all supported versions of Python. The
file then gets the digests of the wheels for Linux on x86-64 and arm64. A package that has no such
wheel, and only such a package, gets the digest of its source archive: so pip can build nothing
else from source.
"""

# ruff: noqa: S603 - the program is uv of the virtual environment
import argparse
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from locked_install import CHECKOUT, CONSTRAINTS, FROM_SOURCE, SOURCE_BUILD

PYTHONS = ("cp311", "cp312", "cp313", "cp314")
OLDEST = "3.11.5"  # the oldest that the packages of the extra docs support; the others: 3.11.0
LINUX = re.compile(r"manylinux\w*_(x86_64|aarch64)")
HEADER = """\
# The packages that the project and its extras need, with the SHA-256 digests of their wheels for
# Linux. Written by `make lock`. To update one: make lock ARGS="--upgrade NAME".
"""


def locked_packages(constraints: str, upgraded: Sequence[str]) -> list[dict[str, Any]]:
    """Return each package as a table of pylock.toml (PEP 751)."""
    pins = [line.split(" ")[0] for line in constraints.splitlines() if "==" in line]
    pins = [pin for pin in pins if pin.split("==")[0].lower() not in upgraded]
    build = tomllib.loads((CHECKOUT / "pyproject.toml").read_text("utf-8"))["build-system"]
    with tempfile.TemporaryDirectory() as name:
        constraints_file, tools, lock = (
            Path(name) / file for file in ("c.txt", "tools.in", "pylock.toml")
        )
        constraints_file.write_text("\n".join(pins))
        tools.write_text("\n".join(["pip", *SOURCE_BUILD, *build["requires"]]))
        subprocess.run(
            [
                sys.executable, "-m", "uv", "pip", "compile", "pyproject.toml", tools,
                "--all-extras", "--universal", "--python-version", OLDEST, "--generate-hashes",
                "-c", constraints_file, "--only-binary", ":all:",
                *(word for package in FROM_SOURCE for word in ("--no-binary", package)),
                "--format", "pylock.toml", "-o", lock, "-q",
            ],
            cwd=CHECKOUT, check=True,
        )  # fmt: skip
        packages: list[dict[str, Any]] = tomllib.loads(lock.read_text())["packages"]
    return packages


def digests(package: dict[str, Any]) -> Iterator[str]:
    """Yield the digests of the files of a package that may be installed."""
    wheels = [wheel for wheel in package.get("wheels", []) if is_for_here(_file_name(wheel))]
    for file in wheels or [package["sdist"]]:
        yield file["hashes"]["sha256"]


def _file_name(wheel: dict[str, Any]) -> str:
    return str(wheel["url"].rpartition("/")[2])


def is_for_here(wheel: str) -> bool:
    """Return whether a wheel is for Linux and for a supported CPython."""
    python, abi, platform = wheel.removesuffix(".whl").split("-")[-3:]
    if platform != "any" and not LINUX.search(platform):
        return False
    if abi in ("none", "abi3"):
        return "cp" not in python or abi == "abi3" or python in PYTHONS
    return abi in PYTHONS


def lock_text(packages: Sequence[dict[str, Any]]) -> str:
    """Return constraints.txt: a line for each package."""
    lines = [
        " ".join(
            [
                f"{package['name']}=={package['version']}",
                *(f"--hash=sha256:{value}" for value in sorted(digests(package))),
            ]
        )
        for package in packages
    ]
    return HEADER + "".join(f"{line}\n" for line in sorted(lines))


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the file, or compare it with what would be written; return the exit status."""
    parser = argparse.ArgumentParser(prog="lock", description=__doc__.split("\n")[0])
    parser.add_argument("--upgrade", action="append", default=[], metavar="NAME")
    parser.add_argument("--check", action="store_true", help="write nothing; 1 if it would differ")
    options = parser.parse_args(arguments)
    path = CHECKOUT / CONSTRAINTS
    present = path.read_text("utf-8")
    text = lock_text(locked_packages(present, [name.lower() for name in options.upgrade]))
    if not options.check:
        path.write_text(text, "utf-8")
        return 0
    for line in sorted(set(present.splitlines()) ^ set(text.splitlines())):
        sign = "-" if line in present else "+"
        print(sign, line.split(" ")[0])  # noqa: T201
    return int(text != present)


if __name__ == "__main__":
    sys.exit(main())
