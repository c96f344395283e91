"""Data sheets of sensors: `config/boards/<sensor>.yaml`."""

import re

from gyrorig_protocol.profile import SensorProfile, parse_profile
from gyrorig_solver.storage import config_folders

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,40}")


def find_profile(sensor: str) -> SensorProfile | None:
    """Return the profile of a sensor, None if there is none.

    The search order is the working directory, the source checkout, and the installed package.

    Raises:
        UsageError: the file is not a profile.
    """
    if not _NAME.fullmatch(sensor):  # text from a recording is not used as a path unchecked
        return None
    for folder in config_folders():
        path = folder / "boards" / f"{sensor}.yaml"
        if path.is_file():
            return parse_profile(path.read_bytes(), str(path))
    return None
