"""Notifications to systemd: ready, watchdog, reloading, stopping (sd_notify(3)).

What to use when: `SystemdNotifier.from_environment()` once. Without systemd it does nothing. It
sends datagrams to the socket in `$NOTIFY_SOCKET`; no library is needed.
"""

import contextlib
import os
import socket
import time
from collections.abc import MutableMapping


class SystemdNotifier:
    """Sends the state of the service to the service manager."""

    def __init__(self, address: str | None, watchdog_s: float | None = None) -> None:
        """Send to `address`; None sends nothing.

        Args:
            address: a path, or an abstract socket name that begins with @.
            watchdog_s: the service manager's watchdog timeout.
        """
        self.watchdog_s = watchdog_s
        self._socket: socket.socket | None = None
        self._address = ""
        if address:
            self._address = "\0" + address[1:] if address.startswith("@") else address
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    @classmethod
    def from_environment(
        cls, environment: MutableMapping[str, str] = os.environ
    ) -> "SystemdNotifier":
        """Return the notifier of the environment, and remove it there: children must not notify."""
        address = environment.pop("NOTIFY_SOCKET", None)
        limit_us = environment.pop("WATCHDOG_USEC", "")
        pid = environment.pop("WATCHDOG_PID", "")
        is_for_this_process = not pid or pid == str(os.getpid())
        watchdog_s = int(limit_us) * 1e-6 if limit_us.isdecimal() and is_for_this_process else None
        return cls(address, watchdog_s or None)

    def send_ready(self) -> None:
        """Report that the start, or a reload, is complete."""
        self._send("READY=1")

    def send_reloading(self) -> None:
        """Report that the configuration is being read again."""
        now_us = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
        self._send(f"RELOADING=1\nMONOTONIC_USEC={now_us}")

    def feed_watchdog(self) -> None:
        """Feed the watchdog."""
        self._send("WATCHDOG=1")

    def send_status(self, text: str) -> None:
        """Set the status line that `systemctl status` shows."""
        self._send(f"STATUS={' '.join(text.split())[:200]}")

    def send_stopping(self) -> None:
        """Report that the service is stopping."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # a failed notification must not stop the service
                self._socket.sendto(text.encode(), self._address)
