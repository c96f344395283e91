"""Drivers of motion units, one file each.

What to use when: `find_driver` with the name in the rig file. A driver is a module of this folder
with the name `DRIVER`, a `DriverEntry`. A driver outside this package is a module of the folder
`gyrorig_extensions/units`, see `gyrorig_protocol.module_registry`.
"""

import importlib

from gyrorig_daemon.motion.pan_tilt_driver import DriverEntry
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.module_registry import EXTENSIONS as PACKAGE
from gyrorig_protocol.module_registry import find_module, module_names
from gyrorig_protocol.suggestions import did_you_mean

EXTENSIONS = "units"


def driver_names() -> list[str]:
    """Return the names of the drivers in this folder, in alphabetical order."""
    return module_names(__path__)


def find_driver(name: str) -> DriverEntry:
    """Return a driver by its name.

    Raises:
        UsageError: there is no such driver, or its module does not name it.
    """
    module_name = find_module(__name__, __path__, EXTENSIONS, name)
    if module_name is None:
        hint = did_you_mean(name, driver_names())
        raise UsageError(
            f"there is no driver {name!r:.40} of a motion unit",
            hint
            or f"set ptu.driver in the rig file to one of {', '.join(driver_names())}, or write "
            f"the Python module {PACKAGE}.{EXTENSIONS}.{name:.40}. If it exists, add the folder of "
            f"{PACKAGE} to PYTHONPATH",
        )
    entry = getattr(importlib.import_module(module_name), "DRIVER", None)
    if not isinstance(entry, DriverEntry):
        raise UsageError(
            f"the module {module_name} does not define DRIVER, the entry of a driver",
            "write the module as the page 'Add a pan-tilt unit' describes",
        )
    return entry
