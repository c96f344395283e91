"""The signals of `gyrorigd record` and the pipe that halts the unit."""

import signal

import pytest

from gyrorig_daemon.commands import record_command
from gyrorig_daemon.links.ports.halt_pipe import HaltPipe


def test_the_pipe_is_closed_after_the_handlers_that_write_to_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A signal between both would be written to a closed pipe, and nobody would read it."""
    before = [signal.getsignal(number) for number in record_command.SIGNALS]
    at_close: list[object] = []
    close = HaltPipe.close

    def watched_close(pipe: HaltPipe) -> None:
        at_close.extend(signal.getsignal(number) for number in record_command.SIGNALS)
        close(pipe)

    monkeypatch.setattr(HaltPipe, "close", watched_close)
    with record_command._stop_by_signal() as stop:
        assert signal.getsignal(signal.SIGTERM) not in before
        assert stop.reason is None
    assert at_close == before
