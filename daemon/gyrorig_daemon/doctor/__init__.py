"""`gyrorigd doctor`: what is wrong with a rig, what will be tonight, and what to do.

What to use when: `examine` for the whole rig; `finding` says what a finding is. One module
a subject: `machine` this computer, `disk` where recordings go, `timekeeping` its clocks,
`ports` what stands between a program and a device, `unit` and `board` the devices
themselves, `tonight` what follows from all of it for a night without anybody.

Nothing moves: the unit is only asked. Each module looks at /proc and /sys through a
`System`, so that a test can show it any computer.
"""

from gyrorig_daemon.doctor.examine import Order, examine
from gyrorig_daemon.doctor.finding import Finding, Level, worst

__all__ = ["Finding", "Level", "Order", "examine", "worst"]
