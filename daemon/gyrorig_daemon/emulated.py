"""The emulated rig that a configuration describes: its settings, and its own process.

A port that reads `emulated` is opened on a pty by `gyrorigd emulate`, run as a process of
its own, so that the daemon talks to it exactly as to hardware.
"""

import contextlib
import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from gyrorig_daemon.config import EMULATED, PTU_PORT, RigConfig
from gyrorig_daemon.emulator.settings import BoardSettings, PtuSettings, RigSettings
from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import MachineError

# one of the L3G4200D's low-pass choices at each rate (RIOT-OS drivers/include/l3g4200d.h)
_BANDWIDTH_HZ = {100: 25.0, 200: 50.0, 400: 110.0, 800: 110.0}
STOP_PATIENCE_S = 10.0


def rig_settings(config: RigConfig, seed: int | None = None) -> RigSettings:
    """Return the settings of the emulated rig: only the ports that read `emulated`.

    Args:
        config: the rig.
        seed: instead of the configuration's own.
    """
    told = config.emulator
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
        )
        for board in config.boards
        if board.port == EMULATED
    )
    return RigSettings(
        seed=told.seed if seed is None else seed,
        ptu=ptu if config.ptu.port == EMULATED else None,
        boards=boards,
    )


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
        raise MachineError(f"{path} cannot be written: {fault.strerror}", "choose --truth") from (
            fault
        )


@dataclass(frozen=True, slots=True)
class EmulatorRun:
    """How to run `gyrorigd emulate`."""

    config_path: Path
    seed: int | None = None
    truth: Path | None = None


class EmulatorProcess:
    """`gyrorigd emulate` as a process of its own; ends with this one, however it ends."""

    def __init__(self, run: EmulatorRun) -> None:
        """Start it and read the paths it announces.

        Raises:
            MachineError: it did not start.
        """
        command = [sys.executable, "-m", "gyrorig_daemon", "emulate", "--json", "--until-eof"]
        command += ["--config", str(run.config_path)]
        if run.seed is not None:
            command += ["--seed", str(run.seed)]
        if run.truth is not None:
            command += ["--truth", str(run.truth)]
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
                f"the emulated rig cannot be started: {fault.strerror}", "make room for it"
            ) from fault
        line = b"" if self._process.stdout is None else self._process.stdout.readline()
        told = json.loads(line) if line else {}
        if "ports" not in told:
            self.close()
            raise MachineError(
                f"the emulated rig did not start: {told.get('error', 'it says nothing')}",
                "run gyrorigd emulate to see more",
            )
        self.paths: Mapping[str, str] = told["ports"]

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
