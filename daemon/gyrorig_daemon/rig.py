"""The rig in use: one pump, the unit's client and the boards' links, on ports that are open.

What to use when: `Rig` once per opened hub. It outlives sessions: whoever records listens to
it for as long as a session lasts, and what comes while nobody listens is counted by the
links and forgotten.
"""

from collections.abc import Mapping
from typing import Protocol

from gyrorig_daemon.config import PTU_PORT, RigConfig
from gyrorig_daemon.links.board_samples import BoardSinks
from gyrorig_daemon.links.boards import make_boards
from gyrorig_daemon.links.capture_clock import CaptureClock
from gyrorig_daemon.links.hub import PortHub
from gyrorig_daemon.links.pump import Pump, StopFlag
from gyrorig_daemon.live import NO_VIEW, View
from gyrorig_daemon.motion import Exchange, PtuClient
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import ClockPing, ImuRaw, clock_topic, imu_topic


class Listener(Protocol):
    """Whoever records what a rig says."""

    def take_exchange(self, exchange: Exchange) -> None:
        """Take an exchange with the unit that is no poll."""
        ...

    def take_sample(self, board_id: BoardId, message: ImuRaw, publish_ns: int) -> None:
        """Take a sample; `publish_ns` is when it was taken, on the capture clock."""
        ...

    def take_ping(self, board_id: BoardId, message: ClockPing) -> None:
        """Take a board's answer about its clock."""
        ...

    def note(self, text: str) -> None:
        """Take what happened and is no fault."""
        ...

    def fault(self, text: str) -> None:
        """Take what went wrong."""
        ...


class Rig:
    """Unit and boards of one configuration, behind one hub."""

    def __init__(
        self,
        hub: PortHub,
        config: RigConfig,
        capture: CaptureClock,
        *,
        stop: StopFlag,
        seed: int,
        paths: Mapping[str, str] | None = None,
        view: View = NO_VIEW,
    ) -> None:
        """Attach to the ports; nothing is said to them yet.

        Args:
            hub: `config.ports()` names its ports.
            config: which devices hang on them.
            capture: dates everything; a session anchors it anew.
            stop: heeded by the pump.
            seed: of the moments at which the boards are asked for their clocks.
            paths: of ports that are not as configured.
            view: sees the samples between sessions; in one, what the recorder takes.
        """
        self.config = config
        self.capture = capture
        self.stop = stop
        self.pump = Pump(hub, stop)
        self.pump.on_stall = self._take_stall
        self.listener: Listener | None = None
        self.view = view
        self.client = PtuClient(
            self.pump,
            PTU_PORT,
            where=(paths or {}).get(PTU_PORT, config.ptu.port),
            baud=config.ptu.baud,
            on_exchange=self._take_exchange,
            timeout_s=config.ptu.poll.timeout_s,
        )
        sinks = BoardSinks(self._take_sample, self._take_ping, self._note, self._fault)
        self.boards = make_boards(self.pump, config, capture, sinks, seed)

    def _take_exchange(self, exchange: Exchange) -> None:
        if self.listener is not None:
            self.listener.take_exchange(exchange)

    def _take_sample(self, board_id: BoardId, message: ImuRaw, publish_ns: int) -> None:
        if self.listener is not None:
            self.listener.take_sample(board_id, message, publish_ns)
        elif self.view is not NO_VIEW:
            self.view.take(imu_topic(board_id), message, message.host_time_ns)

    def _take_ping(self, board_id: BoardId, message: ClockPing) -> None:
        if self.listener is not None:
            self.listener.take_ping(board_id, message)
        elif self.view is not NO_VIEW:
            self.view.take(clock_topic(board_id), message, message.host_receive_ns)

    def _note(self, text: str) -> None:
        if self.listener is not None:
            self.listener.note(text)

    def _fault(self, text: str) -> None:
        if self.listener is not None:
            self.listener.fault(text)

    def _take_stall(self, who: str, begin_ns: int, end_ns: int) -> None:
        """Say when a process stood still; only the acquisition's makes stamps late."""
        seconds = (end_ns - begin_ns) * 1e-9
        begin_s = self.capture.utc_ns(begin_ns) * 1e-9
        late = "" if who == "the daemon" else ": the next arrival stamps are late by up to that"
        self._fault(f"{who} stood still for {seconds:.3f} s from {begin_s:.3f} s{late}")
