"""The daemon: runs a calibration rig, records its sessions, and emulates rigs.

The entry points are here; `python -m gyrorig_daemon` is `gyrorigd`.
"""
