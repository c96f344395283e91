"""The kinds of references, one per file: what each reads, fits and tests.

To add a kind, add a file with a `KIND`. A reference that gives the rate at each time is a
`motion_kind.MotionKind`, which needs only a reader of its motion. Any other is a
`reference_kind.ReferenceKind` with a separate fit. Extensions are in
`gyrorig_extensions/references`, see `gyrorig_protocol.module_registry`.
"""
