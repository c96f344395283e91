"""The two ways to hold a session: with serial ports in real time, or emulated and faster.

Both end in `session.record_session`; only what stands behind the ports and the clock
differs. The emulator is imported only where one is asked for.
"""

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.collector import look_rarely
from gyrorig_daemon.config import EMULATED, PTU_PORT, RigConfig
from gyrorig_daemon.description import SessionOrder
from gyrorig_daemon.emulation import Emulation
from gyrorig_daemon.links.capture_clock import (
    CaptureClock,
    HostClocks,
    anchor_now,
    read_host_clocks,
)
from gyrorig_daemon.links.process_hub import AcquisitionHub, PortSettings
from gyrorig_daemon.links.pump import StopFlag
from gyrorig_daemon.links.raw_clock import raw_ns
from gyrorig_daemon.session import (
    Progress,
    Surroundings,
    no_progress,
    record_session,
)
from gyrorig_protocol.errors import DeviceError, MachineError, UsageError

__all__ = ["Call", "emulate", "in_real_time", "in_simulated_time", "no_progress"]

ORIGIN_NS = 5_000_000_000  # power-up of a rig under simulated time, on its own raw clock
FAREWELL = " H "  # halts the unit if the daemon dies; the space ends a command cut short


def no_seal(_sha256: str) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True)
class Call:
    """What the command line asks for."""

    order: SessionOrder
    config_path: Path
    emulation: Emulation
    host: str
    stop: StopFlag
    progress: Progress = no_progress
    sealed: Callable[[str], None] = no_seal  # told the seal of what is hidden, at the start


def in_real_time(call: Call) -> Path:
    """Record through the acquisition process, starting the emulator where ports ask for it.

    Raises:
        GyrorigError: see `record_session`, `AcquisitionHub`.
    """
    config = call.order.config
    paths = config.ports()
    emulated = [port for port, path in paths.items() if path == EMULATED]
    told = call.emulation
    if told.rates is not None:
        raise UsageError("--rates needs --simulated-time", "add it, or leave out --rates")
    if not emulated:
        if told.truth is not None:
            raise UsageError(
                "this rig is not emulated: what it hides is not known", "leave out --truth"
            )
        if told.hide or told.noise_free or told.soak_k:
            raise UsageError(
                "this rig is not emulated: nothing can be hidden in it or taken from it",
                "leave out --hide, --noise-free and --soak",
            )
    ending: Callable[[], str] = str  # how the emulated rig has ended, "" if it has not
    with ExitStack() as stack:
        if emulated:
            from gyrorig_daemon.emulated import EmulatorProcess, check_hidden  # noqa: PLC0415

            check_hidden(config, told)
            process = stack.enter_context(EmulatorProcess(call.config_path, told))
            if process.seal is not None:
                call.sealed(process.seal)
            ending = process.ending
            paths |= {port: process.paths[port] for port in emulated}
        hub = stack.enter_context(AcquisitionHub(port_settings(config, paths)))
        look_rarely()
        around = Surroundings(
            capture=anchor_now(),
            read_host=read_host_clocks,
            threaded_writer=True,
            host=call.host,
            seed=time.monotonic_ns(),
            paths=paths,
            dropped_bytes=lambda: hub.dropped_bytes,
            stop=call.stop,
            progress=call.progress,
        )
        try:
            return record_session(hub, call.order, around)
        except DeviceError as fault:
            if why := ending():
                raise MachineError(f"{why}: {fault.what}", "record again") from fault
            raise


def in_simulated_time(call: Call) -> Path:
    """Record an emulated rig under a virtual clock.

    Raises:
        UsageError: a port is not emulated.
        GyrorigError: see `record_session`.
    """
    from gyrorig_daemon.emulated import TruthFile, check_hidden, rig_settings  # noqa: PLC0415
    from gyrorig_daemon.emulator.noise_free import (  # noqa: PLC0415
        begun_moves_s,
        noise_free_rates,
        write_rates,
    )
    from gyrorig_daemon.emulator.rig import EmulatedRig  # noqa: PLC0415
    from gyrorig_daemon.emulator.virtual_hub import VirtualHub  # noqa: PLC0415

    config = call.order.config
    if not config.is_emulated:
        raise UsageError("a real rig has no simulated time", "leave out --simulated-time")
    check_hidden(config, call.emulation)
    settings = rig_settings(config, more=call.emulation)
    rig = EmulatedRig(settings, ORIGIN_NS)
    truth = TruthFile(call.emulation, rig)
    if truth.seal is not None:
        call.sealed(truth.seal)
    hub = VirtualHub(rig)
    capture = CaptureClock(time.time_ns(), hub.now_ns())

    def read_host() -> HostClocks:
        now_ns = hub.now_ns()
        return HostClocks(now_ns, now_ns, capture.utc_ns(now_ns), 0.0, 0.0, 0)

    around = Surroundings(
        capture=capture,
        read_host=read_host,
        threaded_writer=False,
        host=call.host,
        seed=settings.seed,
        stop=call.stop,
        progress=call.progress,
    )
    path = record_session(hub, call.order, around)
    truth.open(ORIGIN_NS, hub.now_ns())
    if call.emulation.rates is not None:
        rates = noise_free_rates(rig, hub.now_ns())
        write_rates(call.emulation.rates, rates, begun_moves_s(rig))
    return path


def port_settings(config: RigConfig, paths: dict[str, str]) -> dict[str, PortSettings]:
    """Return how to open every port of a rig; `paths` are those of the moment."""
    bauds = {PTU_PORT: config.ptu.baud, **{b.hub_port: b.baud for b in config.serial_boards}}
    settings = {
        port: PortSettings(paths[port], baud, FAREWELL if port == PTU_PORT else "")
        for port, baud in bauds.items()
    }
    for bus in config.buses:
        settings[bus.hub_port] = PortSettings(paths[bus.hub_port], bus.bitrate, kind="can")
    return settings


def emulate(
    config: RigConfig,
    told: Emulation,
    announce: Callable[[Mapping[str, str], str | None], None],
    ended: threading.Event,
    links: Path | None = None,
) -> None:
    """Open the emulated devices on ptys and serve them until `ended`.

    Args:
        config: the rig; only its ports that read `emulated` are opened.
        told: what is hidden, and where the truth goes, at the end with the mean bias too.
        announce: called once with the path of each port, and with the seal of what is hidden
            where it is a secret.
        ended: set to stop.
        links: a folder for symbolic links of the ports' names.

    Raises:
        UsageError: no port is emulated, or something cannot be hidden.
        MachineError: no pty, or the truth cannot be written.
    """
    from gyrorig_daemon.emulated import TruthFile, check_hidden, rig_settings  # noqa: PLC0415
    from gyrorig_daemon.emulator.rig import EmulatedRig  # noqa: PLC0415
    from gyrorig_daemon.emulator.serve import serve  # noqa: PLC0415

    if EMULATED not in config.ports().values():
        raise UsageError(
            "no port of this rig is emulated",
            "write `emulated` as the port of the unit or of a board, as in config/rig.yaml",
        )
    check_hidden(config, told)
    begin_ns = raw_ns()
    rig = EmulatedRig(rig_settings(config, more=told, is_instant=True), begin_ns)
    truth = TruthFile(told, rig)
    serve(rig, lambda ports: announce(ports, truth.seal), ended.is_set, links)
    truth.open(begin_ns, raw_ns())
