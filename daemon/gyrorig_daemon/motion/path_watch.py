"""Whether the unit is where its orders can have brought it.

Answers carry no check, and a line can lose a digit: one odd answer is counted and no
more. Several in a row are no accident: another hand moves the unit, its count has
jumped, or somebody else answers in its place (reference: reliability.md section 6).
"""

from collections.abc import Mapping

from gyrorig_daemon.motion.exchange import Position
from gyrorig_daemon.motion.ptu_client import PtuClient
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import Axis

MARGIN_STEPS = 16  # 0.8 deg at 185 arc-seconds; counts do not overshoot at all
ODD_IN_A_ROW = 3

Span = tuple[int, int]


class PathWatch:
    """Watches the answers of one step of a program."""

    def __init__(self, client: PtuClient) -> None:
        """Watch nothing yet; odd answers are counted at `client`."""
        self._client = client
        self._spans: dict[Axis, Span] = {}
        self._odd = 0

    def expect(self, start: Mapping[Axis, int], targets: Mapping[Axis, int]) -> None:
        """Expect each axis of `start` on its way from there to its target, or at rest.

        An axis of which no arrival was seen yet may be anywhere: one answer alone is not sure.
        """
        self._odd = 0
        self._spans = {
            axis: (min(at, targets.get(axis, at)), max(at, targets.get(axis, at)))
            for axis, at in start.items()
        }

    def look(self, position: Position) -> bool:
        """Return whether the answer is one that the orders can have brought about.

        Raises:
            DeviceError: several in a row are not.
        """
        answered = {}
        if position.has_pan:
            answered[Axis.PAN] = position.pan_steps
        if position.has_tilt:
            answered[Axis.TILT] = position.tilt_steps
        for axis, steps in answered.items():
            low, high = self._spans.get(axis, (steps, steps))
            if low - MARGIN_STEPS <= steps <= high + MARGIN_STEPS:
                continue
            self._odd += 1
            self._client.counts.implausible += 1
            if self._odd >= ODD_IN_A_ROW:
                raise DeviceError(
                    f"the unit answers {axis.word} {steps} steps, "
                    f"and its orders allow {low} to {high}",
                    "another hand moves it, or something is wrong with its line: look at it",
                )
            return False
        self._odd = 0
        return True
