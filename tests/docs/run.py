# ruff: noqa: T201
"""Every command that the pages print, run as a reader would: `make test-docs`.

Each page is gone through from the top in an empty folder of its own, with the checkout's
`config` in it and the commands on the path. A block is what stands between ```sh and ```, or
```python and ```. Before a block may stand how it is to be taken:

    <!-- test: look: root -->        only looked up, because of one of `REASONS`
    <!-- test: serve rig/sock -->    goes on until the page ends, begun when that path is there;
                                     told to end (SIGTERM) it has to leave with 0
    <!-- test: save table.yaml -->   the reader saves it (```yaml blocks too)

tests/unit/output/test_docs.py looks up all commands. Measured data are looked for beside the
checkout or in $GYRORIG_DATA; without them their commands are looked up.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(
    r"(?:^<!-- test: (?P<how>.*?) -->\n)?^```(?P<kind>sh|python|yaml)\n(?P<body>.*?)^```",
    re.MULTILINE | re.DOTALL,
)
REASONS = {
    "checkout": "a make target: CI and tests/docs/first_steps.py run it",
    "data": "measured data that are not here",
    "hardware": "a unit, a board, a bus or another computer",
    "motor": "moves a real unit",
    "network": "fetches from a package index",
    "root": "as root",
    "test": "run by a test of its own, with what it needs",
    "wheel": "what an installed wheel brings; tests/unit/packaging looks into one",
}
PATIENCE_S = 600.0
SERVED_WITHIN_S = 60.0
# 4 is "done, but something cannot be told from this data", and of the doctor "it works, and
# some night will not": what some pages are about.
BEFORE = "".join(
    f'{name}() {{ command {name} "$@" || {{ local code=$?; [ $code = 4 ] || return $code; }}; }}\n'
    for name in ("gyrorig", "gyrorigd")
)
# Decisions say what was. The page of measured data is made anew, commands and all, by
# `make test-pages`; some of its commands are there to be refused.
PASSED_OVER = ("decisions", "measured-data.md")


class DocumentError(Exception):
    """A page says something that cannot be carried out, or that fails."""


@dataclass(frozen=True, slots=True)
class Block:
    """Lines that a page asks its reader to run or to save."""

    page: Path
    line: int
    kind: str
    body: str
    how: str  # run, look, serve or save
    told: str  # the reason, the path, or the name

    @property
    def where(self) -> str:
        """Page and line, for an error."""
        return f"{self.page.name}:{self.line}"

    @property
    def count(self) -> int:
        """How many commands it has."""
        if self.how == "save" or self.kind == "yaml":
            return 0
        if self.kind == "python":
            return 1
        return sum(bool(line.strip()) for line in self.body.splitlines())


@dataclass(slots=True)
class Tally:
    """What became of the commands of one page, or of all."""

    ran: int = 0
    looked: Counter[str] = field(default_factory=Counter)
    failure: str = ""

    def said(self) -> str:
        """In words."""
        looked = ", ".join(f"{reason} {count}" for reason, count in sorted(self.looked.items()))
        return f"{self.ran} run, {self.looked.total()} looked at" + (looked and f" ({looked})")


def blocks(page: Path) -> Iterator[Block]:
    """Yield a page's blocks in order; data that nobody is asked to save are none.

    Raises:
        DocumentError: how a block is to be taken is not said as above.
    """
    text = page.read_text(encoding="utf-8")
    for match in BLOCK.finditer(text):
        line = text.count("\n", 0, match.start("body")) + 1
        head, _, told = (match["how"] or "run").partition(" ")
        how = head.rstrip(":")
        block = Block(page, line, match["kind"], match["body"], how, told)
        if how == "look" and told not in REASONS:
            raise DocumentError(f"{block.where}: look {told!r}: say one of {', '.join(REASONS)}")
        if how not in ("run", "look", "serve", "save") or (how in ("serve", "save") and not told):
            raise DocumentError(f"{block.where}: how is it to be taken: {match['how']!r}?")
        if block.kind != "yaml" or how == "save":
            yield block


def pages() -> list[Path]:
    """Return the pages that somebody may follow."""
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in found if not set(page.parts) & set(PASSED_OVER)]


class Reader:
    """Somebody who follows one page in an empty folder."""

    def __init__(self, folder: Path, data: Path) -> None:
        shutil.copytree(ROOT / "config", folder / "config")
        self._folder = folder
        self._has_data = data.is_dir()
        self._environment = {
            **os.environ,
            "PATH": f"{Path(sys.executable).parent}:{os.environ.get('PATH', '')}",
            "OPENBLAS_NUM_THREADS": "1",
            "GYRORIG_DATA": str(data),
        }
        self._servers = ExitStack()

    def follow(self, page: Path) -> Tally:
        """Run a page's blocks until one fails."""
        tally = Tally()
        try:
            with self._servers:
                for block in blocks(page):
                    self._take(block, tally)
        except DocumentError as fault:
            tally.failure = str(fault)
        return tally

    def _take(self, block: Block, tally: Tally) -> None:
        if block.how == "save":
            (self._folder / block.told).write_text(block.body, encoding="utf-8")
        elif block.how == "look":
            tally.looked[block.told] += block.count
        elif "$GYRORIG_DATA" in block.body and not self._has_data:
            tally.looked["data"] += block.count
        elif block.how == "serve":
            self._serve(block)
            tally.ran += block.count
        else:
            self._run(block)
            tally.ran += block.count

    def _run(self, block: Block) -> None:
        line = ["bash", "-euo", "pipefail", "-c", BEFORE + block.body]
        if block.kind == "python":
            line = [sys.executable, "-c", block.body]
        try:
            done = subprocess.run(
                line, cwd=self._folder, env=self._environment, capture_output=True, text=True,
                check=False, timeout=PATIENCE_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise DocumentError(f"{block.where}: not done within {PATIENCE_S:.0f} s") from None
        if done.returncode:
            raise _left(block, done.returncode, done.stderr or done.stdout)

    def _serve(self, block: Block) -> None:
        """Begin what goes on beside the rest of the page: one command, its own process."""
        process = subprocess.Popen(
            ["bash", "-c", f"exec {block.body.strip()}"], cwd=self._folder,
            env=self._environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._servers.callback(_end, process, block)
        end_s = time.monotonic() + SERVED_WITHIN_S
        while not (self._folder / block.told).exists():
            if process.poll() is not None:
                return  # its end is told when the page ends
            if time.monotonic() > end_s:
                raise DocumentError(f"{block.where}: no {block.told} in {SERVED_WITHIN_S:.0f} s")
            time.sleep(0.05)


def _end(process: subprocess.Popen[str], block: Block) -> None:
    process.terminate()
    try:
        _, said = process.communicate(timeout=SERVED_WITHIN_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise DocumentError(f"{block.where}: does not end when it is told to") from None
    if process.returncode:
        raise _left(block, process.returncode, said)


def _left(block: Block, code: int, said: str) -> DocumentError:
    return DocumentError(f"{block.where}: left with {code}: {said.strip().splitlines()[-3:]}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the pages named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path)
    told = parser.parse_args(arguments)
    data = Path(os.environ.get("GYRORIG_DATA", ROOT.parent / "shared" / "data"))
    whole = Tally()
    failures = []
    followed = [path.resolve() for path in told.pages] or pages()
    for page in followed:
        begun = time.monotonic()
        with tempfile.TemporaryDirectory() as name:
            tally = Reader(Path(name), data).follow(page)
        whole.ran += tally.ran
        whole.looked += tally.looked
        failures += [tally.failure] if tally.failure else []
        if tally.ran or tally.failure:
            took_s = time.monotonic() - begun
            print(f"{page.relative_to(ROOT)}: {tally.said()}, {took_s:.1f} s", flush=True)
    for failure in failures:
        print(failure, file=sys.stderr)
    print(f"{len(followed)} pages, {whole.said()}, {len(failures)} pages failed")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
