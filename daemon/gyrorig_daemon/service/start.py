"""`gyrorigd run`: everything that a daemon needs, opened in order and closed again.

The order: the configuration, the state folder's lock and the socket, so that a second daemon
ends at once; the ports; the halt, before anything else is said; readiness; then the loop
(`daemon`). When the acquisition process ends, the ports are opened anew, for ever.
"""

import contextlib
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gyrorig_daemon.collector import look_rarely
from gyrorig_daemon.config import EMULATED, RigConfig, parse_rig, read_document
from gyrorig_daemon.emulation import Emulation
from gyrorig_daemon.links.capture_clock import anchor_now, read_host_clocks
from gyrorig_daemon.links.hub import PortsGoneError
from gyrorig_daemon.links.process_hub import AcquisitionHub
from gyrorig_daemon.links.raw_clock import raw_ns
from gyrorig_daemon.live import NO_VIEW, live_view
from gyrorig_daemon.record import port_settings
from gyrorig_daemon.rig import Rig
from gyrorig_daemon.service.counts import ServiceCounts
from gyrorig_daemon.service.daemon import Daemon, Ending
from gyrorig_daemon.service.jobs import JobQueue
from gyrorig_daemon.service.keeper import Keeper
from gyrorig_daemon.service.memory import Memory
from gyrorig_daemon.service.metrics import MetricsWriter
from gyrorig_daemon.service.notify import Notifier
from gyrorig_daemon.service.orders import Orders
from gyrorig_daemon.service.parts import Clocks, Parts
from gyrorig_daemon.service.schedule import Schedule
from gyrorig_daemon.service.server import Peer, StatusServer
from gyrorig_daemon.service.state import StateFolder
from gyrorig_daemon.service.wall_clock import NTP_UNSYNCHRONISED
from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_protocol.program import parse_program

AGAIN_S = 2.0  # between two attempts to open a rig that was open before
ACQUISITION_LIMIT_S = 8.0  # so long may the acquisition process not answer
EMULATED_USE_S = (0.0, 3_600.0)  # what an emulated rig hides happens within


@dataclass(frozen=True, slots=True)
class Call:
    """What the command line asks for."""

    config_path: Path
    state: Path
    socket: Path
    live: str | None = None  # HOST:PORT for Foxglove
    metrics: Path | None = None  # the folder of the metrics' file, else one in `state`
    emulation: Emulation = field(default_factory=lambda: Emulation(session_s=EMULATED_USE_S))


@dataclass(frozen=True, slots=True)
class Sound:
    """A configuration that can be used, and its text."""

    config: RigConfig
    text: bytes


def read_config(path: Path) -> Sound:
    """Return the configuration; its schedule's programs are looked at too.

    Raises:
        UsageError: it cannot be used.
    """
    text = read_document(path)
    config = parse_rig(text, path.name, path.parent)
    for entry in config.schedule:
        parse_program(read_document(path.parent / entry.program), entry.program)
    return Sound(config, text)


def log(text: str) -> None:
    """Say a line to the journal, if there is one: its restart must not be our end."""
    with contextlib.suppress(OSError, ValueError):
        print(" ".join(text.split()), file=sys.stderr, flush=True)  # noqa: T201 - the journal's way


class Service:
    """One process of `gyrorigd run`."""

    def __init__(self, call: Call, orders: Orders, notifier: Notifier) -> None:
        """Read the configuration; nothing is opened yet.

        Raises:
            UsageError: it cannot be used.
        """
        self._call = call
        self._orders = orders
        self._notifier = notifier
        self._sound = read_config(call.config_path)
        self._next: Sound | None = None
        self._hub: AcquisitionHub | None = None
        self._dropped_bytes = 0  # of hubs that are closed
        self._emulator_ending: Callable[[], str] = str  # how the emulated rig ended, "" if not
        self._counts = ServiceCounts()
        self._view = NO_VIEW

    def run(self) -> None:
        """Serve until the orders say that the process has to end.

        Raises:
            BusyError: another program has the folder, the socket or a port.
            UsageError: a port cannot be used as configured.
            MachineError: this computer cannot do what it must.
        """
        call = self._call
        with ExitStack() as stack:
            state = stack.enter_context(StateFolder(call.state))
            server = stack.enter_context(StatusServer(call.socket, self._handle, self._counts))
            metrics = MetricsWriter(call.metrics or state.metrics)
            stack.callback(metrics.close)
            keeper = Keeper(state, lambda: self._sound.config.service, self._clock_is_sound, log)
            stack.callback(keeper.close)
            keeper.begin()
            view = live_view(call.live, log)
            stack.callback(view.close)
            self._view = view

            def publish(status: dict[str, Any]) -> None:
                server.publish(status)
                metrics.publish(status)
                view.status(status)

            parts = Parts(
                state=state,
                queue=JobQueue(state.queue),
                schedule=Schedule(self._sound.config.schedule, state.schedule, time.monotonic()),
                memory=Memory(state.memory, time.time()),
                orders=self._orders,
                counts=self._counts,
                notifier=self._notifier,
                clocks=Clocks(anchor_now, read_host_clocks, time.monotonic, time.time),
                host=socket.gethostname(),
                config_text=self._sound.text,
                read_program=lambda name: read_document(call.config_path.parent / name),
                reread=self._reread,
                publish=publish,
                hanging=lambda: self._hanging(server),
                dropped_bytes=self._all_dropped_bytes,
                lost_rig=self._lost_rig,
                log=log,
                keeper=keeper,
                seed=time.monotonic_ns(),
                view=view,
            )
            look_rarely()
            self._serve(parts)
            self._notifier.stopping()

    def _serve(self, parts: Parts) -> None:
        before: Sound | None = None  # what was in force, until the new one's ports are open
        was_open = False
        while not self._orders.end.is_set():
            self._notifier.alive()
            try:
                with self._rig() as rig:
                    was_open, before = True, None
                    if Daemon(rig, parts).run() is Ending.END:
                        return
            except PortsGoneError as fault:
                self._counts.acquisition_restarts += 1
                self._again(str(fault))
            except GyrorigError as fault:
                if before is not None:
                    log(f"{fault}; the old configuration is used again")
                    self._counts.reloads_refused += 1
                    self._put_in_force(before, parts)
                    before = None
                elif was_open:
                    self._again(str(fault))
                else:
                    raise
            if self._next is not None:
                before = self._sound
                self._put_in_force(self._next, parts)
                self._next = None

    def _again(self, why: str) -> None:
        """Say why the rig has to be opened anew, and wait a while."""
        log(f"{why}; the ports are opened anew")
        self._orders.end.wait(AGAIN_S)

    @contextmanager
    def _rig(self) -> Iterator[Rig]:
        """Open the rig's ports, starting the emulator where they ask for it."""
        config = self._sound.config
        paths = config.ports()
        emulated = [port for port, path in paths.items() if path == EMULATED]
        with ExitStack() as stack:
            if emulated:
                from gyrorig_daemon.emulated import EmulatorProcess  # noqa: PLC0415

                process = stack.enter_context(
                    EmulatorProcess(self._call.config_path, self._call.emulation)
                )
                self._emulator_ending = process.ending
                stack.callback(self._forget_emulator)
                paths |= {port: process.paths[port] for port in emulated}
            hub = stack.enter_context(AcquisitionHub(port_settings(config, paths), waits=True))
            self._hub = hub
            stack.callback(self._close_account)
            yield Rig(
                hub,
                config,
                anchor_now(),
                stop=self._orders.stop,
                seed=time.monotonic_ns(),
                paths=paths,
                view=self._view,
            )

    def _forget_emulator(self) -> None:
        self._emulator_ending = str

    def _lost_rig(self) -> str:
        """Return why the rig has to be opened anew; a while after it was, at the earliest."""
        why = self._emulator_ending()
        if why:
            self._counts.emulator_restarts += 1
            self._orders.end.wait(AGAIN_S)  # one that dies at once must not keep us busy
        return why

    def _close_account(self) -> None:
        if self._hub is not None:
            self._dropped_bytes += self._hub.dropped_bytes
            self._hub = None

    def _all_dropped_bytes(self) -> int:
        return self._dropped_bytes + (0 if self._hub is None else self._hub.dropped_bytes)

    def _hanging(self, server: StatusServer) -> list[str]:
        """Return the loops that make no progress; called in the pump's thread."""
        hanging = [server.pulse.name] if server.pulse.hangs else []
        if self._hub is not None:
            if (raw_ns() - self._hub.answered_ns) * 1e-9 > ACQUISITION_LIMIT_S:
                hanging.append("acquisition")
            self._hub.ping()
        return hanging

    def _clock_is_sound(self) -> bool:
        return not read_host_clocks().ntp_status & NTP_UNSYNCHRONISED

    def _reread(self) -> str:
        try:
            self._next = read_config(self._call.config_path)
        except UsageError as fault:
            return str(fault)
        return ""

    def _put_in_force(self, sound: Sound, parts: Parts) -> None:
        self._sound = sound
        parts.config_text = sound.text
        parts.schedule = Schedule(sound.config.schedule, parts.state.schedule, time.monotonic())

    def _handle(self, command: str, peer: Peer) -> str:
        """Take a command from the socket's thread; the pump's thread acts on it."""
        who = f"user {peer.uid}, process {peer.pid}"
        log(f"{command} from {who}")
        if command == "halt":
            self._orders.ask_to_halt(who)
            return "the unit is being halted; gyrorigd status shows when it stands"
        if command == "clear":
            self._orders.clear.set()
            return "the hold is lifted"
        self._orders.reload.set()
        return "the configuration is read again; gyrorigd status and the log show the outcome"
