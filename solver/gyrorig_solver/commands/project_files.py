"""The files that ship with the project, as commands ask for them."""

from pathlib import Path

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.storage import config_folders


def project_file(*parts: str) -> Path:
    """Return a file below `config/`: the working directory's, the checkout's or the wheel's.

    Raises:
        UsageError: there is no such file in any.
    """
    for folder in config_folders():
        path = folder.joinpath(*parts)
        if path.is_file():
            return path
    raise UsageError(
        f"the file config/{'/'.join(parts)} of the project does not exist",
        "run the command in a clone of the project, or install the package of the project again",
    )


def project_names(folder: str) -> list[str]:
    """Return the names, without `.yaml`, of the files in a folder below `config/`."""
    return sorted(
        {path.stem for base in config_folders() for path in (base / folder).glob("*.yaml")}
    )
