"""Modules of a folder of alternatives, such as the protocols of boards, and of extensions to it.

An extension is a module in a folder `gyrorig_extensions/NAME` on Python's search path. Therefore
a protocol or a kind of reference can be added without a change to the installed programs.

An extension is code. The current folder can contain files of other people, therefore extensions in
it are refused unless PYTHONPATH contains its absolute path. `PYTHONPATH=.`, an empty entry of
PYTHONPATH and `python -m` also put the current folder on the search path, and name no folder.
"""

import importlib
import importlib.util
import os
import pkgutil
from collections.abc import Iterator, Sequence
from types import ModuleType

from gyrorig_protocol.errors import UsageError

EXTENSIONS = "gyrorig_extensions"


def registered_modules(package: ModuleType, name: str) -> Iterator[ModuleType]:
    """Import and yield the modules of a package, then those of its extensions.

    Args:
        package: the folder of alternatives.
        name: of the folder with its extensions.

    Raises:
        UsageError: the extensions are in the current folder, which PYTHONPATH does not name.
    """
    yield from _modules_in(package)
    if _extensions_exist() and _exists(f"{EXTENSIONS}.{name}"):
        yield from _modules_in(importlib.import_module(f"{EXTENSIONS}.{name}"))


def module_names(paths: Sequence[str]) -> list[str]:
    """Return the names of the modules in a package's folders, in alphabetical order."""
    return sorted(module.name for module in pkgutil.iter_modules(paths))


def find_module(package: str, paths: Sequence[str], extensions: str, name: str) -> str | None:
    """Return the full name of one alternative without importing it, None if it does not exist.

    Args:
        package: the folder of alternatives.
        paths: its `__path__`.
        extensions: the folder of its extensions.
        name: of the alternative, an untrusted word.

    Raises:
        UsageError: the extensions are in the current folder, which PYTHONPATH does not name.
    """
    if name in module_names(paths):
        return f"{package}.{name}"
    if (
        not name.isidentifier()
        or not _extensions_exist()
        or not _exists(f"{EXTENSIONS}.{extensions}")
    ):
        return None
    full_name = f"{EXTENSIONS}.{extensions}.{name}"
    return full_name if _exists(full_name) else None


def _extensions_exist() -> bool:
    spec = importlib.util.find_spec(EXTENSIONS)
    if spec is None:
        return False
    # The parent of each folder is the entry of the search path in which it was found.
    found_in = {
        os.path.realpath(f"{folder}/..") for folder in spec.submodule_search_locations or ()
    }
    if found_in & _unnamed_current_folder():
        raise UsageError(
            f"the current folder contains {EXTENSIONS}, whose code is not run, because PYTHONPATH "
            "does not contain the absolute path of the folder",
            'if you trust the folder, run `export PYTHONPATH="$PWD"`; otherwise use another '
            "current folder, and remove `.` and empty entries from PYTHONPATH",
        )
    return True


def _unnamed_current_folder() -> set[str]:
    """Return the current folder, unless PYTHONPATH contains its absolute path."""
    entries = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    named = {os.path.realpath(entry) for entry in entries if entry.startswith(os.sep)}
    try:
        return {os.path.realpath(".")} - named
    except FileNotFoundError:  # the current folder was deleted
        return set()


def _exists(module_name: str) -> bool:
    return importlib.util.find_spec(module_name) is not None


def _modules_in(package: ModuleType) -> Iterator[ModuleType]:
    for module in pkgutil.iter_modules(package.__path__):
        yield importlib.import_module(f"{package.__name__}.{module.name}")
