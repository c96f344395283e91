"""The connected rig: event loop, driver of the motion unit, links of the boards.

What to use when: `Rig` once per opened hub. It is kept for several sessions. A session
registers as `listener` while it lasts; without a listener, messages are counted by the links
and discarded.
"""

from collections.abc import Mapping
from typing import Protocol

from gyrorig_daemon.clocks.capture_clock import CaptureClock
from gyrorig_daemon.config import PTU_PORT, RigConfig
from gyrorig_daemon.links.boards.board_factory import make_board_links
from gyrorig_daemon.links.boards.sample_stream import BoardSinks
from gyrorig_daemon.links.ports.port_hub import PortHub
from gyrorig_daemon.links.pump import Pump, StopFlag
from gyrorig_daemon.live import NO_VIEW, LiveView
from gyrorig_daemon.motion import DriverPort, Exchange, PanTiltDriver, find_driver
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.clock_messages import ClockPing, clock_ping_topic
from gyrorig_protocol.recording.messages import ImuRaw, imu_raw_topic


class RigListener(Protocol):
    """Receives what the devices of a rig send, for a recording."""

    def handle_exchange(self, exchange: Exchange) -> None:
        """Handle an exchange with the unit that is not a poll."""
        ...

    def handle_sample(self, board_id: BoardId, message: ImuRaw, publish_ns: int) -> None:
        """Handle a sample; `publish_ns` is its time on the capture clock."""
        ...

    def handle_ping(self, board_id: BoardId, message: ClockPing) -> None:
        """Handle a board's reply to a time request."""
        ...

    def note(self, text: str) -> None:
        """Handle an event that is not a fault."""
        ...

    def fault(self, text: str) -> None:
        """Handle a fault."""
        ...


class Rig:
    """Unit and boards of one configuration, on one hub."""

    def __init__(
        self,
        hub: PortHub,
        config: RigConfig,
        capture: CaptureClock,
        *,
        stop: StopFlag,
        seed: int,
        paths: Mapping[str, str] | None = None,
        view: LiveView = NO_VIEW,
    ) -> None:
        """Attach to the ports; nothing is sent yet.

        Args:
            hub: its ports are named by `config.ports()`.
            config: the devices and their ports.
            capture: the clock of all messages; each session anchors it again.
            stop: checked by the event loop.
            seed: of the random moments at which time is requested from the boards.
            paths: of ports that are not as configured.
            view: shows samples between sessions; during a session the recorder feeds it.
        """
        self.config = config
        self.capture = capture
        self.stop = stop
        self.pump = Pump(hub, stop)
        self.pump.on_stall = self._report_stall
        self.listener: RigListener | None = None
        self.view = view
        location = (paths or {}).get(PTU_PORT, config.ptu.port)
        self.driver: PanTiltDriver = find_driver(config.ptu.driver).make(
            DriverPort(self.pump, location, config.ptu, self._handle_exchange)
        )
        sinks = BoardSinks(self._handle_sample, self._handle_ping, self._note, self._fault)
        self.boards = make_board_links(self.pump, config, capture, sinks, seed)

    def _handle_exchange(self, exchange: Exchange) -> None:
        if self.listener is not None:
            self.listener.handle_exchange(exchange)

    def _handle_sample(self, board_id: BoardId, message: ImuRaw, publish_ns: int) -> None:
        if self.listener is not None:
            self.listener.handle_sample(board_id, message, publish_ns)
        elif self.view is not NO_VIEW:
            self.view.show_message(imu_raw_topic(board_id), message, message.host_time_ns)

    def _handle_ping(self, board_id: BoardId, message: ClockPing) -> None:
        if self.listener is not None:
            self.listener.handle_ping(board_id, message)
        elif self.view is not NO_VIEW:
            self.view.show_message(clock_ping_topic(board_id), message, message.host_receive_ns)

    def _note(self, text: str) -> None:
        if self.listener is not None:
            self.listener.note(text)

    def _fault(self, text: str) -> None:
        if self.listener is not None:
            self.listener.fault(text)

    def _report_stall(self, process_name: str, begin_ns: int, end_ns: int) -> None:
        """Report that a process did not run.

        Only a stall of the acquisition process makes timestamps late.
        """
        seconds = (end_ns - begin_ns) * 1e-9
        begin_s = self.capture.utc_ns(begin_ns) * 1e-9
        is_daemon = process_name == "the daemon"
        late = "" if is_daemon else "; the next timestamps can be late by this time"
        self._fault(f"{process_name} did not run for {seconds:.3f} s, from {begin_s:.3f} s{late}")
