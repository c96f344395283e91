"""The pan-tilt unit as the daemon sees it, and the programs it carries out.

What to use when: `PtuClient` exchanges commands and answers; `identify_unit` knows and
halts a unit, `open_unit` makes it ready and reads its facts before anything moves;
`plan_program` checks a program as a whole; `Executor` carries it out;
`halt_and_confirm` is the way out.
"""

from gyrorig_daemon.motion.exchange import Exchange, Position
from gyrorig_daemon.motion.executor import Executor, PhaseSink, halt_and_confirm
from gyrorig_daemon.motion.facts import UnitFacts
from gyrorig_daemon.motion.plan import PlannedStep, plan_duration_s, plan_program
from gyrorig_daemon.motion.poller import Poller
from gyrorig_daemon.motion.ptu_client import PtuClient
from gyrorig_daemon.motion.unit import Homing, Unit, identify_unit, open_unit

__all__ = [
    "Exchange",
    "Executor",
    "Homing",
    "PhaseSink",
    "PlannedStep",
    "Poller",
    "Position",
    "PtuClient",
    "Unit",
    "UnitFacts",
    "halt_and_confirm",
    "identify_unit",
    "open_unit",
    "plan_duration_s",
    "plan_program",
]
