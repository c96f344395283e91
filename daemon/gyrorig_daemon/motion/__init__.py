"""Motion units of any maker: drivers, capabilities, and motion programs.

What to use when: `find_driver` gives the driver that the rig file names; `PanTiltDriver.identify`
identifies and halts a unit; `open_unit` prepares it and reads its capabilities before anything
moves; `plan_program` checks a whole program; `Executor` runs it; `halt_and_confirm` ends it.
`plan_replay` and `ReplayExecutor` do the same for the orders of a recording.
"""

from gyrorig_daemon.motion.drivers import driver_names, find_driver
from gyrorig_daemon.motion.executor import Executor, PhaseSink, halt_and_confirm
from gyrorig_daemon.motion.motion_plan import PlannedStep, plan_duration_s, plan_program
from gyrorig_daemon.motion.pan_tilt_driver import (
    AxisTarget,
    DriverEntry,
    DriverPort,
    PanTiltDriver,
    Poll,
)
from gyrorig_daemon.motion.position_poller import PositionPoller
from gyrorig_daemon.motion.ptu_exchange import Exchange, Position
from gyrorig_daemon.motion.replay import (
    RecordedExchange,
    RecordedMotion,
    RecordedPhase,
    ReplayExecutor,
    plan_replay,
)
from gyrorig_daemon.motion.unit import Unit, open_unit
from gyrorig_daemon.motion.unit_facts import Homing, UnitFacts

__all__ = [
    "AxisTarget",
    "DriverEntry",
    "DriverPort",
    "Exchange",
    "Executor",
    "Homing",
    "PanTiltDriver",
    "PhaseSink",
    "PlannedStep",
    "Poll",
    "Position",
    "PositionPoller",
    "RecordedExchange",
    "RecordedMotion",
    "RecordedPhase",
    "ReplayExecutor",
    "Unit",
    "UnitFacts",
    "driver_names",
    "find_driver",
    "halt_and_confirm",
    "open_unit",
    "plan_duration_s",
    "plan_program",
    "plan_replay",
]
