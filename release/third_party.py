"""Writes THIRD-PARTY.md: the packages that an installation of the service contains, and licences.

What to use when: `make third-party`, after a change of constraints.txt. A test compares the file
with the packages of the virtual environment.
"""

# ruff: noqa: E501 - lines of the document, which are as long as those of the others
import re
from collections.abc import Iterator
from email.message import Message
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import cast

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PATH = Path(__file__).resolve().parents[1] / "THIRD-PARTY.md"
EXTRAS = ("solver", "fleet")  # as in systemd/install.py
# Packages whose metadata name no licence, with the licence of their licence file.
BY_FILE = {"mcap": "MIT"}
COPYLEFT = re.compile(r"\b[AL]?GPL", re.IGNORECASE)
TEXT = """\
# Third-party packages

Gyrorig has the licence [MIT](LICENSE). An installation of the service (`make install-service`, `make deb`) contains the packages in
the table below, each under its own licence. The texts of the licences are in the folder `*.dist-info` of each package, below
`/opt/gyrorig/lib/python3.*/site-packages`. `make third-party` writes this file, for Python 3.11; with newer versions of Python, some of the
packages are not needed.

{copyleft}

| package | version | licence |
|---|---|---|
{rows}
"""
LGPL = """\
Packages with a licence that has conditions for redistribution: {names}. Gyrorig imports them unchanged, as separate
files, so you can replace them by another version: `/opt/gyrorig/bin/python -m pip install NAME==VERSION`. Their source archives, with the
versions in the table, are in the Python Package Index. The wheels of numpy and scipy contain the libraries OpenBLAS (BSD-3-Clause),
libgfortran (GPL-3.0 with the GCC runtime library exception) and libquadmath (LGPL-2.1), also as separate files. If you pass on an image or
a Debian package, pass on this file and the folders `*.dist-info` with it."""


def closure() -> dict[str, Distribution]:
    """Return each package that gyrorig with the extras of the service needs, by name."""
    packages: dict[str, Distribution] = {}
    visited: set[tuple[str, str]] = set()
    waiting = [("pip", ""), *(("gyrorig", extra) for extra in ("", *EXTRAS))]
    while waiting:
        name, extra = waiting.pop()
        if (name, extra) in visited:
            continue
        visited.add((name, extra))
        packages[canonicalize_name(name)] = distribution(name)
        for text in distribution(name).requires or []:
            needed = Requirement(text)
            if needed.marker is None or needed.marker.evaluate({"extra": extra}):
                waiting += [(needed.name, inner) for inner in ("", *needed.extras)]
    del packages["gyrorig"]
    return dict(sorted(packages.items()))


def licence(package: Distribution) -> str:
    """Return the licence of a package: its expression, its classifiers or its own words."""
    metadata = cast("Message", package.metadata)
    expression = metadata.get("License-Expression")
    if expression:
        return str(expression)
    classifiers = list(_classified(metadata))
    words = str(metadata.get("License") or "").strip()
    if classifiers:
        return ", ".join(classifiers)
    if words and "\n" not in words:
        return words
    return BY_FILE[canonicalize_name(package.name)]


def _classified(metadata: Message) -> Iterator[str]:
    for text in metadata.get_all("Classifier") or []:
        if text.startswith("License :: ") and text != "License :: OSI Approved":
            yield text.rpartition(" :: ")[2]


def document() -> str:
    """Return the text of the file."""
    packages = closure()
    licences = {name: licence(package) for name, package in packages.items()}
    names = [name for name, text in licences.items() if COPYLEFT.search(text)]
    rows = [f"| {name} | {packages[name].version} | {text} |" for name, text in licences.items()]
    copyleft = LGPL.format(names=", ".join(f"`{name}` ({licences[name]})" for name in names))
    return TEXT.format(copyleft=copyleft, rows="\n".join(rows))


if __name__ == "__main__":
    PATH.write_text(document(), encoding="utf-8")
