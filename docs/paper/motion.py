"""Generator of pan-tilt motions, without noise by default.

It shares no code with the emulator, which makes the recordings of end_to_end.py. The
paper gives its path only as a drawing (Fig. 4b) and as "a rotation around the pan angle, then
... the tilt direction ... repeated in four periods, totaling 75s". Therefore this
module contains several paths that fit this description, as corners in degrees.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate import calibrate_as_printed
from gyrorig_solver.estimate.paper.paper_method import (
    READING_OF_TABLE_3,
    BiasSource,
    PaperReading,
    PaperResult,
)

Corners = list[tuple[float, float]]

DURATION_S = 75.0  # section III
PERIODS = 4  # section III
PAN_DEG, TILT_DEG = 60.0, 30.0  # not in the text; within the range of a PTU-E46
STATIC_S = 100.0  # section III
RATE_HZ = 100.0  # not in the text; the lowest output rate of the L3G4200D (data sheet)
NOISE_DPS_ROOT_HZ = 0.03  # L3G4200D, typical (data sheet)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Angles and rates of the two axes over time; the quasi-static test starts at 0 s."""

    time_s: FloatArray  # (n,)
    pan_rad: FloatArray  # (n,)
    tilt_rad: FloatArray  # (n,)
    pan_rad_s: FloatArray  # (n,)
    tilt_rad_s: FloatArray  # (n,)
    static: BoolArray  # (n,)

    def body_rate_rad_s(self) -> FloatArray:
        """Rate of the stage in its own frame, shape (n, 3)."""
        return np.column_stack(
            (
                self.tilt_rad_s,
                self.pan_rad_s * np.sin(self.tilt_rad),
                self.pan_rad_s * np.cos(self.tilt_rad),
            )
        )


def paths(pan: float = PAN_DEG, tilt: float = TILT_DEG) -> dict[str, Corners]:
    """The whole run of each path, by name, as (pan, tilt) corners in degrees."""
    rectangle = [(pan, 0.0), (pan, tilt), (0.0, tilt), (0.0, 0.0)]
    signs = ((1, 1), (-1, -1), (1, -1), (-1, 1))
    periods: dict[str, Corners] = {
        "A pan out and back, tilt out and back": [(pan, 0), (0, 0), (0, tilt), (0, 0)],
        "A2 the same to both sides": [(pan, 0), (-pan, 0), (0, 0), (0, tilt), (0, -tilt), (0, 0)],
        "B rectangle": list(rectangle),
        "B' rectangle, tilt first": [(0, tilt), (pan, tilt), (pan, 0), (0, 0)],
        "B2 four-corner rectangle": [
            (pan, -tilt), (pan, tilt), (-pan, tilt), (-pan, -tilt),
        ],
        "C both axes together": [(pan, tilt), (0, 0), (-pan, -tilt), (0, 0)],
        "D tilt out and back at the pan end": [(pan, 0), (pan, tilt), (pan, 0), (0, 0)],
        "E pan out and back at the tilt end": [(0, tilt), (pan, tilt), (0, tilt), (0, 0)],
        "H pan to both sides at +tilt and -tilt": [
            (0, tilt), (pan, tilt), (-pan, tilt), (0, tilt),
            (0, -tilt), (pan, -tilt), (-pan, -tilt), (0, -tilt), (0, 0),
        ],
    }  # fmt: skip
    runs: dict[str, Corners] = {}
    for name, period in periods.items():
        start = period[-1]
        runs[name] = [start, *(period * PERIODS)]
    runs["G rectangles with alternating signs"] = [
        (0.0, 0.0),
        *((a * p, b * t) for a, b in signs for p, t in rectangle),
    ]
    return runs


def along(
    corners: Corners,
    duration_s: float = DURATION_S,
    rate_hz: float = RATE_HZ,
    static_s: float = STATIC_S,
) -> Motion:
    """Rest for the static test, then go through `corners` with moves of equal duration.

    A move follows (1 - cos) / 2, so that rates are continuous.
    """
    points = np.radians(np.array(corners, dtype=np.float64))
    legs = len(corners) - 1
    leg_s = duration_s / legs
    resting = round(static_s * rate_hz)
    time_s = (np.arange(resting + round(duration_s * rate_hz) + 1) - resting) / rate_hz
    under_way_s = np.maximum(time_s, 0.0)
    leg = np.minimum((under_way_s / leg_s).astype(np.intp), legs - 1)
    phase = np.pi * (under_way_s / leg_s - leg)
    step = points[leg + 1] - points[leg]
    angle = points[leg] + step * (0.5 - 0.5 * np.cos(phase))[:, None]
    rate = step * (0.5 * np.pi / leg_s * np.sin(phase))[:, None]
    return Motion(time_s, angle[:, 0], angle[:, 1], rate[:, 0], rate[:, 1], time_s < 0.0)


def white_noise_rad_s(count: int, seed: int, rate_hz: float = RATE_HZ) -> FloatArray:
    """Noise of the L3G4200D's density in samples at `rate_hz`, shape (count, 3).

    A one-sided density N gives samples of variance N^2 rate / 2.
    """
    sigma = np.radians(NOISE_DPS_ROOT_HZ) * np.sqrt(rate_hz / 2.0)
    return np.random.default_rng(seed).normal(scale=sigma, size=(count, 3))


def calibrated(
    motion: Motion,
    rate_rad_s: FloatArray,
    bias: BiasSource,
    reading: PaperReading = READING_OF_TABLE_3,
) -> PaperResult:
    """The paper's method on samples of `motion`, with one of its two biases."""
    return calibrate_as_printed(
        motion.time_s,
        rate_rad_s,
        motion.pan_rad,
        motion.tilt_rad,
        motion.static,
        reading=replace(reading, bias=bias),
    )


def rotation_about_tilt_axis(angle_rad: float) -> FloatArray:
    """Rotation of a board about the tilt axis x, with the sign of M in eq. 1, shape (3, 3)."""
    c, s = float(np.cos(angle_rad)), float(np.sin(angle_rad))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
