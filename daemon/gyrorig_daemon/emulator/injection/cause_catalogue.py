"""Every cause that an emulated rig can inject, by its id in the catalogue.

Each module of `emulator.causes` with a class that has a `name` takes part.
"""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator, Mapping
from types import MappingProxyType

from gyrorig_daemon.emulator import causes
from gyrorig_daemon.emulator.causes.cause import Cause


def _causes() -> Iterator[type[Cause]]:
    for module in pkgutil.iter_modules(causes.__path__, f"{causes.__name__}."):
        for value in vars(importlib.import_module(module.name)).values():
            is_class_here = inspect.isclass(value) and value.__module__ == module.name
            if is_class_here and issubclass(value, Cause) and "name" in vars(value):
                yield value


CAUSES: Mapping[str, type[Cause]] = MappingProxyType(
    {cause.name: cause for cause in sorted(_causes(), key=lambda cause: cause.name)}
)
