"""Protocols and file formats that the daemon and the solver share.

What to use when:

- `gyrorig_protocol.ptu`: the pan-tilt unit's ASCII protocol; bytes in, events out.
- `gyrorig_protocol.board`: a board's serial frames and text lines; bytes in, events out.
- `gyrorig_protocol.can`: a board's CAN frames, and other IMUs by a DBC file.
- `gyrorig_protocol.recording`: read and write recordings (MCAP, format 1).
- `gyrorig_protocol.program`: motion programs.
- `gyrorig_protocol.profile`: sensor profiles, the data sheet of a gyroscope as data.
- `gyrorig_protocol.documents`: parse untrusted YAML, write plain YAML.
- `gyrorig_protocol.errors`: the hierarchy of errors, sorted by who must act.
- `gyrorig_protocol.identity`: board names, checked.
- `gyrorig_protocol.file_kinds`, `suggestions`, `atomic_files`: small helpers.
"""
