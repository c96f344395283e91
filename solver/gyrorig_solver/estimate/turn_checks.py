"""Checks of stated turns against the gyro: reversed and mirrored axes, wrong angles, cut turns.

A person writes the sign, the angle and the section of each turn. A gain with negative scale factors
fits turns with a wrong sign as well as the true gain fits the true turns, so that no residual
shows the mistake.

What to use when: `check_turn_unit` before a result, `find_reversed_turns` and
`describe_contradiction` for reasons against it, `describe_cut_turns` for a remark.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.attitude.time_shift import UNIT_RATIOS, UNIT_TOLERANCE

OPPOSITE_COSINE = -0.5  # between stated and measured turn; permuted axes have about 0
MAX_NAMED = 4  # turns in a message


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredTurn:
    """One stated turn and what the gyro shows of it, without the bias."""

    begin_s: float
    axis: FloatArray  # (3,), stated
    angle_rad: float  # stated
    std_rad: float  # stated
    rotation_rad: FloatArray  # (3,), the integral of the rates
    # The turn in one sample period at the begin and at the end, the larger of both.
    edge_rad: float

    @property
    def is_opposite(self) -> bool:
        """Whether the gyro turned against the stated direction."""
        return self._along() < OPPOSITE_COSINE * float(np.linalg.norm(self.rotation_rad))

    @property
    def text(self) -> str:
        """The begin, the stated angle and the angle of the gyro."""
        along_rad = self._along()
        sign = np.sign(self.angle_rad) * (-1.0 if along_rad < 0.0 else 1.0)
        measured_rad = sign * float(np.linalg.norm(self.rotation_rad))
        return (
            f"at {self.begin_s:.1f} s {np.degrees(self.angle_rad):+.4g} deg are stated and the "
            f"gyro turned by {np.degrees(measured_rad):+.4g} deg"
        )

    def _along(self) -> float:
        """Return the measured turn in the stated direction, rad."""
        return float(self.rotation_rad @ self.axis) * float(np.sign(self.angle_rad))


def check_turn_unit(turns: Sequence[MeasuredTurn]) -> None:
    """Raise an error if the gyro turned 57.3 or 1/57.3 times as far as stated, in every turn.

    Raises:
        InputError: the unit of the rates is wrong; the error states both units.
    """
    angles_rad = np.abs([turn.angle_rad for turn in turns])
    measured_rad = np.linalg.norm([turn.rotation_rad for turn in turns], axis=1)
    for unit_ratio, written, stated in UNIT_RATIOS:
        error = np.log(np.maximum(measured_rad, 1e-12) / (angles_rad * unit_ratio))
        if np.all(np.abs(error) < UNIT_TOLERANCE):
            raise InputError(
                f"the gyro turned {unit_ratio:.3g} times as far as the stated turns, as if its "
                f"rates are in {written} and the import stated {stated}",
                "correct `unit` under `gyro` in the import map, and import again; if the unit is "
                "right, correct `angle_deg` of the turns",
            )


def find_reversed_turns(turns: Sequence[MeasuredTurn], gain: FloatArray) -> str:
    """Return the reason if turns or axes are reversed, else an empty text.

    Args:
        turns: of the fit.
        gain: of the fit, (3, 3), with nominal columns for axes without a turn.
    """
    opposite = [turn for turn in turns if turn.is_opposite]
    if opposite:
        return (
            f"{len(opposite)} of {len(turns)} turns have the opposite direction in the gyro: "
            f"{_list_turns(opposite)}. The scale factors of these axes are negative. Correct the "
            "sign of the angle, which is positive if the turn is counter-clockwise seen from the "
            "end of the axis, unless the sensor's axis is really reversed"
        )
    if float(np.linalg.det(gain)) < 0.0:
        return (
            "the axes of the gyro are a mirror image of the axes of the stated turns, so a scale "
            "factor is negative. Correct the order and the signs of `axis` of the turns or of the "
            "columns of the gyro, unless an axis of the sensor is really reversed"
        )
    return ""


def describe_contradiction(turns: Sequence[MeasuredTurn], residual_sigma: Sequence[float]) -> str:
    """Return which turns do not agree with the others.

    Args:
        turns: of the fit.
        residual_sigma: of each turn, in standard deviations of what is stated of it.
    """
    order = np.argsort(-np.asarray(residual_sigma), kind="stable")
    worst = [turns[k] for k in sorted(order[:2].tolist())]
    return (
        f"the stated turns contradict each other. The largest differences: {_list_turns(worst)}. "
        "Correct the angle, the axis or the section of the wrong turn, or remove it"
    )


def describe_cut_turns(turns: Sequence[MeasuredTurn]) -> tuple[str, ...]:
    """Return a remark if the board turned at the begin or at the end of turns."""
    cut = [turn for turn in turns if turn.edge_rad > turn.std_rad]
    if not cut:
        return ()
    worst = max(cut, key=lambda turn: turn.edge_rad / turn.std_rad)
    return (
        f"the board turns at the begin or at the end of {len(cut)} of {len(turns)} turns, for "
        f"example by {np.degrees(worst.edge_rad):.2g} deg in one sample at {worst.begin_s:.1f} s. "
        f"The stated standard deviation of its angle is {np.degrees(worst.std_rad):.2g} deg. If "
        "the section does not contain the whole turn, the scale factor is wrong: extend it into "
        "the rests before and after the turn",
    )


def _list_turns(turns: Sequence[MeasuredTurn]) -> str:
    more = f", and {len(turns) - MAX_NAMED} more" if len(turns) > MAX_NAMED else ""
    return "; ".join(turn.text for turn in turns[:MAX_NAMED]) + more
