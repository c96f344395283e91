"""One port of the acquisition process: open, or waiting for the next attempt to open it.

Theory of operation. A port is up while its line is open. It goes down when the line is
unplugged, when opening is refused, or when the daemon wants it opened again. From then on it
is tried about every two seconds with a random variation, without limit, as gpsd does
(`DEVICE_RECONNECT`). It is opened by its path: a device that is plugged in again has the same
link and another node. Pending writes fail when it goes down.
"""

import os
from dataclasses import dataclass, field

from gyrorig_daemon.links.ports.port_kinds import (
    SELF_TIMESTAMPED_KINDS,
    Line,
    PortSettings,
    open_line,
)
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.links.ports.serial_port import PortRefusedError

RETRY_NS = 2_000_000_000
_JITTER = 0.25  # relative variation of the time between two attempts
MAX_EMPTY_READS = 100  # consecutive, although the port is readable and not unplugged
BURST_S = 2.0  # of its quota: what a port may send at once, after a stall of this process
MUTE_NS = 100_000_000  # a port that exceeds its quota is not read for so long
MAX_DISCARDING_READS = 16  # after that


@dataclass(slots=True)
class PendingWrite:
    """A write that is not finished."""

    data: bytes
    deadline_ns: int
    before_ns: int = 0
    is_own: bool = False  # a halt of this process, which nobody waits for


@dataclass(slots=True)
class SupervisedPort:
    """One port and its pending writes."""

    index: int
    settings: PortSettings
    retry_interval_ns: int = RETRY_NS
    line: Line | None = None
    retry_ns: int = 0  # when to try again; unused while the line is open
    empty_reads: int = 0
    last_refusal: str = ""  # why the last attempt failed
    writes: list[PendingWrite] = field(default_factory=list)
    halt_reason: bytes = b""  # why this process has halted the unit; until RELEASE
    is_halt_ordered: bool = False
    muted_until_ns: int = 0  # it has exceeded its quota; 0: it has not
    _credit_bytes: float = 0.0
    _credit_ns: int = 0

    @property
    def final_command(self) -> bytes:
        """What to send when the daemon is gone."""
        return self.settings.final_command.encode("latin-1")

    @property
    def is_urgent(self) -> bool:
        """True if each reply is waited for: the port of the unit."""
        return bool(self.settings.final_command)

    @property
    def is_self_timestamped(self) -> bool:
        """True if each received frame has its own timestamp, so that it may be read later."""
        return self.settings.kind in SELF_TIMESTAMPED_KINDS

    def open(self) -> None:
        """Open the line.

        Raises:
            PortRefusedError: it cannot be opened; the next attempt is scheduled.
        """
        try:
            self.line = open_line(self.settings)
        except PortRefusedError as fault:
            self.last_refusal = str(fault)
            self.retry_ns = raw_ns() + _jittered_ns(self.retry_interval_ns)
            raise
        self.last_refusal, self.empty_reads = "", 0

    def close_line(self, retry_now: bool = False) -> None:
        """Close the line; `retry_now` asks for an immediate attempt to open it."""
        line, self.line = self.line, None
        self.retry_ns = 0 if retry_now else raw_ns() + _jittered_ns(self.retry_interval_ns)
        if line is not None:
            line.close()

    def read(self, has_hung_up: bool) -> bytes | None:
        """Return received bytes, b"" if the port is gone, None if nothing was received.

        A readable port without bytes is not gone unless the kernel reports a hang-up: another
        program may have read them.
        """
        if self.line is None:
            return None
        try:
            data = self.line.read()
        except BlockingIOError:
            return None
        except OSError:
            return b""
        if data:
            self.empty_reads = 0
            return data
        self.empty_reads += 1
        return b"" if has_hung_up or self.empty_reads > MAX_EMPTY_READS else None

    def exceeds_quota(self, received: int, now_ns: int) -> bool:
        """Count received bytes; return whether the port must be muted now."""
        rate = self.settings.quota_bytes_per_s
        earned = rate * (now_ns - self._credit_ns) * 1e-9
        self._credit_bytes = min(self._credit_bytes + earned, rate * BURST_S) - received
        self._credit_ns = now_ns
        if self._credit_bytes >= 0.0:
            return False
        self.muted_until_ns = now_ns + MUTE_NS
        return True

    def discard(self) -> int:
        """Discard what has arrived while the port was muted; return how many bytes."""
        self.muted_until_ns, discarded = 0, 0
        for _ in range(MAX_DISCARDING_READS):
            data = self.read(False)
            if not data:
                break
            discarded += len(data)
        return discarded


def _jittered_ns(interval_ns: int) -> int:
    """Return a random interval, so that ports, and rigs in one building, do not retry together."""
    share = 2.0 * os.urandom(1)[0] / 255.0 - 1.0
    return int(interval_ns * (1.0 + _JITTER * share))
