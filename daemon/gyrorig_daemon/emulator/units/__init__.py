"""Emulated motion units, one file per driver, over the same physics.

What to use when: `find_front_end` with the name of the driver in the rig file. The front-end of a
driver outside this package is the module `gyrorig_unit_NAME_emulator` on the path of Python.
"""

import importlib
import importlib.util
import pkgutil

from gyrorig_daemon.emulator.units.front_end import FrontEnd
from gyrorig_protocol.errors import UsageError

PREFIX, SUFFIX = "gyrorig_unit_", "_emulator"


def find_front_end(name: str) -> FrontEnd:
    """Return what plays the unit of a driver.

    Raises:
        UsageError: nothing plays it.
    """
    in_folder = f"emulated_{name}" in [module.name for module in pkgutil.iter_modules(__path__)]
    module_name = f"{__name__}.emulated_{name}" if in_folder else f"{PREFIX}{name}{SUFFIX}"
    is_there = in_folder or importlib.util.find_spec(module_name) is not None
    front_end = (
        getattr(importlib.import_module(module_name), "FRONT_END", None) if is_there else None
    )
    if not isinstance(front_end, FrontEnd):
        raise UsageError(
            f"the emulator cannot play the unit of the driver {name!r}",
            f"set ptu.port in the rig file to the port of a real unit, or write the Python module "
            f"{module_name}",
        )
    return front_end
