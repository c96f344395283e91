"""The local socket: permissions, disconnected clients, independence of the main loop."""

import json
import os
import socket
import struct
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.support.halt_trials import connections_of_another_user

from gyrorig_daemon.service import status_server as server_module
from gyrorig_daemon.service.service_client import (
    RefusedRequestError,
    send_command,
    stream_responses,
)
from gyrorig_daemon.service.service_context import ServiceCounts
from gyrorig_daemon.service.status_server import Peer, StatusServer
from gyrorig_protocol.errors import BusyError, MachineError


class ServedSocket:
    """A server on a path short enough for a socket, and what it handed on."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "s"
        self.counts = ServiceCounts()
        self.handled: list[str] = []
        self.server = StatusServer(self.path, self._handle, self.counts)

    def _handle(self, command: str, peer: Peer) -> str:
        self.handled.append(command)
        assert peer.pid == os.getpid()
        return f"{command} heard"

    def connect(self) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.settimeout(60.0)
        connection.connect(str(self.path))
        return connection

    def exchange(self, data: bytes) -> dict[str, Any]:
        with self.connect() as connection:
            connection.sendall(data)
            document = json.loads(connection.makefile("rb").readline())
            assert isinstance(document, dict)
            return document


@pytest.fixture
def served() -> Iterator[ServedSocket]:
    with tempfile.TemporaryDirectory() as folder:
        made = ServedSocket(Path(folder))
        with made.server:
            made.server.publish({"state": "ready"})
            yield made


def wait_for(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_status_and_commands(served: ServedSocket) -> None:
    assert send_command(served.path, "status") == {"ok": True, "status": {"state": "ready"}}
    assert send_command(served.path, "halt")["said"] == "halt heard"
    assert send_command(served.path, "clear")["said"] == "clear heard"
    assert served.handled == ["halt", "clear"]
    assert served.path.stat().st_mode & 0o777 == 0o660


def test_watching(served: ServedSocket) -> None:
    answers = stream_responses(served.path, "watch")
    assert next(answers)["status"] == {"state": "ready"}
    served.server.publish({"state": "running"})
    assert next(answers)["status"] == {"state": "running"}
    answers.close()  # type: ignore[attr-defined]


def test_who_may_command(served: ServedSocket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module.Peer, "may_command", property(lambda self: self.uid == 12345))
    for command in ("clear", "reload"):
        with pytest.raises(RefusedRequestError, match="Only root"):
            send_command(served.path, command)
    assert send_command(served.path, "halt")["ok"]
    assert send_command(served.path, "status")["ok"]
    assert served.handled == ["halt"]
    assert served.counts.requests_refused == 2


def test_the_peer_is_what_the_kernel_says() -> None:
    assert Peer(1, 0).may_command
    assert Peer(1, os.geteuid()).may_command
    assert not Peer(1, os.geteuid() + 1000).may_command
    assert struct.calcsize("3i") == 12


@pytest.mark.parametrize(
    "data",
    [
        b"\n",
        b"{}\n",
        b"[]\n",
        b'{"command": "explode"}\n',
        b'{"command": ["status"]}\n',
        b'{"command": "status", "more": 1}\n',
        b"\xff\xfe\n",
        b"[" * 4000 + b"\n",
        b"x" * 4097,
        b"x" * 9000 + b"\n",
    ],
)
def test_what_is_no_request(served: ServedSocket, data: bytes) -> None:
    answer = served.exchange(data)
    assert answer["ok"] is False
    assert answer["error"]
    assert served.handled == []
    assert send_command(served.path, "status")["ok"]  # it lives


def test_a_reader_that_never_reads_is_dropped_and_nobody_else_waits(served: ServedSocket) -> None:
    with served.connect() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.sendall(b'{"command": "watch"}\n')
        wait_for(lambda: served.counts.requests == 1)
        large = {"boards": ["x" * 60_000]}
        begun_s = time.monotonic()
        longest_s = 0.0
        for _ in range(40):
            before_s = time.monotonic()
            served.server.publish(large)  # what the pump's thread does
            longest_s = max(longest_s, time.monotonic() - before_s)
            if served.counts.clients_slow:
                break
            assert send_command(served.path, "status")["ok"]
        assert served.counts.clients_slow == 1
        assert longest_s < 5.0
        assert time.monotonic() - begun_s < 60.0


def test_a_client_that_says_nothing_is_dropped(
    served: ServedSocket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_module, "CLIENT_TIMEOUT_S", 0.1)
    with served.connect() as idle:
        assert idle.recv(1) == b""
    assert served.counts.clients_slow == 0  # it was not slow, only idle


def test_one_byte_at_a_time_and_two_in_one(served: ServedSocket) -> None:
    with served.connect() as connection:
        lines = connection.makefile("rb")
        for byte in b'{"command": "status"}\n':
            connection.sendall(bytes([byte]))
        assert json.loads(lines.readline())["ok"]
        connection.sendall(b'{"command": "halt"}\n{"command": "clear"}\n')
        assert [json.loads(lines.readline())["said"] for _ in range(2)] == [
            "halt heard",
            "clear heard",
        ]


@pytest.fixture
def users(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Return the users of the next connections, the first one first; then our own."""
    uids: list[int] = []
    real = server_module._peer

    def peer(connection: socket.socket) -> Peer:
        return Peer(os.getpid(), uids.pop(0)) if uids else real(connection)

    monkeypatch.setattr(server_module, "_peer", peer)
    yield uids
    assert not uids


def test_a_user_with_too_many_connections_locks_out_nobody(
    served: ServedSocket, users: list[int]
) -> None:
    limit = server_module.MAX_USER_CLIENTS
    users += [70001] * (limit + 1)
    held = [served.connect() for _ in range(limit)]
    wait_for(lambda: served.counts.clients == limit)
    with pytest.raises(RefusedRequestError, match="too many clients"):
        send_command(served.path, "halt")
    assert served.counts.clients_refused == 1
    users.append(70002)
    assert send_command(served.path, "halt")["ok"]
    assert send_command(served.path, "clear")["ok"]  # our own user
    for connection in held:
        connection.close()
    wait_for(lambda: not served.server._clients)
    users.append(70001)
    assert send_command(served.path, "status")["ok"]


def test_many_users_together_lock_out_nobody(served: ServedSocket, users: list[int]) -> None:
    each = server_module.MAX_USER_CLIENTS
    several = [70000 + n for n in range(server_module.MAX_CLIENTS // each)]
    held = []
    for uid in several:
        users += [uid] * each
        held += [served.connect() for _ in range(each)]
    wait_for(lambda: served.counts.clients == len(held))
    users.append(80000)
    assert send_command(served.path, "halt")["ok"]
    assert served.counts.clients_refused == 1  # the displaced one
    for _ in range(server_module.MAX_OWN_CLIENTS + 2):
        held.append(served.connect())  # our own
    assert send_command(served.path, "clear")["ok"]
    for connection in held:
        connection.close()


def test_a_byte_now_and_then_keeps_no_connection(
    served: ServedSocket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_module, "CLIENT_TIMEOUT_S", 0.6)
    with served.connect() as slow:
        slow.settimeout(0.2)
        end_s, answer = time.monotonic() + 30.0, b"still open"
        while answer:
            assert time.monotonic() < end_s
            try:
                slow.sendall(b" ")
                answer = slow.recv(1)
            except TimeoutError:
                continue
            except OSError:
                break


@pytest.mark.skipif(os.geteuid() != 0, reason="another user needs root")
def test_root_is_served_while_another_user_holds_every_connection(served: ServedSocket) -> None:
    served.path.parent.chmod(0o755)
    served.path.chmod(0o666)
    with connections_of_another_user(65534, served.path):
        wait_for(lambda: served.counts.clients_refused >= 40 - server_module.MAX_USER_CLIENTS)
        for command in ("halt", "clear", "status"):
            assert send_command(served.path, command)["ok"]


def test_a_socket_of_a_daemon_that_lives_and_of_one_that_died(served: ServedSocket) -> None:
    with pytest.raises(BusyError, match="another daemon already uses"):
        StatusServer(served.path, lambda *_: "", ServiceCounts()).__enter__()
    other = served.path.with_name("dead")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as died:
        died.bind(str(other))
    with StatusServer(other, lambda *_: "", ServiceCounts()):
        pass
    assert not other.exists()


def test_a_thread_that_sees_the_end_first_does_not_make_it_a_fault() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s"
        with StatusServer(path, lambda *_: "", ServiceCounts()) as server:
            server._stopping = True
            server._thread.join(60.0)
            assert not server._thread.is_alive()
            server.publish({"state": "ready"})  # the loop goes on without it
        assert not path.exists()


def test_nobody_there(tmp_path: Path) -> None:
    with pytest.raises(MachineError, match="no daemon is running"):
        send_command(tmp_path / "none", "status")
    with pytest.raises(MachineError, match="cannot be created"):
        StatusServer(tmp_path / ("x" * 120), lambda *_: "", ServiceCounts()).__enter__()


def test_a_stranger_behind_the_socket() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s"
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as stranger:
            stranger.bind(str(path))
            stranger.listen(1)
            answers = stream_responses(path, "status")

            def speak() -> None:
                connection, _ = stranger.accept()
                connection.recv(100)
                connection.sendall(b"220 mail ready\n")
                connection.close()

            thread = threading.Thread(target=speak)
            thread.start()
            with pytest.raises(MachineError, match="is not gyrorigd"):
                next(answers)
            thread.join()
