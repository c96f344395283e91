"""Two ways to record a session: real time on serial ports, or an emulated rig in simulated time.

Both end in `session.record_session`; only the ports and the clock differ. The emulator is
imported only where a rig is emulated.
"""

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.clocks.capture_clock import (
    CaptureClock,
    HostClocks,
    anchor_now,
    read_host_clocks,
)
from gyrorig_daemon.config import EMULATED, PTU_PORT, RigConfig
from gyrorig_daemon.links.ports.acquisition_hub import AcquisitionHub, PortSettings
from gyrorig_daemon.links.ports.port_hub import PortHub
from gyrorig_daemon.links.ports.port_kinds import CAN_QUOTA_BYTES_PER_S
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.links.pump import StopFlag
from gyrorig_daemon.motion import find_driver
from gyrorig_daemon.session.emulation_options import EmulationOptions
from gyrorig_daemon.session.garbage_collection import collect_rarely
from gyrorig_daemon.session.session import record_session
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import (
    EventListener,
    Progress,
    SessionEnvironment,
    SessionSummary,
    ignore_event,
    ignore_line,
    ignore_progress,
    ignore_summary,
)
from gyrorig_protocol.errors import DeviceError, MachineError, UsageError, sentence

POWER_UP_NS = 5_000_000_000  # power-up of a simulated rig, by the rig's raw clock


def _ignore_commitment(_sha256: str) -> None:
    pass


@dataclass(frozen=True, slots=True)
class RecordTask:
    """The arguments of `gyrorigd record`."""

    request: SessionRequest
    config_path: Path
    emulation: EmulationOptions
    host: str
    stop: StopFlag
    progress: Progress = ignore_progress
    on_event: EventListener = ignore_event
    on_summary: Callable[[SessionSummary], None] = ignore_summary
    program_begin_s: float | None = None  # of a replay, since power-up of the emulated rig
    on_commitment: Callable[[str], None] = _ignore_commitment  # hash of the hidden parameters
    say: Callable[[str], None] = ignore_line  # to a person who turns the boards


def _record(hub: PortHub, request: SessionRequest, environment: SessionEnvironment) -> Path:
    """Record with the pan-tilt unit, or guide the person who takes its place."""
    if not request.config.ptu.is_person:
        return record_session(hub, request, environment)
    from gyrorig_daemon.session.manual_session import record_by_hand  # noqa: PLC0415 - NumPy

    return record_by_hand(hub, request, environment)


def record_in_real_time(task: RecordTask) -> Path:
    """Record through the acquisition process; start the emulator for emulated ports.

    Raises:
        GyrorigError: see `record_session`, `AcquisitionHub`.
    """
    config = task.request.config
    paths = config.ports()
    emulated = [port for port, path in paths.items() if path == EMULATED]
    emulation = task.emulation
    if emulation.rates is not None:
        raise UsageError(
            "the option --rates works only with the option --simulated-time",
            "add --simulated-time, or remove --rates",
        )
    if not emulated:
        _refuse_emulation_options(emulation)
    program_begin_ns: int | None = None
    ending: Callable[[], str] = str  # how the emulator has ended, "" while it runs
    with ExitStack() as stack:
        if emulated:
            from gyrorig_daemon.session.emulator_process import (  # noqa: PLC0415
                EmulatorProcess,
                check_emulation,
            )

            check_emulation(config, emulation)
            process = stack.enter_context(EmulatorProcess(task.config_path, emulation))
            if process.commitment is not None:
                task.on_commitment(process.commitment)
            ending = process.ending_text
            if task.program_begin_s is not None:
                program_begin_ns = process.power_up_ns + round(task.program_begin_s * 1e9)
            paths |= {port: process.paths[port] for port in emulated}
        hub = stack.enter_context(
            AcquisitionHub(
                make_port_settings(config, paths),
                halt_pipe=task.stop.halt_pipe,
                on_problem=task.say,
            )
        )
        collect_rarely()
        environment = SessionEnvironment(
            capture=anchor_now(),
            read_host=read_host_clocks,
            threaded_writer=True,
            host=task.host,
            seed=time.monotonic_ns(),
            paths=paths,
            dropped_bytes=lambda: hub.dropped_bytes,
            stop=task.stop,
            progress=task.progress,
            on_event=task.on_event,
            on_summary=task.on_summary,
            say=task.say,
            program_begin_ns=program_begin_ns,
        )
        try:
            return _record(hub, task.request, environment)
        except DeviceError as fault:
            if ending_text := ending():
                raise MachineError(
                    f"{ending_text}: {fault.problem}", "record the session again"
                ) from fault
            raise


def _refuse_emulation_options(emulation: EmulationOptions) -> None:
    if emulation.truth is not None:
        raise UsageError(
            "the option --truth needs an emulated rig, because the true parameters of a "
            "real rig are not known",
            "remove the option --truth",
        )
    has_seeds = emulation.session_seed is not None or emulation.draw
    if emulation.hide or emulation.noise_free or emulation.soak_k or has_seeds:
        raise UsageError(
            "the options --hide, --noise-free, --soak, --session-seed and --draw need an emulated "
            "rig",
            "remove these options, or write `emulated` as the ports in the rig file",
        )


def record_in_simulated_time(task: RecordTask) -> Path:
    """Record an emulated rig under a virtual clock.

    Raises:
        UsageError: a port is not emulated.
        GyrorigError: see `record_session`.
    """
    from gyrorig_daemon.emulator.noise_free_rates import (  # noqa: PLC0415
        compare_noise_free,
        move_starts_s,
        simulate_session_rates,
        write_rates,
    )
    from gyrorig_daemon.emulator.virtual_hub import VirtualHub  # noqa: PLC0415
    from gyrorig_daemon.session.emulator_process import (  # noqa: PLC0415
        TruthFile,
        build_emulated_rig,
        check_emulation,
    )

    config = task.request.config
    if not config.is_emulated:
        raise UsageError(
            "the option --simulated-time needs a rig with emulated ports only",
            "remove the option --simulated-time, or write `emulated` as every port in the rig file",
        )
    check_emulation(config, task.emulation)
    built = build_emulated_rig(config, task.emulation, POWER_UP_NS)
    rig, settings = built.rig, built.rig.settings
    for note in built.notes:
        task.say(sentence(note))
    truth = TruthFile(task.emulation, rig)
    if truth.commitment is not None:
        task.on_commitment(truth.commitment)
    hub = VirtualHub(rig)
    capture = CaptureClock(time.time_ns(), hub.now_ns())

    def read_host() -> HostClocks:
        now_ns = hub.now_ns()
        return HostClocks(now_ns, now_ns, capture.utc_ns(now_ns), 0.0, 0.0, 0)

    environment = SessionEnvironment(
        capture=capture,
        read_host=read_host,
        threaded_writer=False,
        host=task.host,
        seed=settings.seed if settings.session_seed is None else settings.session_seed,
        stop=task.stop,
        progress=task.progress,
        on_event=task.on_event,
        on_summary=task.on_summary,
        say=task.say,
        program_begin_ns=None
        if task.program_begin_s is None
        else POWER_UP_NS + round(task.program_begin_s * 1e9),
    )
    path = _record(hub, task.request, environment)
    truth.write_full_truth(POWER_UP_NS, hub.now_ns())
    if task.emulation.rates is not None:
        rates = (
            compare_noise_free(rig, hub.now_ns(), built.plain)
            if task.emulation.with_plain_rates
            else simulate_session_rates(rig, hub.now_ns())
        )
        write_rates(task.emulation.rates, rates, move_starts_s(rig))
    return path


def make_port_settings(config: RigConfig, paths: dict[str, str]) -> dict[str, PortSettings]:
    """Return how to open every port of a rig.

    Args:
        config: the rig.
        paths: the present path of each port.
    """
    bauds = {PTU_PORT: config.ptu.baud, **{b.hub_port: b.baud for b in config.serial_boards}}
    halt = "" if config.ptu.is_person else _halt_text(config)
    settings = {
        port: PortSettings(paths[port], baud, halt if port == PTU_PORT else "")
        for port, baud in bauds.items()
        if port in paths
    }
    for bus in config.buses:
        settings[bus.hub_port] = PortSettings(
            paths[bus.hub_port],
            bus.bitrate,
            kind="can",
            quota_bytes_per_s=CAN_QUOTA_BYTES_PER_S,
        )
    return settings


def _halt_text(config: RigConfig) -> str:
    """Return what stops the unit in any state, in the language of its driver."""
    entry = find_driver(config.ptu.driver)
    halt = entry.halt_bytes if entry.language is None else entry.language(config.ptu).halt_bytes
    return halt.decode("latin-1")


def serve_emulated_rig(
    config: RigConfig,
    emulation: EmulationOptions,
    announce: Callable[[Mapping[str, str], str | None, int], None],
    stop: threading.Event,
    links: Path | None = None,
) -> None:
    """Open the emulated devices on pseudo-terminals and serve them until `stop` is set.

    Args:
        config: the rig; only its ports that are `emulated` are opened.
        emulation: hidden causes, and the file for the true parameters.
        announce: called once with the path of each port, with the hash of the hidden parameters
            if they are secret, and with the time of power-up by the raw monotonic clock.
        stop: set to stop.
        links: a folder for symbolic links with the names of the ports.

    Raises:
        UsageError: no port is emulated, or a cause cannot be hidden.
        MachineError: there is no pseudo-terminal, or the truth file cannot be written.
    """
    from gyrorig_daemon.emulator.pty_server import serve_rig  # noqa: PLC0415
    from gyrorig_daemon.session.emulator_process import (  # noqa: PLC0415
        TruthFile,
        build_emulated_rig,
        check_emulation,
    )

    if EMULATED not in config.ports().values():
        raise UsageError(
            "the rig file has no emulated port, so there is nothing to emulate",
            "write `emulated` as the port of the unit or of a board, as in config/rig.yaml",
        )
    check_emulation(config, emulation)
    begin_ns = raw_ns()
    rig = build_emulated_rig(config, emulation, begin_ns, is_instant=True).rig
    truth = TruthFile(emulation, rig)
    serve_rig(rig, lambda ports: announce(ports, truth.commitment, begin_ns), stop.is_set, links)
    truth.write_full_truth(begin_ns, raw_ns())
