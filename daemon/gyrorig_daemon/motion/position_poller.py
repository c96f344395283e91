"""Position polls of any unit: what the last answers say, and when the unit is gone.

The driver knows which request it sends. The recorder decides which moment in the interval of a
poll is used.
"""

from collections.abc import Callable, Mapping

from gyrorig_daemon.motion.pan_tilt_driver import Poll, no_answer_error, unidentified_error
from gyrorig_daemon.motion.ptu_exchange import Position
from gyrorig_daemon.motion.unit import Unit
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import Axis

# The unit is gone after so many consecutive polls without a reply, or after this time and at
# least two polls.
MAX_UNANSWERED_POLLS = 5
MAX_SILENCE_S = 4.0


class PositionPoller:
    """Polls the position of the unit, at its limit of rate or slower."""

    def __init__(
        self, unit: Unit, rate_hz: float | None, on_position: Callable[[Position], None]
    ) -> None:
        """Poll `unit`; every position goes to `on_position`.

        Args:
            unit: an identified unit.
            rate_hz: polls per second; None for the vendor's limit of the dialect.
            on_position: called with every position.
        """
        self._driver = unit.driver
        self._on_position = on_position
        if rate_hz is not None:
            self._driver.set_poll_rate(rate_hz)
        self._steps: dict[Axis, int] = {}
        self._forget_steps()
        self._previous_steps: dict[Axis, int] = {}
        self._is_still: bool | None = None
        self._unanswered_polls = 0
        self._last_answer_ns = 0

    def read_positions(self) -> dict[Axis, int]:
        """Poll both axes and return their positions in steps.

        Raises:
            DeviceError: the unit does not answer.
        """
        self._forget_steps()
        while len(self._steps) < len(Axis):
            self.poll()
        return dict(self._steps)

    def poll(self, checked: bool = True) -> Position | None:
        """Poll once; None without a usable reply.

        Args:
            checked: raise an error if the unit has lost synchrony or was disconnected.

        Raises:
            DeviceError: synchrony is lost, or the unit is silent or was disconnected.
        """
        poll = self._driver.poll()
        exchange = poll.exchange
        position = self._make_position(poll)
        if position is not None:
            self._unanswered_polls, self._last_answer_ns = 0, exchange.reply_ns
            self._on_position(position)
        else:
            self._unanswered_polls += 1
        if checked and not self._driver.is_identified:
            raise unidentified_error(self._driver.location)
        if checked and self._driver.lost_synchrony is not None:
            raise DeviceError(
                f"the pan-tilt unit no longer knows its position: {self._driver.lost_synchrony}",
                "remove all objects from the unit's range of motion, then start again with --home",
            )
        if self._is_silent(exchange.reply_ns):
            raise no_answer_error(self._driver.location, poll.request)
        return position

    def is_at(self, targets: Mapping[Axis, int]) -> bool:
        """Return whether the axes are at rest at their targets, according to two replies each."""
        for axis, target in targets.items():
            if self._steps.get(axis) != target or self._previous_steps.get(axis) != target:
                return False
        return self._is_still in (None, True)

    def _make_position(self, poll: Poll) -> Position | None:
        if not poll.steps:
            return None
        for axis, steps in poll.steps.items():
            self._store_steps(axis, steps)
        self._is_still = poll.is_still
        if len(self._steps) < len(Axis):
            return None  # the position of the other axis is not known yet
        return Position(
            exchange=poll.exchange,
            pan_steps=self._steps[Axis.PAN],
            tilt_steps=self._steps[Axis.TILT],
            has_pan=Axis.PAN in poll.steps,
            has_tilt=Axis.TILT in poll.steps,
            is_still=poll.is_still,
            counter=poll.counter,
            earliest_ns=poll.earliest_ns,
            latest_ns=poll.latest_ns,
            synchrony_lost=self._driver.lost_synchrony is not None
            or not self._driver.is_identified,
        )

    def _forget_steps(self) -> None:
        """Forget all positions; an axis that the unit does not have stays at 0."""
        self._steps = {axis: 0 for axis in Axis if axis not in self._driver.axes}

    def _is_silent(self, now_ns: int) -> bool:
        if self._unanswered_polls >= MAX_UNANSWERED_POLLS:
            return True
        silence_s = (now_ns - self._last_answer_ns) * 1e-9 if self._last_answer_ns else 0.0
        return self._unanswered_polls >= 2 and silence_s > MAX_SILENCE_S

    def _store_steps(self, axis: Axis, steps: int) -> None:
        if axis in self._steps:
            self._previous_steps[axis] = self._steps[axis]
        self._steps[axis] = steps
