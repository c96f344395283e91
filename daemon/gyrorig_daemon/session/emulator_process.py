"""The emulated rig of a configuration: its settings, its truth file, its process.

A port that is `emulated` is opened on a pseudo-terminal by `gyrorigd emulate`, which runs as
a separate process. The daemon talks to it exactly as to hardware.
"""

import contextlib
import json
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from gyrorig_daemon.config import EMULATED, RigConfig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import (
    BoardSettings,
    BusSettings,
    HandSettings,
    PtuSettings,
    RigSettings,
)
from gyrorig_daemon.emulator.injection import RANDOM, parse_injection, sample_injected_causes
from gyrorig_daemon.emulator.rig_truth import RigTruth
from gyrorig_daemon.emulator.truth_commitment import TruthCommitment
from gyrorig_daemon.emulator.twin import draw_twin, make_twin_rig
from gyrorig_daemon.emulator.units import find_front_end
from gyrorig_daemon.session.emulation_options import EmulationOptions
from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.child_process import module_command
from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import MachineError, UsageError

# one of the L3G4200D's low-pass choices at each rate (RIOT-OS drivers/include/l3g4200d.h)
_BANDWIDTH_HZ = {100: 25.0, 200: 50.0, 400: 110.0, 800: 110.0}
STOP_TIMEOUT_S = 10.0


def emulated_rig_settings(
    config: RigConfig,
    seed: int | None = None,
    emulation: EmulationOptions | None = None,
    is_instant: bool = False,
) -> RigSettings:
    """Return the settings of the emulated rig: only the ports that are `emulated`.

    Args:
        config: the rig.
        seed: replaces the seed of the configuration.
        emulation: hidden causes and other options.
        is_instant: frames that the host sends on a bus take no time, as through `serve_rig`.

    Raises:
        UsageError: a cause cannot be hidden.
    """
    emulator_config, emulation = config.emulator, emulation or EmulationOptions()
    seed = emulation.seed if seed is None else seed
    ptu = PtuSettings(
        driver=config.ptu.driver,
        dialect=emulator_config.dialect,
        baud=config.ptu.baud,
        command_time_ms=emulator_config.command_time_ms,
        homed=emulator_config.homed,
        pan_sign=config.ptu.pan_sign,
        tilt_sign=config.ptu.tilt_sign,
    )
    if config.ptu.port == EMULATED and not config.ptu.is_person:
        ptu = find_front_end(config.ptu.driver).adjust(ptu)
    boards = tuple(
        BoardSettings(
            name=board.id,
            odr_hz=float(emulator_config.odr_hz),
            bandwidth_hz=emulator_config.bandwidth_hz or _BANDWIDTH_HZ[emulator_config.odr_hz],
            full_scale_dps=float(emulator_config.gyro_full_scale_dps),
            baud=board.baud,
            format=board.format,
            columns=board.columns,
            signals=board.signals,
            options=board.options,
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
        seed=emulator_config.seed if seed is None else seed,
        ptu=ptu if config.ptu.port == EMULATED and not config.ptu.is_person else None,
        hand=HandSettings() if config.ptu.is_person else None,
        boards=boards,
        buses=buses,
        injections=tuple(parse_injection(text) for text in emulation.hide),
        noise_free=emulation.noise_free,
        session_s=emulation.session_s,
        soak_k=emulation.soak_k,
        session_seed=emulation.session_seed,
        prompt_unit=emulation.is_replay,
        latitude_deg=config.site.latitude_deg,
        heading_deg=config.site.heading_deg,
    )


@dataclass(frozen=True, slots=True, eq=False)
class BuiltRig:
    """An emulated rig, and what only its maker knows of it."""

    rig: EmulatedRig
    plain: RigTruth | None  # the truth without causes; None: it is sampled from the seed
    notes: tuple[str, ...]  # causes of a twin that the rig does not have


def build_emulated_rig(
    config: RigConfig, emulation: EmulationOptions, origin_ns: int, is_instant: bool = False
) -> BuiltRig:
    """Return the emulated rig of a configuration, from its twin if it has one.

    Args:
        config: the rig.
        emulation: hidden causes and other options.
        origin_ns: power-up, on the clock of the hub or server that drives the rig.
        is_instant: see `emulated_rig_settings`.

    Raises:
        UsageError: a cause cannot be hidden, or the twin cannot be used.
    """
    settings = emulated_rig_settings(config, emulation=emulation, is_instant=is_instant)
    if config.twin is None:
        return BuiltRig(EmulatedRig(settings, origin_ns), None, ())
    twin = draw_twin(config.twin, emulation.draw)
    made = make_twin_rig(twin, settings, emulation.twin_recording)
    return BuiltRig(EmulatedRig(made.settings, origin_ns, made.truth), made.plain, made.notes)


def check_emulation(config: RigConfig, emulation: EmulationOptions) -> None:
    """Check the hidden causes and the twin before anything is started.

    Raises:
        UsageError: a cause, place or size is not valid, secret parameters have no file, or the twin
            cannot be used.
    """
    if emulation.draw and config.twin is None:
        raise UsageError(
            "the option --draw needs a rig file with the section `twin`",
            "remove --draw, or give the file twin.yaml that `gyrorig twin` has written",
        )
    settings = emulated_rig_settings(config, emulation=emulation)
    if emulation.truth is None and any(
        hidden_cause.cause == RANDOM for hidden_cause in settings.injections
    ):
        raise UsageError(
            "the option --hide random needs the option --truth, because the random error is "
            "written only to the output file of --truth",
            "add --truth FILE. The daemon writes the true parameters to this file",
        )
    if config.twin is None:
        sample_injected_causes(settings)
    else:
        make_twin_rig(draw_twin(config.twin, emulation.draw), settings, emulation.twin_recording)


def write_truth(path: Path, document: Mapping[str, Any]) -> None:
    """Write the true parameters of an emulated rig, as JSON if the name ends so, else as YAML.

    Raises:
        MachineError: the file cannot be written.
    """
    text = json.dumps(document, indent=1) if path.suffix == ".json" else dump_yaml(document)
    try:
        write_atomically(path, text.encode(), durable=False)
    except OSError as fault:
        raise MachineError(
            f"the truth file {path} cannot be written ({fault.strerror})",
            "choose another file with --truth",
        ) from fault


class TruthFile:
    """The file for the true parameters; until the end only their hash if they are secret."""

    def __init__(self, emulation: EmulationOptions, rig: EmulatedRig) -> None:
        """Write what may be known at the start.

        Raises:
            MachineError: the file cannot be written.
        """
        self._path, self._rig = emulation.truth, rig
        document = rig.truth_document()
        has_random_cause = any(
            hidden_cause.cause == RANDOM for hidden_cause in rig.settings.injections
        )
        self._commitment = TruthCommitment(document) if has_random_cause else None
        if self._path is not None:
            published = (
                document if self._commitment is None else self._commitment.commitment_document()
            )
            write_truth(self._path, published)

    @property
    def commitment(self) -> str | None:
        """The SHA-256 of the hidden parameters, None if they are not secret."""
        return None if self._commitment is None else self._commitment.sha256

    def write_full_truth(self, start_ns: int, end_ns: int) -> None:
        """Write the complete truth, with the mean bias between two times of the rig's clock.

        Raises:
            MachineError: the file cannot be written.
        """
        if self._path is None:
            return
        document = self._rig.truth_document(start_ns, end_ns)
        write_truth(
            self._path,
            document if self._commitment is None else self._commitment.revealed_document(document),
        )


class EmulatorProcess:
    """`gyrorigd emulate` as a child process, which ends together with this one."""

    def __init__(self, config_path: Path, emulation: EmulationOptions) -> None:
        """Start it, and read the paths of its ports and the hash of hidden parameters.

        Raises:
            MachineError: it did not start.
        """
        command = module_command("gyrorig_daemon", "emulate", "--json", "--until-eof")
        command += ["--config", str(config_path), *emulation.arguments()]
        try:
            self._process = subprocess.Popen(  # noqa: S603 - ourselves
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,  # it reports errors as JSON
                start_new_session=True,
            )
        except OSError as fault:
            raise MachineError(
                f"the emulated rig cannot be started ({fault.strerror})",
                "free memory or end other processes, and start the program again",
            ) from fault
        line = b"" if self._process.stdout is None else self._process.stdout.readline()
        announced = json.loads(line) if line else {}
        if "ports" not in announced:
            self.close()
            raise MachineError(
                f"the emulated rig did not start: {announced.get('error', 'it reports no error')}",
                f"run `gyrorigd emulate --config {config_path}` to see the reason",
            )
        self.paths: Mapping[str, str] = announced["ports"]
        self.commitment: str | None = announced.get("seal")
        self.power_up_ns: int = announced.get("power_up_raw_ns", 0)

    def ending_text(self) -> str:
        """Return how the process has ended, "" while it runs."""
        code = self._process.poll()
        return "" if code is None else f"the emulated rig has ended (status {code})"

    def close(self) -> None:
        """End the process. It may be closed twice."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(STOP_TIMEOUT_S)
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
