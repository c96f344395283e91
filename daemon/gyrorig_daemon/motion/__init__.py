"""The pan-tilt unit: commands and replies, its capabilities, and motion programs.

What to use when: `PtuClient` exchanges commands and replies; `identify_unit` identifies and
halts a unit; `open_unit` prepares it and reads its capabilities before anything moves;
`plan_program` checks a whole program; `Executor` runs it; `halt_and_confirm` ends it.
"""

from gyrorig_daemon.motion.executor import Executor, PhaseSink, halt_and_confirm
from gyrorig_daemon.motion.motion_plan import PlannedStep, plan_duration_s, plan_program
from gyrorig_daemon.motion.position_poller import PositionPoller
from gyrorig_daemon.motion.ptu_client import PtuClient
from gyrorig_daemon.motion.ptu_exchange import Exchange, Position
from gyrorig_daemon.motion.unit_facts import UnitFacts
from gyrorig_daemon.motion.unit_setup import Homing, Unit, identify_unit, open_unit

__all__ = [
    "Exchange",
    "Executor",
    "Homing",
    "PhaseSink",
    "PlannedStep",
    "Position",
    "PositionPoller",
    "PtuClient",
    "Unit",
    "UnitFacts",
    "halt_and_confirm",
    "identify_unit",
    "open_unit",
    "plan_duration_s",
    "plan_program",
]
