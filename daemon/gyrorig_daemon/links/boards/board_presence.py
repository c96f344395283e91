"""State machine of a board's link: absent, silent, known, or another board.

Theory of operation. A link is ABSENT while its port is gone, and UNKNOWN from the opening of
the port until the board has identified itself (or, if it cannot, has sent a sample). Then it is
KNOWN. A KNOWN board that sends nothing for two seconds is SILENT. Its port is reopened after
five seconds, then after ten, twenty, and so on, up to a minute. After three such attempts it is
DEGRADED: somebody must look at it, while everything else continues and the attempts do, too. A
device that identifies itself as another board is FOREIGN: its samples are not used.

    ABSENT --BACK--> UNKNOWN --HELLO, sample--> KNOWN <--sample--> SILENT
    SILENT --3 reopenings--> DEGRADED           any --GONE--> ABSENT
    any --another uid--> FOREIGN --the right uid--> KNOWN
"""

from enum import Enum

SILENCE_S = 2.0
REOPEN_AFTER_S = 5.0
MAX_REOPEN_INTERVAL_S = 60.0
DEGRADED_AFTER_REOPENINGS = 3  # reopenings without a sample


class LinkState(Enum):
    """State of the link to a board; the value is the text for people."""

    ABSENT = "its port is not connected"
    UNKNOWN = "has not identified itself yet"
    KNOWN = "sends samples"
    SILENT = "sends no samples"
    DEGRADED = "sends no samples, although its port was reopened"
    FOREIGN = "another device is on its port"


class BoardPresence:
    """The state of one board's link, derived from events."""

    def __init__(self, is_up: bool, now_ns: int) -> None:
        self.state = LinkState.UNKNOWN if is_up else LinkState.ABSENT
        self.reopen_count = 0  # since its last sample
        self._last_sample_ns = now_ns
        self._opened_ns = now_ns

    @property
    def last_sample_ns(self) -> int:
        """When the last sample arrived; before the first, when the link was created."""
        return self._last_sample_ns

    def mark_absent(self) -> None:
        """The port is gone."""
        self.state = LinkState.ABSENT

    def mark_reopened(self, now_ns: int) -> None:
        """The port is open again; the board must identify itself."""
        is_degraded = self.reopen_count >= DEGRADED_AFTER_REOPENINGS
        self.state = LinkState.DEGRADED if is_degraded else LinkState.UNKNOWN
        self._opened_ns = now_ns

    def mark_foreign(self) -> None:
        """Another device has identified itself."""
        self.state = LinkState.FOREIGN

    def mark_sample(self, now_ns: int) -> None:
        """A sample of the right board arrived."""
        self.state = LinkState.KNOWN
        self._last_sample_ns, self.reopen_count = now_ns, 0

    def detect_silence(self, now_ns: int) -> bool:
        """Return whether the board has just become silent."""
        if self.state is not LinkState.KNOWN or now_ns - self._last_sample_ns <= SILENCE_S * 1e9:
            return False
        self.state = LinkState.SILENT
        return True

    def is_reopening_due(self, now_ns: int) -> bool:
        """Return whether to reopen the port now; a longer pause starts then."""
        if self.state not in (LinkState.UNKNOWN, LinkState.SILENT, LinkState.DEGRADED):
            return False
        pause_s = min(REOPEN_AFTER_S * 2.0**self.reopen_count, MAX_REOPEN_INTERVAL_S)
        if now_ns < max(self._last_sample_ns, self._opened_ns) + pause_s * 1e9:
            return False
        self.reopen_count += 1
        self._opened_ns = now_ns
        return True

    @property
    def is_newly_degraded(self) -> bool:
        """True after the reopening that makes the board degraded."""
        return self.reopen_count == DEGRADED_AFTER_REOPENINGS
