"""The service process: which configuration is in force if ports cannot be opened."""

import os
import pty
import select
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.links.ports.port_hub import PortsGoneError
from gyrorig_daemon.service import service_process
from gyrorig_daemon.service.service_context import OperatorRequests, ServiceContext
from gyrorig_daemon.service.service_loop import LoopExit
from gyrorig_daemon.service.systemd_notifier import SystemdNotifier
from gyrorig_protocol.errors import BusyError, MachineError, UsageError

RIG = (
    "rig: NAME\nptu: {port: emulated, baud: 115200}\n"
    "boards: [{id: B-1, port: emulated, baud: 460800}]\n"
)
Turn = Callable[["ScriptedProcess"], LoopExit]


class ScriptedProcess(service_process.ServiceProcess):
    """The process without ports: each opening does what the next turn says."""

    def __init__(self, folder: Path, turns: list[Turn], refused: tuple[str, ...] = ()) -> None:
        self.config = folder / "rig.yaml"
        self.write("first")
        self.turns, self.refused = turns, refused
        self.opened: list[str] = []
        self.orders = OperatorRequests()
        call = service_process.ServiceOptions(self.config, folder / "state", folder / "s")
        super().__init__(call, self.orders, SystemdNotifier(None))

    def write(self, name: str) -> None:
        self.config.write_text(RIG.replace("NAME", name))

    def reload(self, name: str) -> LoopExit:
        self.write(name)
        assert self._reload_config() == ""
        return LoopExit.REOPEN

    @contextmanager
    def _open_rig(self) -> Iterator[Any]:
        self.opened.append(self._config.config.rig)
        if self._config.config.rig in self.refused:
            raise UsageError("/dev/x (ptu) cannot be used", "mend it")
        yield self


class Loop:
    """In place of the daemon's loop."""

    def __init__(self, service: ScriptedProcess, parts: ServiceContext) -> None:
        assert parts.config_text == service.config.read_bytes() or service.refused
        self._service = service

    def run(self) -> LoopExit:
        return self._service.turns.pop(0)(self._service)


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(service_process, "ServiceLoop", Loop)
    monkeypatch.setattr(service_process, "REOPEN_DELAY_S", 0.01)
    with tempfile.TemporaryDirectory() as made:
        yield Path(made)


def end(_: ScriptedProcess) -> LoopExit:
    return LoopExit.END


def lose(_: ScriptedProcess) -> LoopExit:
    raise PortsGoneError("the acquisition process ended")


@pytest.mark.parametrize(
    "ptu",
    [
        "driver: directed_perceptio",
        'driver: scpi_table, commands: {nosuch: "x"}',
        'driver: scpi_table, commands: {number: "[0-9.]+"}',
    ],
)
def test_a_driver_or_command_that_does_not_exist_is_refused_at_load(
    tmp_path: Path, ptu: str
) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG.replace("port: emulated, baud: 115200", f"port: emulated, {ptu}"))
    with pytest.raises(UsageError):
        service_process.load_config(path)


def test_a_service_that_cannot_start_halts_the_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    device, line = pty.openpty()
    config = tmp_path / "rig.yaml"
    unit = f"port: {os.ttyname(line)}, baud: 9600"
    config.write_text(RIG.replace("port: emulated, baud: 115200", unit, 1))
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "queue").touch()  # as on a read-only disk: no folder, and none can be
    options = service_process.ServiceOptions(config, tmp_path / "state", tmp_path / "s")
    service = service_process.ServiceProcess(options, OperatorRequests(), SystemdNotifier(None))
    with pytest.raises(MachineError, match="cannot be used"):
        service.run()
    assert select.select([device], [], [], 0.0)[0]
    assert os.read(device, 100).strip(b" ") == b"H"
    assert "has sent the halt command" in capsys.readouterr().err
    os.close(device)
    os.close(line)


LONG_PROGRAMS = {
    "bytes": "name: p\nsteps:\n" + "  - rest: {seconds: 1.0}\n" * 3_000,
    "steps": "name: p\nsteps:\n"
    + "  - repeat: {times: 9000, steps: [{rest: {seconds: 1.0}}]}\n" * 3,
    "name": 'name: "a\\e[2J"\nsteps:\n  - rest: {seconds: 1.0}\n',
}


@pytest.mark.parametrize("program", LONG_PROGRAMS.values(), ids=LONG_PROGRAMS)
def test_a_program_of_the_schedule_has_the_limits_of_a_job(tmp_path: Path, program: str) -> None:
    (tmp_path / "p.yaml").write_text(program)
    path = tmp_path / "rig.yaml"
    path.write_text(RIG + "schedule: [{name: often, program: p.yaml, every_h: 1.0}]\n")
    with pytest.raises(UsageError, match=r"the daemon takes at most|has control characters"):
        service_process.load_config(path)


def test_a_reload_opens_the_new_rig(folder: Path) -> None:
    service = ScriptedProcess(folder, [lambda s: s.reload("second"), end])
    service.run()
    assert service.opened == ["first", "second"]


def test_ports_that_cannot_be_opened_bring_the_old_rig_back(folder: Path) -> None:
    turns: list[Turn] = [lambda s: s.reload("bad"), lambda s: s.reload("third"), end]
    service = ScriptedProcess(folder, turns, ("bad",))
    service.run()
    assert service.opened == ["first", "bad", "first", "third"]
    assert service._counts.reloads_refused == 1


def test_a_lost_acquisition_process_is_replaced_for_ever(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turns: list[Turn] = [lose, lose, lose, lose, lose, end]
    service = ScriptedProcess(folder, turns)
    service.run()
    assert service._counts.acquisition_restarts == 5
    assert capsys.readouterr().err.count("The ports are opened again") == 5


def test_a_port_that_is_taken_later_is_waited_for_and_at_the_start_it_is_not(folder: Path) -> None:
    def taken(_: ScriptedProcess) -> LoopExit:
        raise BusyError("/dev/x (ptu) is busy")

    ScriptedProcess(folder, [taken, taken, end]).run()
    service = ScriptedProcess(folder, [], ("first",))
    with pytest.raises(UsageError, match="cannot be used"):
        service.run()


def test_told_to_end_while_nothing_can_be_opened(folder: Path) -> None:
    def end_then_lose(service: ScriptedProcess) -> LoopExit:
        service.orders.request_termination("SIGTERM")
        raise PortsGoneError("the acquisition process ended")

    service = ScriptedProcess(folder, [end_then_lose])
    service.run()
    assert service.opened == ["first"]
