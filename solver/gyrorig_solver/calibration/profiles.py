"""Finding the data sheet of a sensor: `config/boards/<sensor>.yaml`."""

import re

from gyrorig_protocol.profile import SensorProfile, parse_profile
from gyrorig_solver.shipped import config_folders

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,40}")


def find_profile(sensor: str) -> SensorProfile | None:
    """Return the profile of a sensor, None where there is none.

    Looked for below the working directory, then below the checkout that this code runs from,
    then among the files that came with the wheel.

    Raises:
        UsageError: there is a file of that name, and it is not a profile.
    """
    if not _NAME.fullmatch(sensor):  # a recording's text is not trusted with a path
        return None
    for folder in config_folders():
        path = folder / "boards" / f"{sensor}.yaml"
        if path.is_file():
            return parse_profile(path.read_bytes(), str(path))
    return None
