# ruff: noqa: T201
"""Every command that the pages print, run as a reader would: `make test-docs`.

Each page is gone through from the top in an empty folder of its own, with the checkout's
`config` in it and the commands on the path; or in a fresh clone, in an environment with the
wheel, in a container with a rig: `blocks` has how a page says so. Measured data are looked for
beside the checkout or in $GYRORIG_DATA; without them, and where a place cannot be made, the
commands are looked up only, and it says so. Pages that share no place go at once, two at a time:
those on a rig wait for it most of the time.
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

PATIENCE_S = 600.0
SERVED_WITHIN_S = 60.0
AT_ONCE = 2


@dataclass(slots=True)
class Tally:
    """What became of the commands of one page, or of all."""

    ran: int = 0
    looked: Counter[str] = field(default_factory=Counter)
    failure: str = ""

    def summary(self) -> str:
        """In words."""
        looked = ", ".join(f"{reason} {count}" for reason, count in sorted(self.looked.items()))
        return f"{self.ran} run, {self.looked.total()} looked at" + (looked and f" ({looked})")


class Reader:
    """Somebody who follows one page."""

    def __init__(self, folder: Path, places: Places, has_data: bool) -> None:
        shutil.copytree(ROOT / "config", folder / "config")
        self._folder = folder
        self._places = places
        self._has_data = has_data
        self._servers = ExitStack()

    def follow(self, page: Path) -> Tally:
        """Run a page's blocks until one fails."""
        tally = Tally()
        try:
            with self._servers:
                for block in blocks(page):
                    self._take_or_fail(block, tally)
        except DocumentError as fault:
            tally.failure = str(fault)
        except OSError as fault:  # of the page itself, or when what it serves ends
            tally.failure = f"{page.name}: {fault}"
        return tally

    def _take_or_fail(self, block: Block, tally: Tally) -> None:
        """Take a block; a file or a program that is missing is a failure of the page."""
        try:
            self._take(block, tally)
        except OSError as fault:
            raise DocumentError(f"{block.where}: {fault}") from fault

    def _take(self, block: Block, tally: Tally) -> None:
        if block.how == "look":
            tally.looked[block.detail] += block.count
            return
        if "$GYRORIG_DATA" in block.body and not self._has_data:
            tally.looked["data"] += block.count
            return
        try:
            place = self._places.place(block.place, self._folder)
        except CannotBeHereError as why:
            tally.looked[f"{block.place}: {why}"] += block.count
            return
        except (RuntimeError, subprocess.CalledProcessError) as fault:
            text = " ".join(str(getattr(fault, "stderr", None) or fault).split())
            raise DocumentError(f"{block.where}: no {block.place} to run it in: {text}") from fault
        if block.how == "save":
            saved = place.folder / block.detail
            saved.parent.mkdir(parents=True, exist_ok=True)
            saved.write_text(block.body, encoding="utf-8")
            return
        if block.how == "serve":
            self._serve(block, place)
        else:
            self._run(block, place)
        tally.ran += block.count

    def _run(self, block: Block, place: Place) -> None:
        script = "\n".join((place.before, *block.before, block.body))
        line = place.argv("bash", "-euo", "pipefail", "-c", script)
        if block.kind == "python":
            for before in block.before:
                self._ran(block, place, place.argv("bash", "-euc", place.before + before))
            line = place.argv("python", "-c", block.body)
        self._ran(block, place, line)

    def _ran(self, block: Block, place: Place, line: list[str]) -> None:
        try:
            process = subprocess.run(
                line, env=place.environment, stdin=subprocess.DEVNULL,
                capture_output=True, text=True, check=False, timeout=PATIENCE_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise DocumentError(f"{block.where}: not done within {PATIENCE_S:.0f} s") from None
        if process.returncode:
            raise _left(block, process.returncode, process.stderr or process.stdout)
        if block.output is not None and (fault := first_difference(block.output, process.stdout)):
            raise DocumentError(f"{block.where}: {fault}")

    def _serve(self, block: Block, place: Place) -> None:
        """Begin what goes on beside the rest of the page: one command, its own process."""
        process = subprocess.Popen(
            place.argv("bash", "-c", f"exec {block.body.strip()}"), env=place.environment,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        self._servers.callback(_end, process, block)
        end_s = time.monotonic() + SERVED_WITHIN_S
        while not _is_there(block.detail, place.folder):
            if process.poll() is not None:
                return  # its end is told when the page ends
            if time.monotonic() > end_s:
                raise DocumentError(f"{block.where}: no {block.detail} in {SERVED_WITHIN_S:.0f} s")
            time.sleep(0.05)


def _is_there(condition: str, folder: Path) -> bool:
    """Return whether a path exists, or HOST:PORT answers."""
    host, colon, port = condition.rpartition(":")
    if not colon:
        return (folder / condition).exists()
    with suppress(OSError), socket.create_connection((host, int(port)), timeout=1.0):
        return True
    return False


def _end(process: subprocess.Popen[str], block: Block) -> None:
    process.terminate()
    try:
        _, output = process.communicate(timeout=SERVED_WITHIN_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise DocumentError(f"{block.where}: does not end when it is told to") from None
    if process.returncode:
        raise _left(block, process.returncode, output)


def _left(block: Block, code: int, output: str) -> DocumentError:
    return DocumentError(f"{block.where}: left with {code}: {output.strip().splitlines()[-3:]}")


def _together(followed: Sequence[Path]) -> list[list[Path]]:
    """Return the pages in groups: those that share a place one after the other, longest first."""
    groups: dict[str, list[Path]] = {"rig": [], "clone": [], "wheel": []}
    for page in followed:
        words = {block.place for block in blocks(page)} - {""}
        groups.setdefault("+".join(sorted(words)) or str(page), []).append(page)
    return [group for group in groups.values() if group]


def _follow(group: Sequence[Path], data: Path) -> Tally:
    """Follow pages one after the other, and say of each what became of it."""
    whole = Tally()
    with Places(data) as places:
        for page in group:
            begun_s = time.monotonic()
            with tempfile.TemporaryDirectory() as name:
                tally = Reader(Path(name), places, data.is_dir()).follow(page)
            whole.ran += tally.ran
            whole.looked += tally.looked
            whole.failure += tally.failure and f"{tally.failure}\n"
            if tally.ran or tally.failure:
                took_s = time.monotonic() - begun_s
                print(f"{page.relative_to(ROOT)}: {tally.summary()}, {took_s:.1f} s", flush=True)
    return whole


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the pages named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path)
    options = parser.parse_args(arguments)
    data = Path(os.environ.get("GYRORIG_DATA", ROOT.parent / "shared" / "data"))
    begun_s = time.monotonic()
    whole = Tally()
    followed = [path.resolve() for path in options.pages] or pages()
    try:
        groups = _together(followed)
    except DocumentError as fault:
        parser.exit(1, f"{fault}\n")
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for tally in pool.map(lambda group: _follow(group, data), groups):
            whole.ran += tally.ran
            whole.looked += tally.looked
            whole.failure += tally.failure
    sys.stderr.write(whole.failure)
    print(
        f"{len(followed)} pages, {whole.summary()}, {whole.failure.count(chr(10))} pages failed, "
        f"{time.monotonic() - begun_s:.0f} s"
    )
    return 1 if whole.failure else 0


if __name__ == "__main__":
    sys.exit(main())
