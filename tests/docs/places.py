"""Where the commands of a page are run: an empty folder, a clone, a wheel's environment.

What to use when: `Places` keeps what has been made for as long as pages are followed; `place`
of a block's word and the reader's folder. The container with a rig is in `container`.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

from tests.docs.blocks import ROOT
from tests.docs.bucket import ObjectStore
from tests.docs.container import DoesNotBootError, RigsComputer

# 4 is "done, but something cannot be told from this data", and of the doctor "it works, and
# some night will not": what some pages are about.
_FOUR_IS_DONE = "".join(
    f'{name}() {{ command {name} "$@" || {{ local code=$?; [ $code = 4 ] || return $code; }}; }}\n'
    for name in ("gyrorig", "gyrorigd")
)


@dataclass(frozen=True, slots=True)
class Place:
    """Where a command is run, and how."""

    folder: Path  # where a command stands
    environment: dict[str, str]
    prefix: tuple[str, ...] = ()  # what brings a command to another place
    before: str = _FOUR_IS_DONE

    def argv(self, *line: str) -> list[str]:
        """Return the arguments that run a command there."""
        return [*self.prefix, "env", f"--chdir={self.folder}", *line]


class CannotBeHereError(Exception):
    """There can be no such place on this computer; the text says why."""


class Places:
    """What has been made to run commands in; a context."""

    def __init__(self, data: Path) -> None:
        """Nothing is made before it is asked for.

        Args:
            data: measured data, $GYRORIG_DATA of every command.
        """
        self._resources = ExitStack()
        self._made: dict[str, Place] = {}
        self._refused: dict[str, str] = {}  # words of what was tried, and why there is none
        programs = Path(sys.executable).parent
        self._environment = {
            **{name: value for name, value in os.environ.items() if name != "VIRTUAL_ENV"},
            "PATH": f"{programs}:{_path_without(programs)}",
            "OPENBLAS_NUM_THREADS": "1",
            "GYRORIG_DATA": str(data),
            "CLONE": str(ROOT),
        }

    def __enter__(self) -> "Places":
        """Begin."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take away all that was made."""
        self._resources.close()

    def place(self, word: str, folder: Path) -> Place:
        """Return where the blocks marked with `word` are run.

        Args:
            word: one of `blocks.PLACES`, or "" for the reader's own folder.
            folder: the reader's own.

        Raises:
            CannotBeHereError: not on this computer.
        """
        if not word:
            return Place(folder, self._environment)
        if word in self._refused:
            raise CannotBeHereError(self._refused[word])
        if word not in self._made:
            make: dict[str, Callable[[Path], Place]] = {
                "bucket": self._bucket, "clone": self._clone, "wheel": self._wheel,
                "rig": self._rig,
            }  # fmt: skip
            fresh = Path(self._resources.enter_context(tempfile.TemporaryDirectory()))
            self._made[word] = make[word](fresh)
        made = self._made[word]
        # A bucket and a wheel can be had anywhere.
        return replace(made, folder=folder) if word in ("bucket", "wheel") else made

    def _bucket(self, fresh: Path) -> Place:
        if why := ObjectStore.why_not():
            raise CannotBeHereError(why)
        store = self._resources.enter_context(ObjectStore(fresh))
        return Place(fresh, {**self._environment, **store.environment}, store.prefix)

    def _clone(self, fresh: Path) -> Place:
        path = _path_without(Path(sys.executable).parent)
        return Place(_cloned(fresh / "gyrorig"), {**self._environment, "PATH": path})

    def _wheel(self, fresh: Path) -> Place:
        for words in (f"hatchling build -t wheel -d {fresh}/dist", f"venv {fresh}/venv"):
            subprocess.run(
                [sys.executable, "-m", *words.split()],
                cwd=ROOT, check=True, capture_output=True, text=True,
            )  # fmt: skip
        pins = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
        versions = fresh / "constraints.txt"  # the pip of this place cannot read the digests
        versions.write_text("".join(f"{pin.split(' ')[0]}\n" for pin in pins if "==" in pin))
        wheels = " ".join(filter(None, (os.environ.get("PIP_FIND_LINKS"), str(fresh / "dist"))))
        return Place(
            fresh,
            {
                **self._environment,
                "PATH": f"{fresh / 'venv' / 'bin'}:{_path_without(Path(sys.executable).parent)}",
                "PIP_FIND_LINKS": wheels,
                "PIP_CONSTRAINT": str(versions),
            },
        )

    def _rig(self, fresh: Path) -> Place:
        if why := RigsComputer.why_not():
            raise CannotBeHereError(why)
        try:
            computer = self._resources.enter_context(
                RigsComputer(fresh, _cloned(fresh / "gyrorig"))
            )
        except DoesNotBootError as fault:
            self._refused["rig"] = str(fault)
            raise CannotBeHereError(str(fault)) from fault
        return Place(
            computer.checkout, computer.environment, computer.prefix,
            _FOUR_IS_DONE + computer.shell,
        )  # fmt: skip


def _path_without(folder: Path) -> str:
    """Return $PATH without the commands of this checkout."""
    folders = [
        entry for entry in os.environ.get("PATH", os.defpath).split(":") if Path(entry) != folder
    ]
    return ":".join(folders)


def _cloned(to: Path) -> Path:
    """Return a clone of what is committed here.

    Raises:
        CannotBeHereError: this is no clone itself.
    """
    process = subprocess.run(
        ["git", "clone", "-q", str(ROOT), str(to)], capture_output=True, text=True, check=False
    )
    if process.returncode:
        raise CannotBeHereError(f"this checkout cannot be cloned: {process.stderr.strip()}")
    return to
