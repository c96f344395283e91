"""Ports of a rig.

`port_hub` is the interface; `acquisition_hub` serves real ports through a child process.
"""
