"""Stop a pan-tilt unit with nothing but its serial port, without the daemon.

`standalone_halt.halt_unit` is `gyrorigd halt`; `direct_ptu_line.DirectPtuLine` is the exchange
of commands and replies on an open port, which `gyrorigd doctor` uses too.
"""
