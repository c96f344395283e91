"""What a rig says, sent to Foxglove while it happens: `gyrorigd run --live`.

What to use when: `live_view` for the service, `NO_VIEW` where nobody wants one. `take` gets
every message that is recorded, and samples between sessions too; `status` the daemon's own.

The bytes are the recording's: the same CDR, schemas and topics, so that what works on a
recording works here. A view must cost the recording nothing: fast boards are thinned before
anything is encoded, nothing is encoded that nobody watches, the library's own threads do the
sending and drop what a slow viewer does not take, and a fault here ends the view alone.

Nobody can command a rig this way: the server is told of no capability.
"""

import json
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from gyrorig_protocol.errors import BusyError, UsageError
from gyrorig_protocol.recording.messages import ImuRaw, Message
from gyrorig_protocol.recording.schemas import SCHEMAS

DEFAULT = "127.0.0.1:8765"  # Foxglove's own port
LOOPBACK = ("127.0.0.1", "::1", "localhost")
STATUS_TOPIC = "/gyrorigd/status"
SAMPLE_EVERY_NS = 10_000_000  # a screen shows 60 a second
EARLY_NS = 2_000_000  # a sample that comes this much early still counts: arrivals scatter


class View(Protocol):
    """Whoever watches."""

    def take(self, topic: str, message: Message, log_ns: int) -> None:
        """Show one message."""
        ...

    def status(self, document: dict[str, Any]) -> None:
        """Show the daemon's status."""
        ...

    def close(self) -> None:
        """Show no more."""
        ...


class _NoView:
    """Nobody watches."""

    def take(self, topic: str, message: Message, log_ns: int) -> None:
        """Forget it."""

    def status(self, document: dict[str, Any]) -> None:
        """Forget it."""

    def close(self) -> None:
        """Nothing is open."""


NO_VIEW: View = _NoView()


class Thinning:
    """Which samples of a topic are shown: about a hundred a second."""

    def __init__(self) -> None:
        self._due_ns: dict[str, int] = {}

    def shows(self, topic: str, log_ns: int) -> bool:
        """Whether this one is due."""
        due_ns = self._due_ns.get(topic, log_ns)
        if due_ns - log_ns > 100 * SAMPLE_EVERY_NS:
            due_ns = log_ns  # a clock anchored anew begins anew
        if log_ns < due_ns - EARLY_NS:
            return False
        # what comes late is not made up for by a burst
        self._due_ns[topic] = max(due_ns, log_ns - SAMPLE_EVERY_NS) + SAMPLE_EVERY_NS
        return True


class FoxgloveView:
    """A WebSocket server of the Foxglove SDK. Used from the pump's thread alone."""

    def __init__(self, host: str, port: int, log: Callable[[str], None]) -> None:
        """Listen.

        Args:
            host: the address to listen on.
            port: 0 takes any that is free.
            log: told once when the view ends by a fault.

        Raises:
            UsageError: the extra `live` is not installed.
            BusyError: the address cannot be listened on.
        """
        try:
            import foxglove  # noqa: PLC0415 - an extra
        except ImportError as fault:
            raise UsageError(
                "--live needs foxglove-sdk, which is not installed", "pip install 'gyrorig[live]'"
            ) from fault
        self._sdk = foxglove
        self._log = log
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="gyrorigd", host=host, port=port, context=self._context
            )
        except (RuntimeError, OSError, ValueError) as fault:
            raise BusyError(
                f"the live view cannot listen on {host}:{port}: {fault}",
                "choose another address with --live HOST:PORT",
            ) from fault
        self.port = int(self._server.port)
        self._channels: dict[str, Any] = {}
        self._thinning = Thinning()
        self._broken = False

    def take(self, topic: str, message: Message, log_ns: int) -> None:
        """Send one message, if somebody watches and it is due."""
        if self._broken:
            return
        if isinstance(message, ImuRaw) and not self._thinning.shows(topic, log_ns):
            return
        try:
            channel = self._channels.get(topic) or self._open(topic, message.TYPE)
            if channel.has_sinks():
                channel.log(message.encode(), log_time=max(0, log_ns))
        except Exception as fault:  # whatever it is: the recording goes on
            self._give_up(fault)

    def status(self, document: dict[str, Any]) -> None:
        """Send the daemon's status as JSON."""
        if self._broken:
            return
        try:
            channel = self._channels.get(STATUS_TOPIC)
            if channel is None:
                channel = self._sdk.Channel(
                    STATUS_TOPIC, schema={"type": "object"}, context=self._context
                )
                self._channels[STATUS_TOPIC] = channel
            if channel.has_sinks():
                channel.log(json.dumps(document).encode())
        except Exception as fault:
            self._give_up(fault)

    def close(self) -> None:
        """Let every viewer go."""
        with suppress(Exception):
            self._server.stop()

    def _open(self, topic: str, kind: str) -> Any:
        schema = self._sdk.Schema(name=kind, encoding="ros2msg", data=SCHEMAS[kind].encode())
        channel = self._sdk.Channel(
            topic, message_encoding="cdr", schema=schema, context=self._context
        )
        self._channels[topic] = channel
        return channel

    def _give_up(self, fault: Exception) -> None:
        self._broken = True
        self._log(f"the live view has ended, the recording goes on: {fault}")
        self.close()


def live_view(told: str | None, log: Callable[[str], None]) -> View:
    """Return the view that the command line asks for.

    Args:
        told: HOST:PORT, None for no view.
        log: told where it listens, and when it ends.

    Raises:
        UsageError: no such address, or the extra `live` is not installed.
        BusyError: the address cannot be listened on.
    """
    if told is None:
        return NO_VIEW
    host, _, port = told.rpartition(":")
    host = host.strip("[]")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise UsageError(f"--live {told} is no HOST:PORT", f"say for example --live {DEFAULT}")
    view = FoxgloveView(host, int(port), log)
    everybody = "" if host in LOOPBACK else "; whoever reaches this address sees the rig"
    shown = f"[{host}]" if ":" in host else host
    log(f"live view at ws://{shown}:{view.port}{everybody}")
    return view
