"""From the steps of both motors to the angles and the rate of the stage, on a fine grid.

Each cause acts where it does in the mechanics: the step generator (rounded ramps), the motor (lost
steps, step size), the worm, the gap between worm and wheel, the wheel, the structure, gravity.
A rate is the difference of two angles, so that a jump of the speed has its true effect.

The pan axis is (sin e, 0, cos e) in the frame of the tilt axis at tilt 0, with e the deviation from
a right angle; stage to base is Rz(pan) Ry(-e) Rx(tilt).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from tests.bench.accuracy.board import rotation
from tests.bench.accuracy.profile import RAD_PER_STEP, FloatArray, Path
from tests.bench.rigs.prior_sizes import AXES, HiddenCauses
from tests.bench.rigs.serial_session import SerialSession

WORM_TURNS = 17.5  # motor turns per turn of the stage, E46-17.5
EARTH_RAD_S = 7.292115e-5
GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True, slots=True, eq=False)
class StepTracks:
    """The steps of both axes at the edges of the grid: as generated, and with detents."""

    edges_s: FloatArray  # (n + 1,)
    counted: tuple[FloatArray, FloatArray]  # (n + 1,) each
    turned: tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class StageMotion:
    """The true motion of the stage; n cells between n + 1 edges."""

    edges_s: FloatArray
    pan_rad: FloatArray  # (n + 1,)
    tilt_rad: FloatArray  # (n + 1,)
    rate_rad_s: FloatArray  # (n, 3), mean of each cell, in the stage frame
    gravity_m_s2: FloatArray  # (n, 3), specific force at rest, in the stage frame
    motor_speed_rad_s: FloatArray  # (n, 2), of the step generators

    @property
    def cell_s(self) -> float:
        """Length of a cell."""
        return float((self.edges_s[-1] - self.edges_s[0]) / (self.edges_s.size - 1))

    @property
    def middle_s(self) -> FloatArray:
        """Middle of each cell."""
        return np.asarray((self.edges_s[1:] + self.edges_s[:-1]) / 2.0)


def step_tracks(session: SerialSession, causes: HiddenCauses, edges_s: FloatArray) -> StepTracks:
    """Return the steps at the edges; an S-curve is a mean over the window before each edge."""
    path = Path(session.moves, session.off_steps)
    counted, turned = [], []
    for axis, name in enumerate(AXES):
        window_s = causes.get("s_curve", name)
        exact = path.counted_steps(axis, edges_s)
        off = path.angle_rad(axis, edges_s) / RAD_PER_STEP - exact
        counted.append(_mean_before(edges_s, exact, window_s))
        turned.append(counted[-1] + _mean_before(edges_s, off, window_s))
    return StepTracks(edges_s, (counted[0], counted[1]), (turned[0], turned[1]))


def stage_motion(
    tracks: StepTracks,
    causes: HiddenCauses,
    span_s: tuple[float, float],
    lean_rad: FloatArray | None = None,
) -> StageMotion:
    """Return the stage's motion.

    Args:
        tracks: steps of both axes.
        causes: of the rig.
        span_s: begin and end of the samples; events happen at a share of it.
        lean_rad: small rotation of the base about its x and y axes, shape (2,).
    """
    edges_s = tracks.edges_s
    lost_rad = [_lost_steps(tracks, axis, causes, span_s) * RAD_PER_STEP for axis in (0, 1)]
    pan, tilt = (
        _through_gears(turned * RAD_PER_STEP - lost, name, causes)
        for turned, lost, name in zip(tracks.turned, lost_rad, AXES, strict=True)
    )
    tilt = tilt + causes.get("tilt_sag") * np.sin(tilt + causes.get("tilt_sag", "phase"))
    tilt = tilt + causes.get("tilt_zero")
    pan, tilt = (
        _structure(angle, lost, name, causes, edges_s)
        for angle, lost, name in zip((pan, tilt), lost_rad, AXES, strict=True)
    )
    middle_s = (edges_s[1:] + edges_s[:-1]) / 2.0
    rate = stage_rate(edges_s, pan, tilt, causes.get("axis_nonorthogonality"))
    up = _up_in_base(lean_rad)
    gravity = GRAVITY_M_S2 * _in_stage(up, pan, tilt, causes.get("axis_nonorthogonality"))
    rate = rate + _earth(pan, tilt, causes)
    slip = causes.of_axes("board_slip")
    if np.any(slip):
        after = middle_s >= _event_s("board_slip", causes, span_s)
        turn = rotation(slip)
        rate[after] = rate[after] @ turn  # R' w for each row
        gravity[after] = gravity[after] @ turn
    cell_s = float(edges_s[1] - edges_s[0])
    motor = np.column_stack([np.diff(c) for c in tracks.counted]) * RAD_PER_STEP / cell_s
    return StageMotion(edges_s, pan, tilt, rate, gravity, motor)


def stage_rate(
    edges_s: FloatArray, pan: FloatArray, tilt: FloatArray, deviation_rad: float
) -> FloatArray:
    """Return the mean rate between edges in the stage frame, shape (n, 3)."""
    width_s = np.diff(edges_s)[:, None]
    middle = (tilt[1:] + tilt[:-1]) / 2.0
    pan_rate, tilt_rate = np.diff(pan) / width_s[:, 0], np.diff(tilt) / width_s[:, 0]
    square = np.cos(deviation_rad) * pan_rate
    return np.column_stack(
        [
            tilt_rate + np.sin(deviation_rad) * pan_rate,
            square * np.sin(middle),
            square * np.cos(middle),
        ]
    )


def _mean_before(edges_s: FloatArray, values: FloatArray, window_s: float) -> FloatArray:
    if window_s <= 0.0:
        return values
    cell_s = np.diff(edges_s)
    area = np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2.0 * cell_s)])
    before_s = edges_s - window_s
    earlier = np.interp(before_s, edges_s, area) + values[0] * np.minimum(before_s - edges_s[0], 0)
    return np.asarray((area - earlier) / window_s)


def _event_s(cause: str, causes: HiddenCauses, span_s: tuple[float, float]) -> float:
    return span_s[0] + causes.get(cause, "at") * (span_s[1] - span_s[0])


def _lost_steps(
    tracks: StepTracks, axis: int, causes: HiddenCauses, span_s: tuple[float, float]
) -> FloatArray:
    """Return the steps that the motor is behind: all at once in a motion after the event."""
    lost = causes.get("lost_steps", AXES[axis])
    steps = tracks.counted[axis]
    moving = np.flatnonzero(np.diff(steps) != 0.0)
    later = moving[tracks.edges_s[moving] >= _event_s("lost_steps", causes, span_s)]
    behind = np.zeros(steps.size)
    if lost and later.size:
        behind[later[0] + 1 :] = lost
    return behind


def _through_gears(motor_rad: FloatArray, name: str, causes: HiddenCauses) -> FloatArray:
    """Return the angle of the wheel for the angle that the steps state."""
    angle = motor_rad * (1.0 + causes.get("step_resolution", name))
    worm = causes.get("worm_error", name)
    angle = angle + worm * np.sin(WORM_TURNS * angle + causes.get("worm_error", f"{name}_phase"))
    gap = causes.get("backlash", name)
    if gap > 0.0:
        face = np.sign(causes.get("backlash", "face")) or 1.0
        angle = play(angle, gap) - face * gap / 2.0
    first = causes.get("eccentricity", name)
    if first > 0.0:
        second = first * causes.get("eccentricity", "second")
        angle = (
            angle
            + first * np.sin(angle + causes.get("eccentricity", f"{name}_phase"))
            + second * np.sin(2.0 * angle + causes.get("eccentricity", "second_phase"))
        )
    return angle


def play(angle: FloatArray, gap: float) -> FloatArray:
    """Return the driven side of a gap, which begins in its middle."""
    direction = np.sign(np.diff(angle))
    turns = np.flatnonzero(direction != 0.0)
    out = np.full(angle.size, angle[0])
    if turns.size == 0:
        return out
    changes = turns[np.flatnonzero(np.diff(direction[turns])) + 1]
    begins = [0, *changes.tolist(), angle.size - 1]
    for begin, end in pairwise(begins):
        piece = slice(begin, end + 1)
        if angle[end] > angle[begin]:
            out[piece] = np.maximum(out[begin], angle[piece] - gap / 2.0)
        else:
            out[piece] = np.minimum(out[begin], angle[piece] + gap / 2.0)
    return out


def _structure(
    angle: FloatArray, lost_rad: FloatArray, name: str, causes: HiddenCauses, edges_s: FloatArray
) -> FloatArray:
    """Return the angle of the stage on an elastic base with a resonance.

    The base twists with the acceleration of the motion. A loss of steps lasts one cell, and no base
    follows it.
    """
    compliance, share = causes.get("base_compliance", name), causes.get("ringing", name)
    cell_s = float(edges_s[1] - edges_s[0])
    out = angle
    if compliance:
        rate = np.diff(angle + lost_rad) / cell_s
        change = np.diff(rate, prepend=0.0, append=0.0) / cell_s
        out = out - compliance * change
    if share:
        rate = np.diff(angle) / cell_s
        size = next_fast_len(rate.size + round(5.0 / cell_s), real=True)
        w = 2.0 * np.pi * rfftfreq(size, cell_s)
        w0 = 2.0 * np.pi * causes.get("ringing", "frequency_hz")
        mode = w**2 / (w0**2 - w**2 + 2j * causes.get("ringing", "damping") * w0 * w)
        extra = irfft(rfft(rate, size) * mode, size)[: rate.size]
        out = out + share * np.concatenate([[0.0], np.cumsum(extra) * cell_s])
    return np.asarray(out)


def _up_in_base(lean_rad: FloatArray | None) -> FloatArray:
    if lean_rad is None:
        return np.array([0.0, 0.0, 1.0])
    return np.asarray(rotation(np.array([lean_rad[0], lean_rad[1], 0.0])).T[:, 2])


def _in_stage(
    vector: FloatArray, pan: FloatArray, tilt: FloatArray, deviation_rad: float
) -> FloatArray:
    """Return a vector of the base in the stage frame at the middle of each cell, (n, 3)."""
    p, t = (pan[1:] + pan[:-1]) / 2.0, (tilt[1:] + tilt[:-1]) / 2.0
    x = np.cos(p) * vector[0] + np.sin(p) * vector[1]
    y = -np.sin(p) * vector[0] + np.cos(p) * vector[1]
    z = np.full(p.size, vector[2])
    sine, cosine = np.sin(deviation_rad), np.cos(deviation_rad)
    x, z = cosine * x + sine * z, -sine * x + cosine * z
    return np.column_stack([x, np.cos(t) * y + np.sin(t) * z, -np.sin(t) * y + np.cos(t) * z])


def _earth(pan: FloatArray, tilt: FloatArray, causes: HiddenCauses) -> FloatArray:
    if "earth_rotation" not in causes.values:
        return np.zeros((pan.size - 1, 3))
    sine = causes.get("earth_rotation", "sine_latitude")
    heading = causes.get("earth_rotation", "heading")
    north = EARTH_RAD_S * np.sqrt(1.0 - sine**2)
    axis = np.array([-north * np.sin(heading), north * np.cos(heading), EARTH_RAD_S * sine])
    return _in_stage(axis, pan, tilt, causes.get("axis_nonorthogonality"))
