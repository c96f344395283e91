"""A disk that fails during a session of the service: reported, counted, and a halt still works.

Rows 12 and 13 of docs/faults.md, as seen by an operator: the status on the socket, the metrics, and
a halt.
"""

import errno
import os
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.recorder import Recorder
from gyrorig_daemon.service import session_runner
from gyrorig_daemon.service.metrics import MetricsWriter
from gyrorig_daemon.service.service_client import send_command
from gyrorig_daemon.service.status_server import StatusServer
from gyrorig_protocol.recording.mcap.disk_file import Disk, DiskFile

FAR = "name: far\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 10.0}\n"
FAILS_S, LOOKS_S, HALTS_S = 7.0, 10.0, 11.0  # the move ends at 16 s or so


class Failing(Disk):
    """Takes nothing while `code` is set."""

    def __init__(self) -> None:
        self.code = 0

    def ask(self) -> None:
        if self.code:
            raise OSError(self.code, os.strerror(self.code))

    def create(self, path: Path) -> DiskFile:
        self.ask()
        file = super().create(path)
        write, sync = file.write, file.sync

        def checked_write(data: bytes) -> int:
            self.ask()
            return write(data)

        def checked_sync() -> None:
            self.ask()
            sync()

        file.write, file.sync = checked_write, checked_sync  # type: ignore[method-assign]
        return file


def metric(writer: MetricsWriter, name: str) -> float:
    """The value in the metrics' file once it is written: a thread of its own does that."""
    assert writer.wait_until_idle(60.0)
    lines = writer.path.read_text().splitlines()
    (line,) = [line for line in lines if line.startswith(f"{name} ")]
    return float(line.split()[1])


@pytest.mark.parametrize(
    ("code", "words"),
    [(errno.ENOSPC, "No space left on device"), (errno.EROFS, "Read-only file system")],
    ids=["full", "read-only"],
)
def test_it_is_said_and_a_halt_is_still_answered(
    make_bench: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, code: int, words: str
) -> None:
    bench, disk = make_bench(), Failing()
    monkeypatch.setattr(session_runner, "Recorder", partial(Recorder, disk=disk))
    metrics = MetricsWriter(bench.state.metrics, every=1)
    statuses: dict[str, Any] = {}

    def handle(command: str, _: object) -> str:
        if command == "halt":
            bench.orders.request_halt("the test")
        return f"{command} heard"

    with tempfile.TemporaryDirectory() as folder:  # a socket's path must be short
        server = StatusServer(Path(folder) / "s", handle, bench.parts.counts)

        def publish(status: dict[str, Any]) -> None:
            bench.statuses.append(status)
            server.publish(status)
            metrics.publish(status)

        def look(when: str) -> None:
            statuses[when] = send_command(server.path, "status")["status"]["recorder"]
            statuses[f"{when} metric"] = metric(metrics, "gyrorig_recorder_degraded")

        bench.parts.publish = publish
        bench.put(FAR, session="on-a-bad-disk")
        bench.at(FAILS_S - 1.0, lambda: look("before"))
        bench.at(FAILS_S, lambda: setattr(disk, "code", code))
        bench.at(LOOKS_S, lambda: look("while it fails"))
        bench.at(HALTS_S, lambda: statuses.update(halt=send_command(server.path, "halt")))
        with server:
            bench.serve(20.0)
    metrics.close()
    assert (statuses["before"]["state"], statuses["before metric"]) == ("recording", 0.0)
    assert statuses["while it fails"]["state"] == "degraded"
    assert words in statuses["while it fails"]["degraded"]
    assert statuses["while it fails metric"] == 1.0
    assert statuses["while it fails"]["counts"]["disk_faults"] >= 1
    assert statuses["while it fails"]["counts"]["memory_messages"] > 100
    assert statuses["halt"] == {"ok": True, "said": "halt heard"}
    halted_s = [order[1] for order in bench.rig.stage.pan.commands if order[0] == "halt"]
    assert any(HALTS_S <= at_s < HALTS_S + 1.0 for at_s in halted_s)
    assert bench.state_at(15.0)["state"] == "fault"  # held: an operator's halt
    assert bench.pan_deg() < 100.0  # of 150
    assert bench.is_still()
