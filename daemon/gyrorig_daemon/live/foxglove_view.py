"""A WebSocket server that shows a rig in Foxglove while it runs: `gyrorigd run --live`.

What to use when: `open_live_view` for the service; `LiveView` is the interface of a view, and
`NO_VIEW` the view that shows nothing.

The bytes are those of the recording: the same CDR encoding, schemas and topics. Whatever
displays a recording displays the live view. A view must not disturb the recording. Therefore
samples of fast boards are thinned before they are encoded, nothing is encoded without a
viewer, the library's own threads send and discard what a slow viewer does not take, and a
fault here ends only the view.

Nobody can command a rig this way: the server offers no capability.
"""

import json
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from gyrorig_protocol.errors import BusyError, UsageError
from gyrorig_protocol.recording.encoding.message_schemas import SCHEMAS
from gyrorig_protocol.recording.messages import ImuRaw, Message

DEFAULT_ADDRESS = "127.0.0.1:8765"  # Foxglove's default port
LOOPBACK = ("127.0.0.1", "::1", "localhost")
STATUS_TOPIC = "/gyrorigd/status"
SAMPLE_EVERY_NS = 10_000_000  # a screen shows 60 per second
EARLY_TOLERANCE_NS = 2_000_000  # arrival times scatter: a sample this early is shown


class LiveView(Protocol):
    """Shows messages and the daemon's status while they happen."""

    def show_message(self, topic: str, message: Message, log_ns: int) -> None:
        """Show one message."""
        ...

    def show_status(self, document: dict[str, Any]) -> None:
        """Show the daemon's status."""
        ...

    def close(self) -> None:
        """Disconnect every viewer."""
        ...


class _NoView:
    def show_message(self, topic: str, message: Message, log_ns: int) -> None:
        pass

    def show_status(self, document: dict[str, Any]) -> None:
        pass

    def close(self) -> None:
        pass


NO_VIEW: LiveView = _NoView()


class SampleThinning:
    """Selects the samples of a topic that are shown: about 100 per second."""

    def __init__(self) -> None:
        self._due_ns: dict[str, int] = {}

    def is_due(self, topic: str, log_ns: int) -> bool:
        """Return whether this sample is shown."""
        due_ns = self._due_ns.get(topic, log_ns)
        if due_ns - log_ns > 100 * SAMPLE_EVERY_NS:
            due_ns = log_ns  # the clock was anchored again: start again
        if log_ns < due_ns - EARLY_TOLERANCE_NS:
            return False
        # do not catch up with a burst after a gap
        self._due_ns[topic] = max(due_ns, log_ns - SAMPLE_EVERY_NS) + SAMPLE_EVERY_NS
        return True


class FoxgloveView:
    """A WebSocket server of the Foxglove SDK, used from the event loop's thread only."""

    def __init__(self, host: str, port: int, log: Callable[[str], None]) -> None:
        """Start the server.

        Args:
            host: the address to listen on.
            port: 0 for any free port.
            log: called once if the view ends with a fault.

        Raises:
            UsageError: the extra `live` is not installed.
            BusyError: the address cannot be listened on.
        """
        try:
            import foxglove  # noqa: PLC0415 - an extra
        except ImportError as fault:
            raise UsageError(
                "the option --live needs the package foxglove-sdk, which is not installed",
                "run `pip install 'gyrorig[live]'`",
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
                f"the live view cannot listen on {host}:{port} ({fault})",
                "choose another address with --live HOST:PORT",
            ) from fault
        self.port = int(self._server.port)
        self._channels: dict[str, Any] = {}
        self._thinning = SampleThinning()
        self._has_failed = False

    def show_message(self, topic: str, message: Message, log_ns: int) -> None:
        """Send one message if somebody watches and it is due."""
        if self._has_failed:
            return
        if isinstance(message, ImuRaw) and not self._thinning.is_due(topic, log_ns):
            return
        try:
            channel = self._channels.get(topic) or self._open(topic, message.TYPE)
            if channel.has_sinks():
                channel.log(message.encode(), log_time=max(0, log_ns))
        except Exception as fault:  # whatever it is, the recording continues
            self._close_after_fault(fault)

    def show_status(self, document: dict[str, Any]) -> None:
        """Send the daemon's status as JSON."""
        if self._has_failed:
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
            self._close_after_fault(fault)

    def close(self) -> None:
        """Disconnect every viewer."""
        with suppress(Exception):
            self._server.stop()

    def _open(self, topic: str, kind: str) -> Any:
        schema = self._sdk.Schema(name=kind, encoding="ros2msg", data=SCHEMAS[kind].encode())
        channel = self._sdk.Channel(
            topic, message_encoding="cdr", schema=schema, context=self._context
        )
        self._channels[topic] = channel
        return channel

    def _close_after_fault(self, fault: Exception) -> None:
        self._has_failed = True
        self._log(f"The live view has ended, the recording continues. Cause: {fault}")
        self.close()


def open_live_view(address: str | None, log: Callable[[str], None]) -> LiveView:
    """Return the view that the command line asks for.

    Args:
        address: HOST:PORT, None for no view.
        log: called with the address, and when the view ends.

    Raises:
        UsageError: the address is not valid, or the extra `live` is not installed.
        BusyError: the address cannot be listened on.
    """
    if address is None:
        return NO_VIEW
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise UsageError(
            f"the address in --live {address} does not have the form HOST:PORT",
            f"give an address such as --live {DEFAULT_ADDRESS}",
        )
    view = FoxgloveView(host, int(port), log)
    warning = (
        ""
        if host in LOOPBACK
        else (". Everybody who can reach this address can see the data of the rig")
    )
    shown_host = f"[{host}]" if ":" in host else host
    log(f"Live view at ws://{shown_host}:{view.port}{warning}")
    return view
