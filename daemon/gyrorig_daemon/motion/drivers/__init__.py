"""Drivers of motion units, one file each.

What to use when: `find_driver` with the name in the rig file. A driver is a module of this folder
with the name `DRIVER`, a `DriverEntry`. A driver outside this package is a module
`gyrorig_unit_NAME` on the path of Python.
"""

import importlib
import importlib.util
import pkgutil

from gyrorig_daemon.motion.pan_tilt_driver import DriverEntry
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.suggestions import did_you_mean

PREFIX = "gyrorig_unit_"


def driver_names() -> list[str]:
    """Return the names of the drivers in this folder, in alphabetical order."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__))


def find_driver(name: str) -> DriverEntry:
    """Return a driver by its name.

    Raises:
        UsageError: there is no such driver, or its module does not name it.
    """
    in_folder = name in driver_names()
    module_name = f"{__name__}.{name}" if in_folder else f"{PREFIX}{name}"
    if not in_folder and importlib.util.find_spec(module_name) is None:
        hint = did_you_mean(name, driver_names())
        raise UsageError(
            f"there is no driver {name!r} of a motion unit",
            hint
            or f"set ptu.driver in the rig file to one of {', '.join(driver_names())}, or install "
            f"the Python module {module_name}",
        )
    entry = getattr(importlib.import_module(module_name), "DRIVER", None)
    if not isinstance(entry, DriverEntry):
        raise UsageError(
            f"the module {module_name} does not define DRIVER, the entry of a driver",
            "write the module as the page 'Add a pan-tilt unit' describes",
        )
    return entry
