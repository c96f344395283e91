# ruff: noqa: T201
"""Every command that the pages print, run as a reader would: `make test-docs`.

Each page is gone through from the top in an empty folder of its own, with the checkout's
`config` in it and the commands on the path. A block is what stands between ```sh and ```; one
before which `<!-- test: look -->` stands needs hardware, root or real time and is only looked
up (tests/unit/output/test_docs.py does that for all). ```python blocks are run too. Measured data
are looked for beside the checkout or in $GYRORIG_DATA; without them their commands are looked up.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(
    r"(?P<look><!-- test: look -->\n)?^```(?P<kind>sh|python)\n(?P<body>.*?)^```",
    re.MULTILINE | re.DOTALL,
)
PATIENCE_S = 600.0
# 4 is "done, but something cannot be told from this data": what some pages are about.
BEFORE = 'gyrorig() { command gyrorig "$@" || test $? = 4; }\n'
# Decisions say what was. The page of measured data is made anew, commands and all, by
# `make test-pages`; some of its commands are there to be refused.
PASSED_OVER = ("decisions", "measured-data.md")


@dataclass(frozen=True, slots=True)
class Block:
    """Lines that a page asks its reader to run."""

    page: Path
    line: int
    kind: str
    body: str
    only_looked_at: bool


def blocks(page: Path) -> Iterator[Block]:
    """Yield a page's blocks in order."""
    text = page.read_text(encoding="utf-8")
    for match in BLOCK.finditer(text):
        line = text.count("\n", 0, match.start("body")) + 1
        yield Block(page, line, match["kind"], match["body"], match["look"] is not None)


def pages() -> list[Path]:
    """Return the pages that somebody may follow."""
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in found if not set(page.parts) & set(PASSED_OVER)]


def run_page(page: Path) -> tuple[int, int, str]:
    """Run a page's blocks; return how many commands ran, how many were looked at, what failed."""
    ran = looked = 0
    data = Path(os.environ.get("GYRORIG_DATA", ROOT.parent / "shared" / "data"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(ROOT / "config", folder / "config")
        environment = {
            **os.environ,
            "PATH": f"{Path(sys.executable).parent}:{os.environ.get('PATH', '')}",
            "OPENBLAS_NUM_THREADS": "1",
            "GYRORIG_DATA": str(data),
        }
        for block in blocks(page):
            count = sum(bool(line.strip()) for line in block.body.splitlines())
            if block.only_looked_at or ("$GYRORIG_DATA" in block.body and not data.is_dir()):
                looked += count
                continue
            line = ["bash", "-euo", "pipefail", "-c", BEFORE + block.body]
            if block.kind == "python":
                line = [sys.executable, "-c", block.body]
                count = 1
            try:
                done = subprocess.run(
                    line, cwd=folder, env=environment, capture_output=True, text=True,
                    check=False, timeout=PATIENCE_S,
                )  # fmt: skip
            except subprocess.TimeoutExpired:
                return ran, looked, f"{page.name}:{block.line}: not done within {PATIENCE_S:.0f} s"
            if done.returncode:
                said = (done.stderr or done.stdout).strip().splitlines()[-3:]
                return ran, looked, f"{page.name}:{block.line}: left with {done.returncode}: {said}"
            ran += count
    return ran, looked, ""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the pages named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path)
    told = parser.parse_args(arguments)
    ran = looked = 0
    failures = []
    for page in [path.resolve() for path in told.pages] or pages():
        begun = time.monotonic()
        now, seen, failure = run_page(page)
        ran, looked = ran + now, looked + seen
        failures += [failure] if failure else []
        if now or failure:
            took_s = time.monotonic() - begun
            print(
                f"{page.relative_to(ROOT)}: {now} run, {seen} looked at, {took_s:.1f} s", flush=True
            )
    for failure in failures:
        print(failure, file=sys.stderr)
    print(f"{ran} commands run, {looked} looked at, {len(failures)} pages failed")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
