"""Storage of a spool or a calibration store: a folder, or a bucket of an object store (`s3://`).

What to use when: `location.storage_at` for a folder or URL that a person names;
`storage_protocol.Storage` for the operations that both have; `folder.Folder` and `bucket.Bucket`
implement it. `shipped_files.config_folders` finds the files that ship with the project.
"""
