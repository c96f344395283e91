"""Storage of a spool or a calibration store: a folder, or a bucket of an object store (`s3://`).

What to use when: `location.storage_at` for a folder or URL that a person names;
`storage_protocol.Storage` for the operations that both have; `folder.Folder` and `bucket.Bucket`
implement it. `shipped_files.config_folders` finds the files that ship with the project.
"""

from gyrorig_solver.storage.file_writing import write_file
from gyrorig_solver.storage.folder import Folder
from gyrorig_solver.storage.input_limits import (
    cgroup_memory_bytes,
    fit_memory_bound_bytes,
    limit_fit_memory,
    limit_input,
    limit_memory_by_size,
    size_of_inputs,
)
from gyrorig_solver.storage.location import StorageOption, storage_at
from gyrorig_solver.storage.shipped_files import config_folders
from gyrorig_solver.storage.storage_protocol import Storage, StorageEntry

__all__ = [
    "Folder",
    "Storage",
    "StorageEntry",
    "StorageOption",
    "cgroup_memory_bytes",
    "config_folders",
    "fit_memory_bound_bytes",
    "limit_fit_memory",
    "limit_input",
    "limit_memory_by_size",
    "size_of_inputs",
    "storage_at",
    "write_file",
]
