"""What a person names, as a place: on the command line, and from Python."""

from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.places.bucket import bucket_at
from gyrorig_solver.places.folder import Folder
from gyrorig_solver.places.place import Place


def place_at(named: str | Path | Place) -> Place:
    """Return a folder, or a bucket for `s3://BUCKET/FOLDER`; a place is returned as it is.

    Raises:
        UsageError: a bucket of an unknown kind.
    """
    if isinstance(named, Path):
        return Folder(named)
    if isinstance(named, str):
        return bucket_at(named) if "://" in named else Folder(Path(named))
    return named


class PlaceOption(click.ParamType[Place]):
    """The type of an option or argument that names a folder or a bucket."""

    name = "folder or s3://bucket"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Place:
        """Return the place that is named."""
        try:
            return place_at(value)
        except UsageError as fault:
            self.fail(str(fault), param, ctx)
