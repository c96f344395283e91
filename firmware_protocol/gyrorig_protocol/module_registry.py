"""Modules of a folder of alternatives, such as the protocols of boards, and of extensions to it.

An extension is a module in a folder `gyrorig_extensions/NAME` on Python's search path. Therefore
a protocol or a kind of reference can be added without a change to the installed programs.
"""

import importlib
import importlib.util
import pkgutil
from collections.abc import Iterator
from types import ModuleType

EXTENSIONS = "gyrorig_extensions"


def registered_modules(package: ModuleType, name: str) -> Iterator[ModuleType]:
    """Import and yield the modules of a package, then those of its extensions.

    Args:
        package: the folder of alternatives.
        name: of the folder with its extensions.
    """
    yield from _modules_in(package)
    if importlib.util.find_spec(EXTENSIONS) and importlib.util.find_spec(f"{EXTENSIONS}.{name}"):
        yield from _modules_in(importlib.import_module(f"{EXTENSIONS}.{name}"))


def _modules_in(package: ModuleType) -> Iterator[ModuleType]:
    for module in pkgutil.iter_modules(package.__path__):
        yield importlib.import_module(f"{package.__name__}.{module.name}")
