"""Locations: a folder or an `s3://` URL, turned into a storage."""

from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.storage.bucket import open_bucket
from gyrorig_solver.storage.folder import Folder
from gyrorig_solver.storage.storage_protocol import Storage


def storage_at(location: str | Path | Storage) -> Storage:
    """Return a folder, or a bucket for `s3://BUCKET/FOLDER`; a storage is returned as it is.

    Raises:
        UsageError: the URL is not a bucket's.
    """
    if isinstance(location, Path):
        return Folder(location)
    if isinstance(location, str):
        return open_bucket(location) if "://" in location else Folder(Path(location))
    return location


class StorageOption(click.ParamType[Storage]):
    """Type of a command-line option that takes a folder or a bucket."""

    name = "folder or s3://bucket"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Storage:
        """Return the storage at the location that was given."""
        try:
            return storage_at(value)
        except UsageError as fault:
            self.fail(str(fault), param, ctx)
