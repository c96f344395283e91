"""Whether a board is there, and whether it is the right one: told, counted, and acted upon.

Theory of operation. A link is ABSENT while its port is gone, UNKNOWN from the port's opening
until the board has said who it is (or, where it cannot, has sent a sample), then KNOWN. A
KNOWN board that sends nothing for two seconds is SILENT; its port is opened anew after
five seconds, then after ten, twenty, ... up to a minute, and after three such attempts it
is DEGRADED: something for a person, while everything else goes on and the
attempts too. A device that says it is another one is FOREIGN: not a sample of it is taken for
the board's.

    ABSENT --BACK--> UNKNOWN --who, sample--> KNOWN <--sample--> SILENT --3 reopenings--> DEGRADED
    any --GONE--> ABSENT        any --another uid--> FOREIGN --the right uid--> KNOWN
"""

from enum import Enum

SILENCE_S = 2.0
REOPEN_AFTER_S = 5.0
REOPEN_AT_MOST_EVERY_S = 60.0
DEGRADED_AFTER = 3  # reopenings without a sample


class LinkState(Enum):
    """What is known of a board; the value is what a person is told."""

    ABSENT = "its port is not there"
    UNKNOWN = "has not said yet who it is"
    KNOWN = "sends samples"
    SILENT = "sends no samples"
    DEGRADED = "sends no samples, though its port was opened anew"
    FOREIGN = "another device is on its port"


class Presence:
    """The state of one board's link, from what is seen of it."""

    def __init__(self, is_up: bool, now_ns: int) -> None:
        self.state = LinkState.UNKNOWN if is_up else LinkState.ABSENT
        self.reopened = 0  # since its last sample
        self._heard_ns = now_ns
        self._opened_ns = now_ns

    @property
    def heard_ns(self) -> int:
        """When the last sample arrived, or the first could have."""
        return self._heard_ns

    def lose(self) -> None:
        """The port is gone."""
        self.state = LinkState.ABSENT

    def come_back(self, now_ns: int) -> None:
        """The port is open again; who is there has to be said anew."""
        is_hopeless = self.reopened >= DEGRADED_AFTER
        self.state = LinkState.DEGRADED if is_hopeless else LinkState.UNKNOWN
        self._opened_ns = now_ns

    def find_foreign(self) -> None:
        """Somebody else is there."""
        self.state = LinkState.FOREIGN

    def hear(self, now_ns: int) -> None:
        """A sample of the right board came."""
        self.state = LinkState.KNOWN
        self._heard_ns, self.reopened = now_ns, 0

    def falls_silent(self, now_ns: int) -> bool:
        """Return whether the board has just fallen silent."""
        if self.state is not LinkState.KNOWN or now_ns - self._heard_ns <= SILENCE_S * 1e9:
            return False
        self.state = LinkState.SILENT
        return True

    def wants_reopening(self, now_ns: int) -> bool:
        """Return whether the port is to be opened anew; each time a longer pause begins."""
        if self.state not in (LinkState.UNKNOWN, LinkState.SILENT, LinkState.DEGRADED):
            return False
        pause_s = min(REOPEN_AFTER_S * 2.0**self.reopened, REOPEN_AT_MOST_EVERY_S)
        if now_ns < max(self._heard_ns, self._opened_ns) + pause_s * 1e9:
            return False
        self.reopened += 1
        self._opened_ns = now_ns
        return True

    @property
    def just_degraded(self) -> bool:
        """True after the reopening that makes it a person's affair."""
        return self.reopened == DEGRADED_AFTER
