"""The emulated rig that a configuration describes: its settings, and its own process.

A port that reads `emulated` is opened on a pty by `gyrorigd emulate`, run as a process of
its own, so that the daemon talks to it exactly as to hardware.
"""

import contextlib
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from gyrorig_daemon.config import EMULATED, PTU_PORT, RigConfig
from gyrorig_daemon.emulation import Emulation
from gyrorig_daemon.emulator.causes import RANDOM, draw_hidden, parse_hide
from gyrorig_daemon.emulator.rig import EmulatedRig
from gyrorig_daemon.emulator.sealed import Seal
from gyrorig_daemon.emulator.settings import (
    BoardSettings,
    BusSettings,
    PtuSettings,
    RigSettings,
)
from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import MachineError, UsageError

# one of the L3G4200D's low-pass choices at each rate (RIOT-OS drivers/include/l3g4200d.h)
_BANDWIDTH_HZ = {100: 25.0, 200: 50.0, 400: 110.0, 800: 110.0}
STOP_PATIENCE_S = 10.0


def rig_settings(
    config: RigConfig,
    seed: int | None = None,
    more: Emulation | None = None,
    is_instant: bool = False,
) -> RigSettings:
    """Return the settings of the emulated rig: only the ports that read `emulated`.

    Args:
        config: the rig.
        seed: instead of the configuration's own.
        more: what is to be hidden, and the like.
        is_instant: the host's frames on a bus take no time, as through `serve`.

    Raises:
        UsageError: there is no such cause to hide.
    """
    told, more = config.emulator, more or Emulation()
    seed = more.seed if seed is None else seed
    ptu = PtuSettings(
        dialect=told.dialect,
        baud=config.ptu.baud,
        command_time_ms=told.command_time_ms,
        homed=told.homed,
        pan_sign=config.ptu.pan_sign,
        tilt_sign=config.ptu.tilt_sign,
    )
    boards = tuple(
        BoardSettings(
            name=board.id,
            odr_hz=float(told.odr_hz),
            bandwidth_hz=told.bandwidth_hz or _BANDWIDTH_HZ[told.odr_hz],
            full_scale_dps=float(told.gyro_full_scale_dps),
            baud=board.baud,
            bus=board.bus,
            node=board.node or 0,
        )
        for board in config.boards
        if config.is_emulated_board(board)
    )
    buses = tuple(
        BusSettings(bus.id, bus.bitrate, is_instant) for bus in config.buses if bus.port == EMULATED
    )
    return RigSettings(
        seed=told.seed if seed is None else seed,
        ptu=ptu if config.ptu.port == EMULATED else None,
        boards=boards,
        buses=buses,
        hide=tuple(parse_hide(text) for text in more.hide),
        noise_free=more.noise_free,
        session_s=more.session_s,
        soak_k=more.soak_k,
        latitude_deg=config.site.latitude_deg,
        heading_deg=config.site.heading_deg,
    )


def check_hidden(config: RigConfig, told: Emulation) -> None:
    """Refuse what cannot be hidden, before anything is started.

    Raises:
        UsageError: there is no such cause, place or size, or a sealed truth has nowhere to go.
    """
    settings = rig_settings(config, more=told)
    if told.truth is None and any(order.cause == RANDOM for order in settings.hide):
        raise UsageError(
            "what --hide random draws stands in the truth file alone, and none is named",
            "name a file to write with --truth",
        )
    draw_hidden(settings)


def port_of(config: RigConfig, device: str) -> str:
    """Return the hub's name of an emulated device's port: the unit is `ptu`."""
    return PTU_PORT if device == PTU_PORT else f"board:{device}"


def write_truth(path: Path, document: Mapping[str, Any]) -> None:
    """Write what an emulated rig hides, as JSON where the name says so, else as YAML.

    Raises:
        MachineError: the file cannot be written.
    """
    text = json.dumps(document, indent=1) if path.suffix == ".json" else dump_yaml(document)
    beside = path.with_name(path.name + ".part")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    except OSError as fault:
        raise MachineError(
            f"{path} cannot be written: {fault.strerror}", "name another file with --truth"
        ) from fault


class TruthFile:
    """Where the truth of an emulated rig goes: told at once, or sealed until the end."""

    def __init__(self, told: Emulation, rig: EmulatedRig) -> None:
        """Write what may be known at the start.

        Raises:
            MachineError: it cannot be written: better known now than at the end.
        """
        self._path, self._rig = told.truth, rig
        document = rig.truth_document()
        random = any(order.cause == RANDOM for order in rig.settings.hide)
        self._seal = Seal(document) if random else None
        if self._path is not None:
            closed = document if self._seal is None else self._seal.closed()
            write_truth(self._path, closed)

    @property
    def seal(self) -> str | None:
        """The SHA-256 of what is hidden, None where it is no secret."""
        return None if self._seal is None else self._seal.sha256

    def open(self, start_ns: int, end_ns: int) -> None:
        """Write the whole truth, with the mean bias between two times of the rig's clock.

        Raises:
            MachineError: it cannot be written.
        """
        if self._path is None:
            return
        document = self._rig.truth_document(start_ns, end_ns)
        write_truth(self._path, document if self._seal is None else self._seal.opened(document))


class EmulatorProcess:
    """`gyrorigd emulate` as a process of its own; ends with this one, however it ends."""

    def __init__(self, config_path: Path, told: Emulation) -> None:
        """Start it and read what it announces: the ports' paths, and a seal where it has one.

        Raises:
            MachineError: it did not start.
        """
        command = [sys.executable, "-m", "gyrorig_daemon", "emulate", "--json", "--until-eof"]
        command += ["--config", str(config_path), *told.arguments()]
        try:
            self._process = subprocess.Popen(  # noqa: S603 - ourselves
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,  # what it has to tell it tells as JSON
                start_new_session=True,
            )
        except OSError as fault:
            raise MachineError(
                f"the emulated rig cannot be started: {fault.strerror}",
                "free memory, or end other processes, and start again",
            ) from fault
        line = b"" if self._process.stdout is None else self._process.stdout.readline()
        announced = json.loads(line) if line else {}
        if "ports" not in announced:
            self.close()
            raise MachineError(
                f"the emulated rig did not start: {announced.get('error', 'it says nothing')}",
                f"see what `gyrorigd emulate --config {config_path}` says",
            )
        self.paths: Mapping[str, str] = announced["ports"]
        self.seal: str | None = announced.get("seal")

    def ending(self) -> str:
        """Return how it has ended by itself, "" while it runs."""
        code = self._process.poll()
        return "" if code is None else f"the emulated rig has ended (status {code})"

    def close(self) -> None:
        """End it. Closing twice is no fault."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(STOP_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def __enter__(self) -> "EmulatorProcess":
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End it."""
        self.close()
