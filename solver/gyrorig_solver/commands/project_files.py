"""Where the files that ship with the project are: configurations, programs, maps."""

from pathlib import Path

from gyrorig_protocol.errors import UsageError

_CHECKOUT = Path(__file__).resolve().parents[3]


def project_file(*parts: str) -> Path:
    """Return a file below `config/`, of the working directory or else of the checkout.

    Raises:
        UsageError: there is no such file in either.
    """
    for base in (Path.cwd(), _CHECKOUT):
        path = base.joinpath("config", *parts)
        if path.is_file():
            return path
    raise UsageError(f"no file config/{'/'.join(parts)}", "run this in the project's own folder")


def project_names(folder: str) -> list[str]:
    """Return the names, without `.yaml`, of the files in a folder below `config/`."""
    found = {
        path.stem
        for base in (Path.cwd(), _CHECKOUT)
        for path in (base / "config" / folder).glob("*.yaml")
    }
    return sorted(found)
