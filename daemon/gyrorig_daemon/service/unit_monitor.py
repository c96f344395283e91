"""Monitor of the pan-tilt unit between sessions: initial halt, identification, polling.

What to use when: `send_initial_halt` as soon as a rig is open; `UnitMonitor.poll` from the idle
loop. Nothing here moves the unit. A unit that was disconnected is unknown until it has identified
itself again, and is then halted, because another program may have commanded it meanwhile.
"""

import random
from enum import Enum

from gyrorig_daemon.config import PTU_PORT
from gyrorig_daemon.links.pump import Pump
from gyrorig_daemon.motion import PanTiltDriver, UnitFacts
from gyrorig_daemon.service.persistent_state import PersistentState
from gyrorig_daemon.service.service_context import ServiceCounts
from gyrorig_daemon.session.connected_rig import Rig
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import Axis

IDENTIFY_RETRY_S = 2.0
POLL_PERIOD_S = 2.0
SILENT_POLL_LIMIT = 2
REOPEN_AFTER = 3  # failed identifications, because a driver can hang


class UnitPresence(Enum):
    """Presence of the unit; the value is the text for people."""

    ABSENT = "not connected"
    SILENT = "does not answer"
    STANDS = "at standstill"


def send_initial_halt(rig: Rig) -> None:
    """Send the halt command before anything else.

    The unit stops as early as possible, and a halt command moves no other device.
    """
    if rig.pump.is_up(PTU_PORT):
        try:
            rig.pump.write(PTU_PORT, rig.driver.halt_bytes)
        except DeviceError:
            return  # the unit is polled as soon as the port is back


class UnitMonitor:
    """Monitors the presence of the unit, and halts it whenever it appears."""

    def __init__(
        self, rig: Rig, persistent: PersistentState, counts: ServiceCounts, seed: int
    ) -> None:
        self._persistent = persistent
        self._counts = counts
        self._pump: Pump = rig.pump
        self._driver: PanTiltDriver = rig.driver
        self._rng = random.Random(seed)  # noqa: S311 - moments, not secrets
        self.state = UnitPresence.ABSENT
        self.reason = ""
        self._unanswered_polls = 0
        self._failed_identifications = 0
        self._facts: UnitFacts | None = None
        self._steps: dict[Axis, int] = {}
        self._due_ns = rig.pump.now_ns()

    @property
    def angles_rad(self) -> tuple[float, float] | None:
        """Position of pan and tilt between sessions; None until a session has read the step size.

        A unit reports its step size in a session. A unit that was disconnected can be another one.
        """
        facts = self._facts
        if facts is None or not all(axis in self._steps for axis in facts.axes):
            return None
        return (
            facts.pan.to_rad(self._steps.get(Axis.PAN, 0)),
            facts.tilt.to_rad(self._steps.get(Axis.TILT, 0)),
        )

    @property
    def has_lost_steps(self) -> bool:
        """Whether the unit has reported a loss of steps that was not yet taken over."""
        return self._driver.lost_synchrony is not None

    def poll(self) -> UnitPresence:
        """Poll or identify the unit, if that is due."""
        if not self._pump.is_up(PTU_PORT) or self._driver.is_port_gone:
            if self.state is not UnitPresence.ABSENT:
                self.mark_lost(UnitPresence.ABSENT, "its port was disconnected")
            if not self._pump.is_up(PTU_PORT):
                return self.state
        if self.state is UnitPresence.STANDS and not self._driver.is_identified:
            self.mark_lost(UnitPresence.SILENT, "its port was disconnected for a moment")
        if self._pump.now_ns() < self._due_ns:
            return self.state
        if self.state is UnitPresence.STANDS:
            self._poll_position()
        else:
            self._identify()
        wait_s = POLL_PERIOD_S if self.state is UnitPresence.STANDS else IDENTIFY_RETRY_S
        self._due_ns = self._pump.now_ns() + int(wait_s * self._rng.uniform(0.8, 1.2) * 1e9)
        return self.state

    def mark_lost(self, state: UnitPresence, reason: str) -> None:
        """Note that the unit is no longer identified."""
        self._counts.unit_lost += self.state is UnitPresence.STANDS
        self.state, self.reason = state, reason
        self._facts = None
        self._steps.clear()
        self._due_ns = self._pump.now_ns()

    def begin_session(self) -> None:
        """Reset the synchrony flags, so that the session detects losses itself."""
        self._driver.begin_session()

    def end_session(self, was_homed: bool, facts: UnitFacts | None) -> None:
        """Take over what a session has learnt about the unit.

        Args:
            was_homed: the session has homed the unit without an error.
            facts: the properties that the unit has reported, None if it has not.
        """
        self._facts = facts
        self._steps.clear()  # polled again: the session may have ended in motion
        if was_homed:
            self._persistent.steps_are_sure = True
        self._check_synchrony()
        self._unanswered_polls = 0
        self._due_ns = self._pump.now_ns()

    def _poll_position(self) -> None:
        try:
            poll = self._driver.poll()
        except DeviceError as error:
            self.mark_lost(UnitPresence.ABSENT, error.problem)
            return
        self._steps.update(poll.steps)
        has_reply = poll.exchange.reply is not None
        self._unanswered_polls = 0 if has_reply else self._unanswered_polls + 1
        self._check_synchrony()
        if self._unanswered_polls >= SILENT_POLL_LIMIT:
            self.mark_lost(UnitPresence.SILENT, "it no longer answers")

    def _identify(self) -> None:
        try:
            self._driver.identify()
        except DeviceError as error:
            self.state = UnitPresence.SILENT if self._pump.is_up(PTU_PORT) else UnitPresence.ABSENT
            self.reason = error.problem
            self._failed_identifications += 1
            if (
                self._failed_identifications % REOPEN_AFTER == 0
                and self.state is UnitPresence.SILENT
            ):
                self._counts.unit_reopened += 1
                self._pump.reopen(PTU_PORT)
            return
        self._check_synchrony()
        self.state, self.reason = UnitPresence.STANDS, ""
        self._unanswered_polls = self._failed_identifications = 0

    def _check_synchrony(self) -> None:
        if self.has_lost_steps:
            self._persistent.steps_are_sure = False
            self._driver.forget_losses()
