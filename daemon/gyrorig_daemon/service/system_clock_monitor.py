"""Detection of steps of the system time. They are counted, and never followed.

Only file names and daily sessions use the system time; the clock of a recording is anchored
once per session. On a computer without a real-time clock a step occurs some time after each
start. It is reported as an event.
"""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta

from gyrorig_daemon.clocks.capture_clock import HostClocks

STEP_THRESHOLD_S = 0.1  # a slew is at most 500 ppm (adjtimex(2)): 0.0005 s between two checks
CHECK_PERIOD_NS = 1_000_000_000
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# Messages have 32-bit seconds (ROS 2 builtin_interfaces/Time). A session can take a week.
RECORDABLE_S = (0, 2**31 - 1 - 7 * 86_400)


def clock_problem(utc_s: float) -> str:
    """Return why nothing can be recorded at this system time, "" if it can."""
    first_s, last_s = RECORDABLE_S
    if first_s <= utc_s <= last_s:
        return ""
    date = EPOCH + timedelta(seconds=utc_s)
    last_date = EPOCH + timedelta(seconds=last_s)
    return (
        f"the system time is {date:%Y-%m-%d}, and a recording can begin from {EPOCH:%Y-%m-%d} to "
        f"{last_date:%Y-%m-%d}. Set the clock of the computer. Sessions then start without "
        "further action"
    )


class SystemClockMonitor:
    """Compares the system time with the raw monotonic clock once per second."""

    def __init__(
        self, read: Callable[[], HostClocks], now_ns: int, on_step: Callable[[float], None]
    ) -> None:
        """Start to monitor.

        Args:
            read: reads the clocks.
            now_ns: the pump's time.
            on_step: called with the size of a step in seconds.
        """
        self._read = read
        self._on_step = on_step
        self.last_reading: HostClocks | None = None
        self.due_ns = now_ns

    def fire(self, now_ns: int) -> None:
        """Compare the time that has passed on both clocks since the last check."""
        self.due_ns = now_ns + CHECK_PERIOD_NS
        clocks, previous = self._read(), self.last_reading
        self.last_reading = clocks
        if previous is None:
            return
        elapsed_ns = clocks.raw_ns - previous.raw_ns
        step_s = (clocks.realtime_ns - previous.realtime_ns - elapsed_ns) * 1e-9
        if abs(step_s) > STEP_THRESHOLD_S:
            self._on_step(step_s)

    @property
    def is_synchronised(self) -> bool | None:
        """Whether the system time follows UTC, None if that is not known."""
        return None if self.last_reading is None else self.last_reading.is_synchronised
