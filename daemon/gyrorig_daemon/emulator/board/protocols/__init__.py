"""The emulated boards' ends of the protocols, one per file.

To add one, add a file with a `PROTOCOL`, an `EmulatedProtocol`. The daemon's end is in
`gyrorig_protocol.board_protocols`, and has the same name. Extensions are in
`gyrorig_extensions/emulated_protocols`, see `gyrorig_protocol.module_registry`.
"""
