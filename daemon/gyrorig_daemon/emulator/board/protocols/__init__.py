"""The emulated boards' ends of the protocols, one per file.

To add one, add a file with a `PROTOCOL`, an `EmulatedProtocol`, for a serial port, or a
`CAN_BOARD`, a subclass of `EmulatedCanBoard`, for a CAN bus. The daemon's end is in
`gyrorig_protocol.board_protocols`, and has the same name. Extensions are in
`gyrorig_extensions/emulated_protocols`, see `gyrorig_protocol.module_registry`.
"""
