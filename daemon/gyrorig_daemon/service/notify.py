"""What a service says to systemd: ready, alive, reloading, stopping (sd_notify(3)).

What to use when: `Notifier.from_environment()` once; outside systemd it says nothing. A
datagram to the socket that `$NOTIFY_SOCKET` names; no library is needed for it.
"""

import contextlib
import os
import socket
import time
from collections.abc import MutableMapping


class Notifier:
    """The daemon's word to whoever started it."""

    def __init__(self, address: str | None, watchdog_s: float | None = None) -> None:
        """Speak to `address`; None for nobody.

        Args:
            address: a path, or an abstract name that begins with @.
            watchdog_s: it is taken for dead after so long without a word.
        """
        self.watchdog_s = watchdog_s
        self._socket: socket.socket | None = None
        self._address = ""
        if address:
            self._address = "\0" + address[1:] if address.startswith("@") else address
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    @classmethod
    def from_environment(cls, environment: MutableMapping[str, str] = os.environ) -> "Notifier":
        """Return what the environment asks for, and take it out: children are not to speak."""
        address = environment.pop("NOTIFY_SOCKET", None)
        limit_us = environment.pop("WATCHDOG_USEC", "")
        pid = environment.pop("WATCHDOG_PID", "")
        ours = not pid or pid == str(os.getpid())
        watchdog_s = int(limit_us) * 1e-6 if limit_us.isdecimal() and ours else None
        return cls(address, watchdog_s or None)

    def ready(self) -> None:
        """Say that the start, or a reload, is over."""
        self._say("READY=1")

    def reloading(self) -> None:
        """Say that the configuration is being read again."""
        now_us = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
        self._say(f"RELOADING=1\nMONOTONIC_USEC={now_us}")

    def alive(self) -> None:
        """Feed the watchdog."""
        self._say("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Say in a line what goes on; `systemctl status` shows it."""
        self._say(f"STATUS={' '.join(text.split())[:200]}")

    def stopping(self) -> None:
        """Say that the end has begun."""
        self._say("STOPPING=1")

    def close(self) -> None:
        """Say nothing more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _say(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # it must not stop what it reports on
                self._socket.sendto(text.encode(), self._address)
