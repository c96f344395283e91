"""Server of the local socket: it publishes the status and accepts commands.

What to use when: one `StatusServer` per process, as a context manager. It runs in a thread of its
own and never accesses a port or a recording. It receives a finished status every second and passes
requests on. A client that does not read what it is sent is disconnected (as gpsd does), and so is
a client that sends too much.

Root and the service's own user always get a connection. Other users have `MAX_USER_CLIENTS` each
and `MAX_CLIENTS` together; if these are taken, a user with fewer connections displaces the
connection that has been idle for the longest time of the user who has the most.
"""

import contextlib
import os
import selectors
import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from gyrorig_daemon.service.service_context import ServiceCounts
from gyrorig_daemon.service.service_protocol import (
    HALT_COMMANDS,
    MAX_REQUEST_BYTES,
    PRIVILEGED_COMMANDS,
    decode_request,
    encode,
)
from gyrorig_daemon.service.watchdog import Heartbeat
from gyrorig_protocol.errors import BusyError, MachineError

STARTING_TEXT = "The daemon is starting and has no status of the rig yet. Try again in a second."
TOO_MANY_TEXT = (
    "The daemon has too many clients at the socket. Close other connections of your user, such as "
    "`gyrorigd status` in other terminals, or use sudo."
)
MAX_CLIENTS = 32  # of ordinary users
MAX_USER_CLIENTS = 8  # of each of them
MAX_OWN_CLIENTS = 32  # of root and the service's own user
MAX_ACCEPTED_AT_ONCE = 64
BACKLOG = 256  # connections that wait to be accepted
UNSENT_LIMIT_BYTES = 256_000  # several seconds of status of a large rig
CLIENT_TIMEOUT_S = 10.0  # a client must read something or send a request within this time
SELECT_TIMEOUT_S = 0.5
LOOP_STALL_LIMIT_S = 8.0
SOCKET_MODE = 0o660
_CREDENTIALS = struct.Struct("3i")  # <sys/socket.h> struct ucred: pid, uid, gid


@dataclass(frozen=True, slots=True)
class Peer:
    """Process and user at the other end, as reported by the kernel (SO_PEERCRED)."""

    pid: int
    uid: int

    @property
    def may_command(self) -> bool:
        """True for root and for the service's own user."""
        return self.uid in (0, os.geteuid())


@dataclass(slots=True)
class _Client:
    """A connection of a client."""

    socket: socket.socket
    peer: Peer
    received: bytearray = field(default_factory=bytearray)
    unsent: bytearray = field(default_factory=bytearray)
    is_watching: bool = False
    is_closing: bool = False  # once everything is sent
    last_active_s: float = field(default_factory=time.monotonic)  # it read, or sent a request


Handler = Callable[[str, Peer], str]


def _peer(connection: socket.socket) -> Peer:
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, uid, _ = _CREDENTIALS.unpack(credentials)
    return Peer(pid, uid)


class StatusServer:
    """Serves the socket from a thread; a context manager."""

    def __init__(self, path: Path, handle: Handler, counts: ServiceCounts) -> None:
        """Prepare to serve; nothing is opened yet.

        Args:
            path: path of the socket.
            handle: carries out a permitted command; returns the response text.
            counts: counters of clients and requests.
        """
        self.path = path
        self.heartbeat = Heartbeat("status socket", LOOP_STALL_LIMIT_S)
        self._handle = handle
        self._counts = counts
        self._latest_status = encode({"ok": False, "error": STARTING_TEXT})
        self._has_new_status = False
        self._stopping = False
        self._clients: dict[int, _Client] = {}
        self._selector = selectors.DefaultSelector()
        self._wake_r, self._wake_w = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._listener: socket.socket | None = None
        self._thread = threading.Thread(target=self._run, name="status", daemon=True)

    def __enter__(self) -> "StatusServer":
        """Open the socket and start the thread.

        Raises:
            BusyError: another process serves the socket.
            MachineError: the socket cannot be created.
        """
        self._listener = _listen(self.path)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._wake_r, selectors.EVENT_READ)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the thread and remove the socket."""
        self._stopping = True
        self._wake()
        if self._thread.ident is not None:
            self._thread.join(LOOP_STALL_LIMIT_S)
        with contextlib.suppress(OSError):
            self.path.unlink()
        os.close(self._wake_w)

    def publish(self, status: dict[str, Any]) -> None:
        """Publish a status; every client that watches receives it."""
        self._latest_status = encode({"ok": True, "status": status})
        self._has_new_status = True
        self._wake()

    def _wake(self) -> None:
        # full: the thread wakes anyway; broken: the thread has ended already
        with contextlib.suppress(BlockingIOError, BrokenPipeError):
            os.write(self._wake_w, b"\0")

    def _run(self) -> None:
        try:
            while not self._stopping:
                self.heartbeat.beat()
                for key, events in self._selector.select(SELECT_TIMEOUT_S):
                    self._serve(key.fileobj, events)
                if self._has_new_status:
                    self._has_new_status = False
                    for client in list(self._clients.values()):
                        if client.is_watching:
                            self._send(client, self._latest_status)
                self._drop_idle_clients()
        finally:
            for client in list(self._clients.values()):
                self._drop(client)
            if self._listener is not None:
                self._listener.close()
            self._selector.close()
            os.close(self._wake_r)

    def _serve(self, source: Any, events: int) -> None:
        if source is self._listener:
            self._accept()
        elif source == self._wake_r:
            with contextlib.suppress(BlockingIOError):
                os.read(self._wake_r, 4096)
        else:
            client = self._clients.get(source.fileno())
            if client is None:  # already disconnected
                return
            if events & selectors.EVENT_WRITE and not self._flush(client):
                return
            if events & selectors.EVENT_READ:
                self._read(client)

    def _accept(self) -> None:
        for _ in range(MAX_ACCEPTED_AT_ONCE):
            if self._listener is None:
                return
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            connection.setblocking(False)
            peer = _peer(connection)
            if not self._make_room(peer):
                self._counts.clients_refused += 1
                with contextlib.suppress(OSError):
                    connection.send(encode({"ok": False, "error": TOO_MANY_TEXT}))
                connection.close()
                continue
            self._counts.clients += 1
            self._clients[connection.fileno()] = _Client(connection, peer)
            self._selector.register(connection, selectors.EVENT_READ)

    def _make_room(self, peer: Peer) -> bool:
        """Return whether a connection of this user can be accepted; displace another if needed."""
        alike = [c for c in self._clients.values() if c.peer.may_command == peer.may_command]
        if peer.may_command:
            if len(alike) >= MAX_OWN_CLIENTS:
                self._displace(alike)
            return True
        of_user = Counter(client.peer.uid for client in alike)
        if of_user[peer.uid] >= MAX_USER_CLIENTS:
            return False
        if len(alike) < MAX_CLIENTS:
            return True
        uid, count = of_user.most_common(1)[0]
        if count <= of_user[peer.uid] + 1:
            return False
        self._displace([client for client in alike if client.peer.uid == uid])
        return True

    def _displace(self, clients: list[_Client]) -> None:
        self._counts.clients_refused += 1
        self._drop(min(clients, key=lambda client: client.last_active_s))

    def _read(self, client: _Client) -> None:
        try:
            data = client.socket.recv(MAX_REQUEST_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return
        client.received += data
        while (end := client.received.find(b"\n")) >= 0 and not client.is_closing:
            line = bytes(client.received[:end])
            del client.received[: end + 1]
            client.last_active_s = time.monotonic()  # a byte now and then is no request
            if not self._answer(client, line):
                return
        if len(client.received) > MAX_REQUEST_BYTES:
            self._refuse(client, "a request to the daemon must be one line of at most 4096 bytes")
            client.is_closing = True

    def _answer(self, client: _Client, line: bytes) -> bool:
        """Answer one request; return whether the client is still connected."""
        command = decode_request(line) if len(line) <= MAX_REQUEST_BYTES else None
        self._counts.requests += 1
        if command is None:
            return self._refuse(
                client,
                "Unknown request. Send status, watch, halt, clear or reload (docs/service.md).",
            )
        if command in PRIVILEGED_COMMANDS and not client.peer.may_command:
            return self._refuse(
                client,
                f"Permission denied. Only root and the daemon's own user may send {command}. "
                "Use sudo.",
            )
        if command in PRIVILEGED_COMMANDS | HALT_COMMANDS:
            return self._send(
                client, encode({"ok": True, "said": self._handle(command, client.peer)})
            )
        client.is_watching = command == "watch"
        return self._send(client, self._latest_status)

    def _refuse(self, client: _Client, reason: str) -> bool:
        self._counts.requests_refused += 1
        return self._send(client, encode({"ok": False, "error": reason}))

    def _send(self, client: _Client, data: bytes) -> bool:
        if len(client.unsent) + len(data) > UNSENT_LIMIT_BYTES + len(self._latest_status):
            self._counts.clients_slow += 1
            self._drop(client)
            return False
        client.unsent += data
        return self._flush(client)

    def _flush(self, client: _Client) -> bool:
        try:
            sent = client.socket.send(client.unsent)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(client)
            return False
        del client.unsent[:sent]
        if sent:
            client.last_active_s = time.monotonic()
        if client.is_closing and not client.unsent:
            self._drop(client)
            return False
        write_events = selectors.EVENT_WRITE if client.unsent else 0
        read_events = 0 if client.is_closing else selectors.EVENT_READ
        self._selector.modify(client.socket, read_events | write_events)
        return True

    def _drop_idle_clients(self) -> None:
        limit_s = time.monotonic() - CLIENT_TIMEOUT_S
        for client in list(self._clients.values()):
            if client.last_active_s >= limit_s:
                continue
            self._counts.clients_slow += bool(client.unsent)
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        descriptor = client.socket.fileno()
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(client.socket)
        self._clients.pop(descriptor, None)
        client.socket.close()


def _listen(path: Path) -> socket.socket:
    """Return a socket that listens at `path`.

    Raises:
        BusyError: another process listens there.
        MachineError: the socket cannot be created.
    """
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_socket():
            if _is_served(path):
                raise BusyError(
                    f"another daemon already uses the socket {path}",
                    "end the other daemon, or choose another socket with --socket",
                )
            path.unlink()  # left by a process that crashed
        previous_umask = os.umask(0o777 & ~SOCKET_MODE)
        try:
            listener.bind(str(path))
        finally:
            os.umask(previous_umask)
        listener.listen(BACKLOG)
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        error_text = error.strerror or str(error)
        raise MachineError(
            f"the socket {path} cannot be created ({error_text})",
            "choose another path with --socket",
        ) from error
    except BusyError:
        listener.close()
        raise
    return listener


def _is_served(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True
