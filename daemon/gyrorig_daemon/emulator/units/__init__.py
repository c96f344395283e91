"""Emulated motion units, one file per driver, over the same physics.

What to use when: `find_front_end` with the name of the driver in the rig file. The front-end of a
driver outside this package is the module `emulated_NAME` of the folder
`gyrorig_extensions/emulated_units`, see `gyrorig_protocol.module_registry`.
"""

import importlib

from gyrorig_daemon.emulator.units.front_end import FrontEnd
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.module_registry import EXTENSIONS, find_module

FOLDER = "emulated_units"


def find_front_end(name: str) -> FrontEnd:
    """Return what plays the unit of a driver.

    Raises:
        UsageError: nothing plays it.
    """
    module_name = find_module(__name__, __path__, FOLDER, f"emulated_{name}")
    front_end = (
        None
        if module_name is None
        else getattr(importlib.import_module(module_name), "FRONT_END", None)
    )
    if not isinstance(front_end, FrontEnd):
        raise UsageError(
            f"the emulator cannot play the unit of the driver {name!r:.40}",
            "set ptu.port in the rig file to the port of a real unit, or write the Python module "
            f"{EXTENSIONS}.{FOLDER}.emulated_{name:.40}. If it exists, add the folder of "
            f"{EXTENSIONS} to PYTHONPATH",
        )
    return front_end
