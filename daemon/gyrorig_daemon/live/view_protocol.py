"""The interface of a live view, and the view that shows nothing."""

from typing import Any, Protocol

from gyrorig_protocol.recording.messages import Message


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
