"""Compare what the programs compute with the golden set, or make the golden set again.

What to use when: `make goldens` after any change that must not change a number, a document's
structure or an exit code; `make goldens-update` after one that must. Another source tree:

    .venv/bin/python -m tests.goldens.run --tree ../other-checkout

Every case is a command line (`cases`). Numbers agree within 1e-9 of their size; keys, ids, units
and lengths agree exactly; sentences for people are compared with --texts only (`fields`).
Exits with status 1 when anything differs.

Another processor rounds differently: with other kernels of the linear algebra library, values
of searches and covariances move by up to 1e-7 of their size, and sums over a report's figures by
5e-6. `--relative 1e-5` allows for that; on one machine results are equal to the last digit.
"""

import argparse
import fnmatch
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.goldens import storage
from tests.goldens.cases import OPTIONAL_FOLDERS, Case, all_cases
from tests.goldens.compare import RELATIVE, Difference, Rules, differences
from tests.goldens.materials import MATERIALS
from tests.goldens.tree import Tree, object_store

ROOT = Path(__file__).resolve().parents[2]
SHOWN = 5  # differences of one case that are printed without --all


@dataclass(slots=True)
class Outcome:
    """What became of one case.

    Attributes:
        status: same, different, new, updated, skipped or failed.
        seconds: how long the command took.
        differences: where its result differs.
        remark: why it was skipped or has failed.
    """

    status: str
    seconds: float = 0.0
    differences: list[Difference] = field(default_factory=list)
    remark: str = ""


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


class Runner:
    """Runs the cases of a tree, each as soon as what it needs is there."""

    def __init__(self, tree: Tree, work: Path, options: argparse.Namespace) -> None:
        """Prepare it.

        Args:
            tree: source tree under test.
            work: empty folder.
            options: of the command line.
        """
        self._tree, self._work, self._options = tree, work, options
        self._cases = all_cases()
        self.outcomes: dict[str, Outcome] = {}
        self._link("config", tree.root / "config")
        named = os.environ.get("GYRORIG_DATA")
        shared = ROOT.parent / "shared"
        self._link("data", Path(named) if named else shared / "data")
        self._link("contracts", shared / "contracts")

    def _link(self, name: str, folder: Path) -> None:
        if folder.is_dir():
            (self._work / name).symlink_to(folder.resolve())

    def _needs(self, name: str) -> frozenset[str]:
        return frozenset(MATERIALS[name].needs) if name in MATERIALS else self._cases[name].needs

    def _chosen(self) -> list[str]:
        """Return the names of all chosen cases and of what they need, in a possible order."""
        chosen: dict[str, None] = {}

        def add(name: str) -> None:
            for need in sorted(self._needs(name)):
                add(need)
            chosen.setdefault(name)

        for name in self._cases:
            if any(fnmatch.fnmatch(name, pattern) for pattern in self._options.only):
                add(name)
        return list(chosen)

    def run(self) -> None:
        """Run all chosen cases, print a line for each."""
        waiting = self._chosen()
        running: dict[Future[Outcome], str] = {}
        with ThreadPoolExecutor(self._options.jobs) as pool:
            while waiting or running:
                for name in list(self._ready(waiting, self._options.jobs - len(running))):
                    waiting.remove(name)
                    future = pool.submit(self._run_case, name)
                    running[future] = name
                finished, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in finished:
                    self._finish(running.pop(future), future)

    def _ready(self, waiting: list[str], free: int) -> Iterator[str]:
        for name in waiting:
            if free > 0 and self._needs(name) <= self.outcomes.keys():
                free -= 1
                yield name

    def _finish(self, name: str, future: "Future[Outcome]") -> None:
        fault = future.exception()
        outcome = Outcome("failed", remark=repr(fault)) if fault else future.result()
        self.outcomes[name] = outcome
        if name in MATERIALS and outcome.status == "made":
            return
        _say(f"{outcome.status:10}{outcome.seconds:6.1f} s  {name}  {outcome.remark}".rstrip())
        shown = outcome.differences if self._options.all else outcome.differences[:SHOWN]
        for difference in shown:
            _say(f"    {difference}")
        if len(outcome.differences) > len(shown):
            hidden = len(outcome.differences) - len(shown)
            _say(f"    and {hidden} more differences (--all shows them)")

    def _run_case(self, name: str) -> Outcome:
        """Run one case or make one material."""
        for need in self._needs(name):
            if self.outcomes[need].status in ("skipped", "failed"):
                return Outcome("skipped", remark=f"{need} is not there")
        if name in MATERIALS:
            material = MATERIALS[name]
            (self._work / name).mkdir()
            material.make(self._work / name, *(self._work / need for need in material.needs))
            return Outcome("made")
        case = self._cases[name]
        if missing := self._missing(case):
            return Outcome("skipped", remark=f"no {missing}: set GYRORIG_DATA to measured data")
        begun = time.monotonic()
        result = storage.as_stored(self._tree.run(case, self._work))
        return self._judged(name, result, time.monotonic() - begun)

    def _missing(self, case: Case) -> str:
        for word in case.words():
            is_optional = word.split("/")[0] in OPTIONAL_FOLDERS
            if is_optional and not (self._work / word).exists():
                return word
        return ""

    def _judged(self, name: str, result: Any, seconds: float) -> Outcome:
        old = storage.load(name)
        if self._options.update:
            is_same = old is not None and not differences(old, result, Rules(texts=True))
            if not is_same:
                storage.save(name, result)
            return Outcome("same" if is_same else "updated", seconds)
        if old is None:
            return Outcome("new", seconds, remark="no golden result: make goldens-update")
        rules = Rules(self._options.relative, self._options.texts)
        changes = differences(old, result, rules)
        return Outcome("different" if changes else "same", seconds, changes)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tree", type=Path, default=ROOT, help="source tree under test")
    parser.add_argument("--update", action="store_true", help="store what the tree computes")
    parser.add_argument("--texts", action="store_true", help="compare sentences, too")
    parser.add_argument("--relative", type=float, default=RELATIVE, help="tolerance of numbers")
    parser.add_argument("--only", nargs="+", default=["*"], help="names of cases, with stars")
    parser.add_argument("--jobs", type=int, default=2, help="processes at once")
    parser.add_argument("--all", action="store_true", help="print every difference")
    parser.add_argument("--work", type=Path, help="empty folder to keep everything in")
    return parser.parse_args()


def main() -> int:
    """Run; return the exit status."""
    options = _parse()
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="goldens-") as temporary, object_store() as store:
        work = options.work or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        tree = Tree.at(options.tree.resolve(), store)
        tree.check()
        runner = Runner(tree, work.resolve(), options)
        runner.run()
    if options.update and options.only == ["*"]:
        storage.remove_others(set(all_cases()))
    counts = Counter(outcome.status for outcome in runner.outcomes.values())
    counts.pop("made", None)
    _say("")
    for status, count in sorted(counts.items()):
        _say(f"{status:10}{count:5}")
    size = sum(path.stat().st_size for path in storage.RESULTS.glob("*.json"))
    _say(f"{sum(counts.values())} cases in {time.monotonic() - begun:.0f} s, {size / 1e6:.2f} MB")
    return 1 if counts["different"] or counts["failed"] or counts["new"] else 0


if __name__ == "__main__":
    sys.exit(main())
