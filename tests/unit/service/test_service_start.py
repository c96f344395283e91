"""The process around the loop: which configuration is in force when ports cannot be opened."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gyrorig_daemon.links.hub import PortsGoneError
from gyrorig_daemon.service import start
from gyrorig_daemon.service.daemon import Ending
from gyrorig_daemon.service.notify import Notifier
from gyrorig_daemon.service.orders import Orders
from gyrorig_daemon.service.parts import Parts
from gyrorig_protocol.errors import BusyError, UsageError

RIG = (
    "rig: NAME\nptu: {port: emulated, baud: 115200}\n"
    "boards: [{id: B-1, port: emulated, baud: 460800}]\n"
)
Turn = Callable[["Scripted"], Ending]


class Scripted(start.Service):
    """The process without ports: each opening does what the next turn says."""

    def __init__(self, folder: Path, turns: list[Turn], refused: tuple[str, ...] = ()) -> None:
        self.config = folder / "rig.yaml"
        self.write("first")
        self.turns, self.refused = turns, refused
        self.opened: list[str] = []
        self.orders = Orders()
        call = start.Call(self.config, folder / "state", folder / "s")
        super().__init__(call, self.orders, Notifier(None))

    def write(self, name: str) -> None:
        self.config.write_text(RIG.replace("NAME", name))

    def reload(self, name: str) -> Ending:
        self.write(name)
        assert self._reread() == ""
        return Ending.REOPEN

    @contextmanager
    def _rig(self) -> Iterator["Scripted"]:  # type: ignore[override]
        self.opened.append(self._sound.config.rig)
        if self._sound.config.rig in self.refused:
            raise UsageError("/dev/x (ptu) cannot be used", "mend it")
        yield self


class Loop:
    """In place of the daemon's loop."""

    def __init__(self, service: Scripted, parts: Parts) -> None:
        assert parts.config_text == service.config.read_bytes() or service.refused
        self._service = service

    def run(self) -> Ending:
        return self._service.turns.pop(0)(self._service)


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(start, "Daemon", Loop)
    monkeypatch.setattr(start, "AGAIN_S", 0.01)
    with tempfile.TemporaryDirectory() as made:
        yield Path(made)


def end(_: Scripted) -> Ending:
    return Ending.END


def lose(_: Scripted) -> Ending:
    raise PortsGoneError("the acquisition process ended")


def test_a_reload_opens_the_new_rig(folder: Path) -> None:
    service = Scripted(folder, [lambda s: s.reload("second"), end])
    service.run()
    assert service.opened == ["first", "second"]


def test_ports_that_cannot_be_opened_bring_the_old_rig_back(folder: Path) -> None:
    turns: list[Turn] = [lambda s: s.reload("bad"), lambda s: s.reload("third"), end]
    service = Scripted(folder, turns, ("bad",))
    service.run()
    assert service.opened == ["first", "bad", "first", "third"]
    assert service._counts.reloads_refused == 1


def test_a_lost_acquisition_process_is_replaced_for_ever(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turns: list[Turn] = [lose, lose, lose, lose, lose, end]
    service = Scripted(folder, turns)
    service.run()
    assert service._counts.acquisition_restarts == 5
    assert capsys.readouterr().err.count("the ports are opened anew") == 5


def test_a_port_that_is_taken_later_is_waited_for_and_at_the_start_it_is_not(folder: Path) -> None:
    def taken(_: Scripted) -> Ending:
        raise BusyError("/dev/x (ptu) is busy")

    Scripted(folder, [taken, taken, end]).run()
    service = Scripted(folder, [], ("first",))
    with pytest.raises(UsageError, match="cannot be used"):
        service.run()


def test_told_to_end_while_nothing_can_be_opened(folder: Path) -> None:
    def end_then_lose(service: Scripted) -> Ending:
        service.orders.ask_to_end("SIGTERM")
        raise PortsGoneError("the acquisition process ended")

    service = Scripted(folder, [end_then_lose])
    service.run()
    assert service.opened == ["first"]
