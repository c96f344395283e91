# ruff: noqa: T201
"""Run every command that the pages print, as a reader would: `make test-docs`.

The test runs each page from the top. By default, it runs a page in a separate folder that contains
only the `config` folder of the checkout. With a mark, a block runs in a fresh clone, in an
environment with the wheel, with a bucket, or in a container with a rig (see `blocks`). Measured
data are next to the checkout or in $GYRORIG_DATA. Without the data or the place that a block
needs, the test does not run the block and prints the reason. Two workers run the pages, because
the pages on a rig mostly wait. Pages that share a place run one after the other.
"""

import argparse
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.docs.blocks import Block, DocumentError, blocks, pages  # noqa: E402
from tests.docs.output import first_difference  # noqa: E402
from tests.docs.places import CannotBeHereError, Place, Places  # noqa: E402

COMMAND_TIMEOUT_S = 600.0
SERVER_TIMEOUT_S = 60.0
WORKERS = 2


@dataclass(slots=True)
class Tally:
    """The numbers of commands of one page or of all pages, and the failures."""

    ran: int = 0
    looked: Counter[str] = field(default_factory=Counter)
    failure: str = ""

    def summary(self) -> str:
        """Return the numbers as a text."""
        looked = ", ".join(f"{reason} {count}" for reason, count in sorted(self.looked.items()))
        return f"{self.ran} run, {self.looked.total()} looked at" + (looked and f" ({looked})")


class Reader:
    """A reader who runs the commands of one page."""

    def __init__(self, folder: Path, places: Places, has_data: bool) -> None:
        shutil.copytree(ROOT / "config", folder / "config")
        self._folder = folder
        self._places = places
        self._has_data = has_data
        self._servers = ExitStack()

    def follow(self, page: Path) -> Tally:
        """Run the blocks of a page until one fails."""
        tally = Tally()
        try:
            with self._servers:
                for block in blocks(page):
                    self._process_or_fail(block, tally)
        except DocumentError as fault:
            tally.failure = str(fault)
        except OSError as fault:  # the page is unreadable, or a server fails at its end
            tally.failure = f"{page.name}: {fault}"
        return tally

    def _process_or_fail(self, block: Block, tally: Tally) -> None:
        """Process a block; the page fails if a file or a program is missing."""
        try:
            self._process(block, tally)
        except OSError as fault:
            raise DocumentError(f"{block.where}: {fault}") from fault

    def _process(self, block: Block, tally: Tally) -> None:
        if block.how == "look":
            tally.looked[block.detail] += block.count
            return
        if "$GYRORIG_DATA" in block.body and not self._has_data:
            tally.looked["data"] += block.count
            return
        try:
            place = self._places.place(block.place, self._folder)
        except CannotBeHereError as reason:
            tally.looked[f"{block.place}: {reason}"] += block.count
            return
        except (RuntimeError, subprocess.CalledProcessError) as fault:
            text = " ".join(str(getattr(fault, "stderr", None) or fault).split())
            raise DocumentError(f"{block.where}: cannot make the {block.place}: {text}") from fault
        if block.how == "save":
            saved = place.folder / block.detail
            saved.parent.mkdir(parents=True, exist_ok=True)
            saved.write_text(block.body, encoding="utf-8")
            return
        if block.how == "serve":
            self._start_server(block, place)
        else:
            self._run_block(block, place)
        tally.ran += block.count

    def _run_block(self, block: Block, place: Place) -> None:
        script = "\n".join((place.preamble, *block.before, block.body))
        line = place.argv("bash", "-euo", "pipefail", "-c", script)
        if block.kind == "python":
            for command in block.before:
                self._run_command(
                    block, place, place.argv("bash", "-euc", place.preamble + command)
                )
            line = place.argv("python", "-c", block.body)
        self._run_command(block, place, line)

    def _run_command(self, block: Block, place: Place, line: list[str]) -> None:
        try:
            process = subprocess.run(
                line, env=place.environment, stdin=subprocess.DEVNULL,
                capture_output=True, text=True, check=False, timeout=COMMAND_TIMEOUT_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise DocumentError(
                f"{block.where}: not finished after {COMMAND_TIMEOUT_S:.0f} s"
            ) from None
        if process.returncode:
            raise _exit_error(block, process.returncode, process.stderr or process.stdout)
        if block.output is None:
            return
        if fault := first_difference(block.output, process.stdout, block.last_digits):
            raise DocumentError(f"{block.where}: {fault}")

    def _start_server(self, block: Block, place: Place) -> None:
        """Start the one command of a block, which runs until the page ends."""
        process = subprocess.Popen(
            place.argv("bash", "-c", f"exec {block.body.strip()}"), env=place.environment,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._servers.callback(_stop_server, process, block)
        deadline_s = time.monotonic() + SERVER_TIMEOUT_S
        while not _is_ready(block.detail, place.folder):
            if process.poll() is not None:
                return  # `_stop_server` reports its exit status
            if time.monotonic() > deadline_s:
                raise DocumentError(
                    f"{block.where}: {block.detail} is not ready after {SERVER_TIMEOUT_S:.0f} s"
                )
            time.sleep(0.05)


def _is_ready(condition: str, folder: Path) -> bool:
    """Return whether a path exists, or HOST:PORT answers."""
    host, colon, port = condition.rpartition(":")
    if not colon:
        return (folder / condition).exists()
    with suppress(OSError), socket.create_connection((host, int(port)), timeout=1.0):
        return True
    return False


def _stop_server(process: subprocess.Popen[str], block: Block) -> None:
    process.terminate()
    try:
        _, output = process.communicate(timeout=SERVER_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise DocumentError(f"{block.where}: does not end after SIGTERM") from None
    if process.returncode:
        raise _exit_error(block, process.returncode, output)


def _exit_error(block: Block, code: int, output: str) -> DocumentError:
    return DocumentError(f"{block.where}: exit status {code}: {output.strip().splitlines()[-3:]}")


def _group_pages(paths: Sequence[Path]) -> list[list[Path]]:
    """Return the pages in groups; pages that share a place are in one group, longest first."""
    groups: dict[str, list[Path]] = {"rig": [], "clone": [], "wheel": []}
    for page in paths:
        places = {block.place for block in blocks(page)} - {""}
        groups.setdefault("+".join(sorted(places)) or str(page), []).append(page)
    return [group for group in groups.values() if group]


def _follow_group(group: Sequence[Path], data: Path) -> Tally:
    """Run the pages of a group one after the other, and print the result of each."""
    total = Tally()
    with Places(data) as places:
        for page in group:
            start_s = time.monotonic()
            with tempfile.TemporaryDirectory() as name:
                tally = Reader(Path(name), places, data.is_dir()).follow(page)
            total.ran += tally.ran
            total.looked += tally.looked
            total.failure += tally.failure and f"{tally.failure}\n"
            if tally.ran or tally.failure:
                took_s = time.monotonic() - start_s
                print(f"{page.relative_to(ROOT)}: {tally.summary()}, {took_s:.1f} s", flush=True)
    return total


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the pages of the command line, or all pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path)
    options = parser.parse_args(arguments)
    data = Path(os.environ.get("GYRORIG_DATA", ROOT.parent / "shared" / "data"))
    start_s = time.monotonic()
    total = Tally()
    paths = [path.resolve() for path in options.pages] or pages()
    try:
        groups = _group_pages(paths)
    except DocumentError as fault:
        parser.exit(1, f"{fault}\n")
    with ThreadPoolExecutor(WORKERS) as pool:
        for tally in pool.map(lambda group: _follow_group(group, data), groups):
            total.ran += tally.ran
            total.looked += tally.looked
            total.failure += tally.failure
    sys.stderr.write(total.failure)
    print(
        f"{len(paths)} pages, {total.summary()}, {total.failure.count(chr(10))} pages failed, "
        f"{time.monotonic() - start_s:.0f} s"
    )
    return 1 if total.failure else 0


if __name__ == "__main__":
    sys.exit(main())
