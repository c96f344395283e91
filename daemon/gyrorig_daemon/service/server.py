"""The local socket: who is there, what they may ask, and what they are told.

What to use when: `StatusServer` once per daemon, as a context. It lives in a thread of its
own and never touches a port or a recording: it is handed a finished status every second and
hands on requests. A client that does not take what it is sent is dropped (as gpsd does);
so is one that sends too much, and there are never more than `MAX_CLIENTS`.
"""

import contextlib
import os
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from gyrorig_daemon.service.counts import ServiceCounts
from gyrorig_daemon.service.watchdog import Pulse
from gyrorig_daemon.service.wire import (
    COMMANDING,
    HALTING,
    MAX_REQUEST_BYTES,
    decode_request,
    encode,
)
from gyrorig_protocol.errors import BusyError, MachineError

STARTING = "the daemon has only just begun and knows nothing of the rig yet: ask again in a second"
MAX_CLIENTS = 32
UNSENT_LIMIT_BYTES = 256_000  # some seconds of a large rig's status
PATIENCE_S = 10.0  # so long may a client take nothing, or say nothing
TURN_S = 0.5
LOOP_LIMIT_S = 8.0
SOCKET_MODE = 0o660
_CREDENTIALS = struct.Struct("3i")  # <sys/socket.h> struct ucred: pid, uid, gid


@dataclass(frozen=True, slots=True)
class Peer:
    """Who is at the other end, by the kernel's word (SO_PEERCRED)."""

    pid: int
    uid: int

    @property
    def may_command(self) -> bool:
        """True for root and for the daemon's own user."""
        return self.uid in (0, os.geteuid())


@dataclass(slots=True)
class _Client:
    """One connection."""

    socket: socket.socket
    peer: Peer
    heard: bytearray = field(default_factory=bytearray)
    unsent: bytearray = field(default_factory=bytearray)
    watches: bool = False
    ends: bool = False  # once everything is sent
    active_s: float = field(default_factory=time.monotonic)  # it took or said something


Handler = Callable[[str, Peer], str]


class StatusServer:
    """Serves the socket from a thread. Use it as a context."""

    def __init__(self, path: Path, handle: Handler, counts: ServiceCounts) -> None:
        """Prepare to serve; nothing is opened yet.

        Args:
            path: of the socket.
            handle: carries out a command that its peer may give; returns what to answer.
            counts: clients and requests are counted there.
        """
        self.path = path
        self.pulse = Pulse("status socket", LOOP_LIMIT_S)
        self._handle = handle
        self._counts = counts
        self._latest = encode({"ok": False, "error": STARTING})
        self._fresh = False
        self._ended = False
        self._clients: dict[int, _Client] = {}
        self._selector = selectors.DefaultSelector()
        self._wake_r, self._wake_w = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._listener: socket.socket | None = None
        self._thread = threading.Thread(target=self._run, name="status", daemon=True)

    def __enter__(self) -> "StatusServer":
        """Open the socket and serve.

        Raises:
            BusyError: another daemon serves it.
            MachineError: it cannot be made.
        """
        self._listener = _listen(self.path)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._wake_r, selectors.EVENT_READ)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Serve no more and take the socket away."""
        self._ended = True
        self._wake()
        if self._thread.ident is not None:
            self._thread.join(LOOP_LIMIT_S)
        with contextlib.suppress(OSError):
            self.path.unlink()
        os.close(self._wake_w)

    def publish(self, status: dict[str, Any]) -> None:
        """Tell what is so now; whoever watches is told."""
        self._latest = encode({"ok": True, "status": status})
        self._fresh = True
        self._wake()

    def _wake(self) -> None:
        # full: it will look anyway; broken: its thread has seen the end already
        with contextlib.suppress(BlockingIOError, BrokenPipeError):
            os.write(self._wake_w, b"\0")

    def _run(self) -> None:
        try:
            while not self._ended:
                self.pulse.beat()
                for key, events in self._selector.select(TURN_S):
                    self._serve(key.fileobj, events)
                if self._fresh:
                    self._fresh = False
                    for client in list(self._clients.values()):
                        if client.watches:
                            self._send(client, self._latest)
                self._drop_the_idle()
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
            if client is None:  # dropped a moment ago
                return
            if events & selectors.EVENT_WRITE and not self._flush(client):
                return
            if events & selectors.EVENT_READ:
                self._read(client)

    def _accept(self) -> None:
        if self._listener is None:
            return
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return
        if len(self._clients) >= MAX_CLIENTS:
            self._counts.clients_refused += 1
            connection.close()
            return
        connection.setblocking(False)
        told = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        pid, uid, _ = _CREDENTIALS.unpack(told)
        self._counts.clients += 1
        self._clients[connection.fileno()] = _Client(connection, Peer(pid, uid))
        self._selector.register(connection, selectors.EVENT_READ)

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
        client.active_s = time.monotonic()
        client.heard += data
        while (end := client.heard.find(b"\n")) >= 0 and not client.ends:
            line = bytes(client.heard[:end])
            del client.heard[: end + 1]
            if not self._answer(client, line):
                return
        if len(client.heard) > MAX_REQUEST_BYTES:
            self._refuse(client, "a request is one line of at most 4096 bytes")
            client.ends = True

    def _answer(self, client: _Client, line: bytes) -> bool:
        """Answer one request; return whether the client is still there."""
        command = decode_request(line) if len(line) <= MAX_REQUEST_BYTES else None
        self._counts.requests += 1
        if command is None:
            return self._refuse(
                client,
                "unknown request: send status, watch, halt, clear or reload (docs/service.md)",
            )
        if command in COMMANDING and not client.peer.may_command:
            return self._refuse(
                client, f"{command} is for root and the daemon's own user; try sudo"
            )
        if command in COMMANDING | HALTING:
            return self._send(
                client, encode({"ok": True, "said": self._handle(command, client.peer)})
            )
        client.watches = command == "watch"
        return self._send(client, self._latest)

    def _refuse(self, client: _Client, why: str) -> bool:
        self._counts.requests_refused += 1
        return self._send(client, encode({"ok": False, "error": why}))

    def _send(self, client: _Client, data: bytes) -> bool:
        if len(client.unsent) + len(data) > UNSENT_LIMIT_BYTES + len(self._latest):
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
            client.active_s = time.monotonic()
        if client.ends and not client.unsent:
            self._drop(client)
            return False
        more = selectors.EVENT_WRITE if client.unsent else 0
        reads = 0 if client.ends else selectors.EVENT_READ
        self._selector.modify(client.socket, reads | more)
        return True

    def _drop_the_idle(self) -> None:
        limit_s = time.monotonic() - PATIENCE_S
        for client in list(self._clients.values()):
            if client.active_s >= limit_s:
                continue
            self._counts.clients_slow += bool(client.unsent)
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        number = client.socket.fileno()
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(client.socket)
        self._clients.pop(number, None)
        client.socket.close()


def _listen(path: Path) -> socket.socket:
    """Return a socket that listens at `path`.

    Raises:
        BusyError: somebody listens there already.
        MachineError: it cannot be made there.
    """
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_socket():
            if _answers(path):
                raise BusyError(
                    f"another daemon serves {path}", "end it, or name another socket with --socket"
                )
            path.unlink()  # left by one that died
        before = os.umask(0o777 & ~SOCKET_MODE)
        try:
            listener.bind(str(path))
        finally:
            os.umask(before)
        listener.listen(MAX_CLIENTS)
        listener.setblocking(False)
    except OSError as fault:
        listener.close()
        words = fault.strerror or str(fault)
        raise MachineError(
            f"no socket can be made at {path}: {words}", "name another place with --socket"
        ) from fault
    except BusyError:
        listener.close()
        raise
    return listener


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True
