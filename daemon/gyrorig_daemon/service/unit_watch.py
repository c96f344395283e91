"""The unit between sessions: halted before anything else, known, and asked whether it is there.

What to use when: `first_halt` once a rig is open; `UnitWatch.look` from the daemon's idle
loop. Nothing here moves anything. A unit that was away is unknown until it has said again
who it is, and is halted then: somebody may have given it orders meanwhile.
"""

import random
from enum import Enum

from gyrorig_daemon.config import PTU_PORT
from gyrorig_daemon.links.pump import Pump
from gyrorig_daemon.motion import PtuClient, UnitFacts, identify_unit
from gyrorig_daemon.rig import Rig
from gyrorig_daemon.service.counts import ServiceCounts
from gyrorig_daemon.service.memory import Memory
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import Axis, Quantity, query, read
from gyrorig_protocol.ptu.commands import HALT

RETRY_S = 2.0  # reference: reliability.md section 3 row 1
LOOK_EVERY_S = 2.0
SILENT_LOOKS = 2
REOPEN_AFTER = 3  # greetings in vain: a driver may be wedged (reference: as above, row 6)


class UnitState(Enum):
    """What is known of the unit; the value is what a person is told."""

    ABSENT = "its port is not there"
    SILENT = "it does not answer"
    STANDS = "it stands"


def first_halt(rig: Rig) -> None:
    """Tell the unit to halt before anything else is said to it.

    Whoever is on the port stops sooner so, and no device is moved by it.
    """
    if rig.pump.is_up(PTU_PORT):
        try:
            rig.pump.write(PTU_PORT, b"   " + HALT.encode())
        except DeviceError:
            return  # it is asked again as soon as it can be


class UnitWatch:
    """Knows whether the unit is there, and halts it whenever it comes."""

    def __init__(self, rig: Rig, memory: Memory, counts: ServiceCounts, seed: int) -> None:
        self._memory = memory
        self._counts = counts
        self._pump: Pump = rig.pump
        self._client: PtuClient = rig.client
        self._rng = random.Random(seed)  # noqa: S311 - moments, not secrets
        self.state = UnitState.ABSENT
        self.why = ""
        self._silent = 0
        self._in_vain = 0
        self._facts: UnitFacts | None = None
        self._steps: dict[Axis, int] = {}
        self._next_axis = Axis.PAN
        self._due_ns = rig.pump.now_ns()

    @property
    def angles_rad(self) -> tuple[float, float] | None:
        """Where pan and tilt stand between sessions; None until a session knew the unit.

        What a step is worth a unit says in a session; one that was away may be another unit.
        """
        facts = self._facts
        if facts is None or len(self._steps) < len(Axis):
            return None
        return (
            facts.pan.to_rad(self._steps[Axis.PAN]),
            facts.tilt.to_rad(self._steps[Axis.TILT]),
        )

    def look(self) -> UnitState:
        """Make sure of the unit, if that is due."""
        if not self._pump.is_up(PTU_PORT) or self._client.gone:
            if self.state is not UnitState.ABSENT:
                self.lose(UnitState.ABSENT, "its port hung up")
            if not self._pump.is_up(PTU_PORT):
                return self.state
        if self.state is UnitState.STANDS and not self._client.identified:
            self.lose(UnitState.SILENT, "its port went away for a moment")
        if self._pump.now_ns() < self._due_ns:
            return self.state
        if self.state is UnitState.STANDS:
            self._ask()
        else:
            self._greet()
        wait_s = LOOK_EVERY_S if self.state is UnitState.STANDS else RETRY_S
        self._due_ns = self._pump.now_ns() + int(wait_s * self._rng.uniform(0.8, 1.2) * 1e9)
        return self.state

    def lose(self, state: UnitState, why: str) -> None:
        """Note that nothing is known of the unit any more."""
        self._counts.unit_lost += self.state is UnitState.STANDS
        self.state, self.why = state, why
        self._facts = None
        self._steps.clear()
        self._due_ns = self._pump.now_ns()

    def session_begins(self) -> None:
        """Let a session find out anew what the unit has lost."""
        self._client.lost_synchrony = None
        self._client.expects_banner = True

    def session_ended(self, homed: bool, facts: UnitFacts | None) -> None:
        """Take from a session what it learnt of the unit.

        Args:
            homed: it was homed, and all went well.
            facts: the unit as it described itself, None if it did not come to that.
        """
        self._facts = facts
        self._steps.clear()  # asked anew: a session may have been broken off in motion
        if homed:
            self._memory.steps_are_sure = True
        self._see_losses()
        self._silent = 0
        self._due_ns = self._pump.now_ns()

    def _ask(self) -> None:
        axis = self._next_axis
        self._next_axis = Axis.TILT if axis is Axis.PAN else Axis.PAN
        question = query(axis, Quantity.POSITION)
        try:
            exchange = self._client.exchange(question, is_poll=True)
        except DeviceError as fault:
            self.lose(UnitState.ABSENT, fault.what)
            return
        if exchange.reply is not None and exchange.command == question:
            steps = read(question, exchange.reply)
            if isinstance(steps, int):
                self._steps[axis] = steps
        self._silent = 0 if exchange.reply is not None else self._silent + 1
        self._see_losses()
        if self._silent >= SILENT_LOOKS:
            self.lose(UnitState.SILENT, "it does not answer any more")

    def _greet(self) -> None:
        try:
            identify_unit(self._client)
        except DeviceError as fault:
            self.state = UnitState.SILENT if self._pump.is_up(PTU_PORT) else UnitState.ABSENT
            self.why = fault.what
            self._in_vain += 1
            if self._in_vain % REOPEN_AFTER == 0 and self.state is UnitState.SILENT:
                self._counts.unit_reopened += 1
                self._pump.reopen(PTU_PORT)
            return
        self._see_losses()
        self.state, self.why = UnitState.STANDS, ""
        self._silent = self._in_vain = 0

    def _see_losses(self) -> None:
        if self._client.lost_synchrony is not None:
            self._memory.steps_are_sure = False
            self._client.lost_synchrony = None
