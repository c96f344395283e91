"""Modules of a folder of alternatives, such as the protocols of boards, and of extensions to it.

An extension is a module in a folder `gyrorig_extensions/NAME` on Python's search path. Therefore
a protocol or a kind of reference can be added without a change to the installed programs.
"""

import importlib
import importlib.util
import pkgutil
from collections.abc import Iterator, Sequence
from types import ModuleType

EXTENSIONS = "gyrorig_extensions"


def registered_modules(package: ModuleType, name: str) -> Iterator[ModuleType]:
    """Import and yield the modules of a package, then those of its extensions.

    Args:
        package: the folder of alternatives.
        name: of the folder with its extensions.
    """
    yield from _modules_in(package)
    if _exists(EXTENSIONS) and _exists(f"{EXTENSIONS}.{name}"):
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
    """
    if name in module_names(paths):
        return f"{package}.{name}"
    if (
        not name.isidentifier()
        or not _exists(EXTENSIONS)
        or not _exists(f"{EXTENSIONS}.{extensions}")
    ):
        return None
    full_name = f"{EXTENSIONS}.{extensions}.{name}"
    return full_name if _exists(full_name) else None


def _exists(module_name: str) -> bool:
    return importlib.util.find_spec(module_name) is not None


def _modules_in(package: ModuleType) -> Iterator[ModuleType]:
    for module in pkgutil.iter_modules(package.__path__):
        yield importlib.import_module(f"{package.__name__}.{module.name}")
