"""Serial ports and CAN buses, and the boards on them.

`pump` is the event loop of the daemon. `ports/` has the hub, its acquisition process and the
kinds of ports; `boards/` the link to one board; `can/` buses and the boards on them.
"""
