"""`gyrorigd doctor`: checks of a rig, with a remedy for each problem.

What to use when: `check_rig` for the whole rig; `finding` defines what a check reports. There is
one module per subject: `computer_check`, `disk_check`, `clock_check`, `port_check` (a port without
opening it), `unit_check` and `board_check` (the devices), `can_bus_check`, `daemon_check` (a
service that is running), and `capacity_forecast` for the coming sessions.

Nothing moves: the unit only receives queries. Every check reads /proc and /sys through a
`SystemFiles`, so that a test can use any computer.
"""

from gyrorig_daemon.doctor.doctor_command import CheckRequest, check_rig
from gyrorig_daemon.doctor.finding import Finding, Level, worst

__all__ = ["CheckRequest", "Finding", "Level", "check_rig", "worst"]
