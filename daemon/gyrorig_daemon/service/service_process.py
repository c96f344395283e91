"""The process of `gyrorigd run`: it opens everything that the service needs, in order.

The order: the configuration; the lock of the state folder and the socket, so that a second
process ends immediately; the ports; a halt, before anything else is sent; readiness; the main loop
(`service_loop`). If the service cannot start, it halts the unit before it ends. If the
acquisition process ends, the ports are opened again, without limit.
"""

import secrets
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gyrorig_daemon.clocks.capture_clock import anchor_now, read_host_clocks
from gyrorig_daemon.config import EMULATED, RigConfig, parse_rig, read_document
from gyrorig_daemon.links.ports.acquisition_hub import AcquisitionHub
from gyrorig_daemon.links.ports.port_hub import PortsGoneError
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.live import NO_VIEW
from gyrorig_daemon.live.foxglove_view import open_live_view
from gyrorig_daemon.service.housekeeping import Housekeeping
from gyrorig_daemon.service.job_queue import JobQueue
from gyrorig_daemon.service.jobs import MAX_JOB_BYTES, parse_safe_program
from gyrorig_daemon.service.metrics import MetricsWriter
from gyrorig_daemon.service.persistent_state import PersistentState
from gyrorig_daemon.service.schedule import Schedule
from gyrorig_daemon.service.service_context import (
    OperatorRequests,
    ServiceClocks,
    ServiceContext,
    ServiceCounts,
)
from gyrorig_daemon.service.service_loop import LoopExit, ServiceLoop
from gyrorig_daemon.service.state_folder import StateFolder
from gyrorig_daemon.service.status_server import Peer, StatusServer
from gyrorig_daemon.service.systemd_notifier import SystemdNotifier
from gyrorig_daemon.service.unit_monitor import send_initial_halt
from gyrorig_daemon.session.connected_rig import Rig
from gyrorig_daemon.session.emulation_options import EmulationOptions
from gyrorig_daemon.session.garbage_collection import collect_rarely
from gyrorig_daemon.session.line_writer import LineWriter
from gyrorig_daemon.session.record_modes import make_port_settings
from gyrorig_protocol.errors import BusyError, GyrorigError, UsageError, sentence

HALT_SENDING_NS = 500_000_000  # the close of a port can discard what is not sent yet
REOPEN_DELAY_S = 2.0  # between two attempts to open the rig again
ACQUISITION_STALL_LIMIT_S = 8.0  # longest time without an answer
EMULATED_SESSION_S = (0.0, 3_600.0)  # events of injected causes are in this interval


@dataclass(frozen=True, slots=True)
class ServiceOptions:
    """Options of the command line."""

    config_path: Path
    state: Path
    socket: Path
    live: str | None = None  # HOST:PORT for Foxglove
    metrics: Path | None = None  # folder of the metrics file; by default in `state`
    emulation: EmulationOptions = field(
        default_factory=lambda: EmulationOptions(session_s=EMULATED_SESSION_S)
    )


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """A valid configuration and its text."""

    config: RigConfig
    text: bytes


def load_config(path: Path) -> LoadedConfig:
    """Return the configuration; the programs of its schedule are validated too.

    Raises:
        UsageError: the configuration or a program is invalid.
    """
    text = read_document(path)
    config = parse_rig(text, path.name, path.parent)
    if config.ptu.is_person:
        raise UsageError(
            f"in {path.name}, a person turns the boards (`driver: manual`), which a service cannot "
            "guide",
            "record with `gyrorigd record`",
        )
    make_port_settings(config, config.ports())  # checks the driver and its commands
    for entry in config.schedule:
        program_text = read_document(path.parent / entry.program, MAX_JOB_BYTES)
        parse_safe_program(program_text, entry.program)
    return LoadedConfig(config, text)


class ServiceProcess:
    """The whole process of `gyrorigd run`."""

    def __init__(
        self, options: ServiceOptions, requests: OperatorRequests, notifier: SystemdNotifier
    ) -> None:
        """Read the configuration; nothing is opened yet.

        Raises:
            UsageError: it is invalid.
        """
        self._options = options
        self._requests = requests
        self._notifier = notifier
        self._config = load_config(options.config_path)
        self._next_config: LoadedConfig | None = None
        self._hub: AcquisitionHub | None = None
        self._dropped_bytes = 0  # of closed hubs
        self._emulator_exit_reason: Callable[[], str] = (
            str  # why the emulated rig ended, "" while it runs
        )
        self._counts = ServiceCounts()
        self._log = LineWriter(self._count_lost_line)
        self._view = NO_VIEW

    def run(self) -> None:
        """Serve until a request to end.

        Raises:
            BusyError: another program uses the folder, the socket or a port.
            UsageError: a port cannot be used as configured.
            MachineError: the computer cannot provide what is needed.
        """
        with ExitStack() as stack:
            stack.enter_context(self._log)
            try:
                context = self._prepare(stack)
            except BusyError:
                raise  # the unit belongs to another daemon
            except Exception:
                self._halt_before_end()
                raise
            collect_rarely()
            self._serve(context)
            self._notifier.send_stopping()

    def _prepare(self, stack: ExitStack) -> ServiceContext:
        """Open everything except the ports; `stack` closes it.

        Raises:
            BusyError: another program uses the folder or the socket.
            MachineError: the computer cannot provide what is needed.
        """
        options = self._options
        state_folder = stack.enter_context(StateFolder(options.state))
        server = stack.enter_context(
            StatusServer(options.socket, self._handle_command, self._counts)
        )
        metrics = MetricsWriter(options.metrics or state_folder.metrics)
        stack.callback(metrics.close)
        housekeeping = Housekeeping(
            state_folder,
            lambda: self._config.config.service,
            _valid_utc_s,
            self._log.write_line,
            metrics.path,
        )
        stack.callback(housekeeping.close)
        housekeeping.start()
        view = open_live_view(options.live, self._log.write_line)
        stack.callback(view.close)
        self._view = view

        def publish(status: dict[str, Any]) -> None:
            server.publish(status)
            metrics.publish(status)
            view.show_status(status)

        queue = JobQueue(state_folder.queue)
        stack.callback(queue.close)
        return ServiceContext(
            state_folder=state_folder,
            queue=queue,
            schedule=Schedule(
                self._config.config.schedule, state_folder.schedule, time.monotonic()
            ),
            persistent=PersistentState(state_folder.persistent_state, time.time()),
            requests=self._requests,
            counts=self._counts,
            notifier=self._notifier,
            clocks=ServiceClocks(anchor_now, read_host_clocks, time.monotonic, time.time),
            host=socket.gethostname(),
            config_text=self._config.text,
            read_program=lambda name: read_document(
                options.config_path.parent / name, MAX_JOB_BYTES
            ),
            reload_config=self._reload_config,
            publish=publish,
            stalled_loops=lambda: self._stalled_loops(server),
            dropped_bytes=self._total_dropped_bytes,
            reopen_reason=self._reopen_reason,
            log=self._log.write_line,
            housekeeping=housekeeping,
            seed=time.monotonic_ns(),
            view=view,
        )

    def _halt_before_end(self) -> None:
        """Halt the unit of a service that cannot start; nothing else is sent to it."""
        if self._config.config.ptu.port == EMULATED:
            return
        with suppress(GyrorigError, OSError), self._open_rig() as rig:
            send_initial_halt(rig)
            rig.pump.run_until(rig.pump.now_ns() + HALT_SENDING_NS)
            self._log.write_line(
                "The service cannot start. It has sent the halt command to the pan-tilt unit."
            )

    def _serve(self, context: ServiceContext) -> None:
        previous_config: LoadedConfig | None = (
            None  # in force until the ports of the new one are open
        )
        was_open = False
        while not self._requests.terminate.is_set():
            self._notifier.feed_watchdog()
            try:
                with self._open_rig() as rig:
                    was_open, previous_config = True, None
                    if ServiceLoop(rig, context).run() is LoopExit.END:
                        return
            except PortsGoneError as error:
                self._counts.acquisition_restarts += 1
                self._wait_before_reopening(str(error))
            except GyrorigError as error:
                if previous_config is not None:
                    self._log.write_line(
                        f"{sentence(str(error))} The previous configuration is used."
                    )
                    self._counts.reloads_refused += 1
                    self._apply_config(previous_config, context)
                    previous_config = None
                elif was_open:
                    self._wait_before_reopening(str(error))
                else:
                    raise
            if self._next_config is not None:
                previous_config = self._config
                self._apply_config(self._next_config, context)
                self._next_config = None

    def _wait_before_reopening(self, reason: str) -> None:
        """Log why the rig must be opened again, and wait."""
        self._log.write_line(f"{sentence(reason)} The ports are opened again.")
        self._requests.terminate.wait(REOPEN_DELAY_S)

    @contextmanager
    def _open_rig(self) -> Iterator[Rig]:
        """Open the rig's ports; start the emulator for emulated ports."""
        config = self._config.config
        paths = config.ports()
        emulated = [port for port, path in paths.items() if path == EMULATED]
        with ExitStack() as stack:
            if emulated:
                from gyrorig_daemon.session.emulator_process import EmulatorProcess  # noqa: PLC0415

                process = stack.enter_context(
                    EmulatorProcess(self._options.config_path, self._new_session_seed())
                )
                self._emulator_exit_reason = process.ending_text
                stack.callback(self._clear_emulator)
                paths |= {port: process.paths[port] for port in emulated}
            hub = stack.enter_context(
                AcquisitionHub(
                    make_port_settings(config, paths),
                    wait_for_ports=True,
                    halt_pipe=self._requests.stop.halt_pipe,
                    on_problem=self._log.write_line,
                )
            )
            self._hub = hub
            stack.callback(self._close_hub)
            yield Rig(
                hub,
                config,
                anchor_now(),
                stop=self._requests.stop,
                seed=time.monotonic_ns(),
                paths=paths,
                view=self._view,
            )

    def _new_session_seed(self) -> EmulationOptions:
        """Return the options of an emulated rig whose noise differs from that of every other one.

        One emulated rig serves all sessions until the service or the rig ends, and its noise goes
        on from session to session.
        """
        return replace(self._options.emulation, session_seed=secrets.randbits(32))

    def _clear_emulator(self) -> None:
        self._emulator_exit_reason = str

    def _reopen_reason(self) -> str:
        """Return why the rig must be opened again, "" if it need not; wait before the reason."""
        reason = self._emulator_exit_reason()
        if reason:
            self._counts.emulator_restarts += 1
            self._requests.terminate.wait(
                REOPEN_DELAY_S
            )  # an emulator that ends at once must not cause a busy loop
        return reason

    def _close_hub(self) -> None:
        if self._hub is not None:
            self._dropped_bytes += self._hub.dropped_bytes
            self._hub = None

    def _total_dropped_bytes(self) -> int:
        return self._dropped_bytes + (0 if self._hub is None else self._hub.dropped_bytes)

    def _stalled_loops(self, server: StatusServer) -> list[str]:
        """Return the loops that make no progress; called in the pump's thread."""
        stalled = [server.heartbeat.name] if server.heartbeat.is_stalled else []
        if self._hub is not None:
            if (raw_ns() - self._hub.last_report_ns) * 1e-9 > ACQUISITION_STALL_LIMIT_S:
                stalled.append("acquisition")
            self._hub.ping()
        return stalled

    def _reload_config(self) -> str:
        try:
            self._next_config = load_config(self._options.config_path)
        except UsageError as error:
            return str(error)
        return ""

    def _apply_config(self, config: LoadedConfig, context: ServiceContext) -> None:
        self._config = config
        context.config_text = config.text
        context.schedule = Schedule(
            config.config.schedule, context.state_folder.schedule, time.monotonic()
        )

    def _handle_command(self, command: str, peer: Peer) -> str:
        """Accept a command from the socket's thread; the pump's thread carries it out."""
        requester = f"user {peer.uid}, process {peer.pid}"
        answer = self._pass_on(command, requester)  # before the log
        self._log.write_line(f"Received {command} from {requester}.")
        return answer

    def _pass_on(self, command: str, requester: str) -> str:
        if command == "halt":
            self._requests.request_halt(requester)
            return "The unit is being halted. `gyrorigd status` shows when it has stopped."
        if command == "clear":
            self._requests.clear.set()
            return "The motion lock is being released. `gyrorigd status` shows the result."
        self._requests.reload.set()
        return "The configuration is being read again. The log shows the result."

    def _count_lost_line(self) -> None:
        self._counts.log_lines_lost += 1


def _valid_utc_s() -> float | None:
    """Return the system time, None while it is not known to be right."""
    return time.time() if read_host_clocks().is_synchronised else None
