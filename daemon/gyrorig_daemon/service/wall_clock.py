"""Steps of the wall clock: seen, counted, and never followed.

Nothing here is timed by the wall clock but names and daily sessions; the recording's own
clock is anchored once a session. A step is a fact to be told: on a computer without a
battery-backed clock it comes a while after every start.
"""

from collections.abc import Callable

from gyrorig_daemon.links.capture_clock import HostClocks

STEP_S = 0.1  # a slew is at most 500 ppm (adjtimex(2)): 0.0005 s between two looks
LOOK_NS = 1_000_000_000
NTP_UNSYNCHRONISED = 0x40  # STA_UNSYNC of <linux/timex.h>


class WallClockTimer:
    """Looks at the clocks once a second."""

    def __init__(
        self, read: Callable[[], HostClocks], now_ns: int, on_step: Callable[[float], None]
    ) -> None:
        """Begin to look.

        Args:
            read: reads the clocks.
            now_ns: the pump's time.
            on_step: told how far the wall clock stepped, in seconds.
        """
        self._read = read
        self._on_step = on_step
        self.last: HostClocks | None = None
        self.due_ns = now_ns

    def fire(self, now_ns: int) -> None:
        """Compare what passed on both clocks since the last look."""
        self.due_ns = now_ns + LOOK_NS
        clocks, before = self._read(), self.last
        self.last = clocks
        if before is None:
            return
        passed_ns = clocks.raw_ns - before.raw_ns
        step_s = (clocks.realtime_ns - before.realtime_ns - passed_ns) * 1e-9
        if abs(step_s) > STEP_S:
            self._on_step(step_s)

    @property
    def synchronised(self) -> bool | None:
        """Whether the kernel says that the clock is disciplined, None before the first look."""
        return None if self.last is None else not self.last.ntp_status & NTP_UNSYNCHRONISED
