"""What people ask of a running daemon, from the socket's thread and from signals to the pump's.

What to use when: `Orders` once per process; every field is set by one side and looked at by
the other between two turns of the pump.
"""

import threading
from dataclasses import dataclass, field

from gyrorig_daemon.links.pump import StopFlag


@dataclass(slots=True)
class Orders:
    """Requests that are not carried out yet."""

    stop: StopFlag = field(default_factory=StopFlag)
    end: threading.Event = field(default_factory=threading.Event)  # of the process
    reload: threading.Event = field(default_factory=threading.Event)
    clear: threading.Event = field(default_factory=threading.Event)

    def ask_to_end(self, why: str) -> None:
        """Halt, close and end: SIGTERM, SIGINT."""
        self.end.set()
        self.stop.request(why)

    def ask_to_halt(self, who: str) -> None:
        """Halt and go on recording; an operator has to clear then."""
        self.stop.request(f"an operator's halt ({who})")

    def heard(self) -> bool:
        """Forget a stop that was acted upon; return whether the process has to end."""
        self.stop.reason = None
        if self.end.is_set():  # after the line above: a signal may come between any two
            self.stop.request("the end of the process")
            return True
        return False
