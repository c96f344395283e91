"""Make the places in which the commands of a page run: a folder, a clone, a wheel's environment.

What to use when: `Places` is a context manager that makes each place once. `Places.place` returns
the place for the mark of a block. The container with a rig is in `container`.
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
from tests.docs.container import ContainerBootError, RigContainer

# With status 4, a program is done, but the data do not determine everything. With status 4, the
# doctor reports a rig that works now but has a risk. Some pages show such results.
_ACCEPT_STATUS_4 = "".join(
    f'{name}() {{ command {name} "$@" || {{ local code=$?; [ $code = 4 ] || return $code; }}; }}\n'
    for name in ("gyrorig", "gyrorigd")
)


@dataclass(frozen=True, slots=True)
class Place:
    """A folder and an environment in which commands run."""

    folder: Path  # the working folder of a command
    environment: dict[str, str]
    prefix: tuple[str, ...] = ()  # runs a command in another namespace
    preamble: str = _ACCEPT_STATUS_4

    def argv(self, *line: str) -> list[str]:
        """Return the arguments that run a command in this place."""
        return [*self.prefix, "env", f"--chdir={self.folder}", *line]


class CannotBeHereError(Exception):
    """This computer cannot have such a place; the text gives the reason."""


class Places:
    """The places that commands need, as a context manager."""

    def __init__(self, data: Path) -> None:
        """Set the environment; `place` makes each place when a block needs it.

        Args:
            data: the folder of measured data, $GYRORIG_DATA of every command.
        """
        self._resources = ExitStack()
        self._places: dict[str, Place] = {}
        self._failures: dict[str, str] = {}  # by mark, why a place could not start
        programs = Path(sys.executable).parent
        self._environment = {
            **{name: value for name, value in os.environ.items() if name != "VIRTUAL_ENV"},
            "PATH": f"{programs}:{_search_path_without(programs)}",
            "OPENBLAS_NUM_THREADS": "1",
            "GYRORIG_DATA": str(data),
            "CLONE": str(ROOT),
        }

    def __enter__(self) -> "Places":
        """Return the places; none exists yet."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Remove all places."""
        self._resources.close()

    def place(self, name: str, folder: Path) -> Place:
        """Return the place for the blocks with the mark `in NAME`.

        Args:
            name: one of `blocks.PLACES`, or "" for the folder of the reader.
            folder: the folder of the reader.

        Raises:
            CannotBeHereError: this computer cannot have this place.
        """
        if not name:
            return Place(folder, self._environment)
        if name in self._failures:
            raise CannotBeHereError(self._failures[name])
        if name not in self._places:
            make: dict[str, Callable[[Path], Place]] = {
                "bucket": self._make_bucket, "clone": self._make_clone,
                "wheel": self._make_wheel, "rig": self._make_rig,
            }  # fmt: skip
            fresh = Path(self._resources.enter_context(tempfile.TemporaryDirectory()))
            self._places[name] = make[name](fresh)
        place = self._places[name]
        # In these two places, a command runs in the folder of the reader.
        return replace(place, folder=folder) if name in ("bucket", "wheel") else place

    def _make_bucket(self, fresh: Path) -> Place:
        if requirement := ObjectStore.find_missing_requirement():
            raise CannotBeHereError(requirement)
        store = self._resources.enter_context(ObjectStore(fresh))
        return Place(fresh, {**self._environment, **store.environment}, store.prefix)

    def _make_clone(self, fresh: Path) -> Place:
        path = _search_path_without(Path(sys.executable).parent)
        return Place(_clone_checkout(fresh / "gyrorig"), {**self._environment, "PATH": path})

    def _make_wheel(self, fresh: Path) -> Place:
        for module_line in (f"hatchling build -t wheel -d {fresh}/dist", f"venv {fresh}/venv"):
            subprocess.run(
                [sys.executable, "-m", *module_line.split()],
                cwd=ROOT, check=True, capture_output=True, text=True,
            )  # fmt: skip
        path = _search_path_without(Path(sys.executable).parent)
        pins = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
        versions = fresh / "constraints.txt"  # the pip of this place cannot read digests
        versions.write_text("".join(f"{pin.split(' ')[0]}\n" for pin in pins if "==" in pin))
        wheels = " ".join(filter(None, (os.environ.get("PIP_FIND_LINKS"), str(fresh / "dist"))))
        return Place(
            fresh,
            {
                **self._environment,
                "PATH": f"{fresh / 'venv' / 'bin'}:{path}",
                "PIP_FIND_LINKS": wheels,
                "PIP_CONSTRAINT": str(versions),
            },
        )

    def _make_rig(self, fresh: Path) -> Place:
        if requirement := RigContainer.find_missing_requirement():
            raise CannotBeHereError(requirement)
        try:
            container = self._resources.enter_context(
                RigContainer(fresh, _clone_checkout(fresh / "gyrorig"))
            )
        except ContainerBootError as fault:
            self._failures["rig"] = str(fault)
            raise CannotBeHereError(str(fault)) from fault
        return Place(
            container.checkout, container.environment, container.prefix,
            _ACCEPT_STATUS_4 + container.shell,
        )  # fmt: skip


def _search_path_without(folder: Path) -> str:
    """Return $PATH without a folder."""
    folders = [
        entry for entry in os.environ.get("PATH", os.defpath).split(":") if Path(entry) != folder
    ]
    return ":".join(folders)


def _clone_checkout(to: Path) -> Path:
    """Clone the committed files of this checkout, and return the clone.

    Raises:
        CannotBeHereError: git cannot clone this checkout.
    """
    process = subprocess.run(
        ["git", "clone", "-q", str(ROOT), str(to)], capture_output=True, text=True, check=False
    )
    if process.returncode:
        raise CannotBeHereError(f"this checkout cannot be cloned: {process.stderr.strip()}")
    return to
