"""What gravity tells of a unit's tilt zero and of how upright its pan axis stands.

What to use when: `tilt_zero_from_accelerometer` with the mean readings of rests at several
tilts, and better at several pans; `lean_by_gyro` to set it against the gyro's misalignment.

At a rest, with the vertical in the base frame u = (p, q, 1) (p, q small: the pan axis leans
against the vertical), told tilt t, tilt zero z, the board's mount m about x:

    up in the stage frame = Rx(t)^T (c p + s q, c q - s p, 1),  c, s = cos, sin of pan
    reading = bias + A_x (..) + A_y (..) + A_z (..)

A's columns are where the accelerometer has the stage's axes, scale included: three unknown
vectors. Its scale and bias are the accelerometer's own, unknown too.

What is separable, and what is not:
- A_y and A_z: a circle over tilt, a phase. phi = z - m, the told tilt being -phi where the
  accelerometer's forward axis is square to the pan axis. z and m enter every reading as
  their difference, here and in the gyro's rates alike: no sensor on the board tells them
  apart. Only a board known to lie flush (m = 0 to its tolerance), or the same board
  mounted anew, makes a tilt zero of it; over many boards with random m the mean of phi is z.
- p and q: their part goes round with pan. At one pan, phi and the lean at that pan are one:
  then `upright_rad` is what is known, and phi no better than the rig's levelness.
- The gyro's own phase (its misalignment about x is m - z) does not contain the lean. Gyro
  and accelerometer share a die to the data sheet's tolerance (1 to 2 %, so 10 to 20 mrad):
  the two phases' sum is the pan axis' lean forward, even at one pan, to that tolerance.
- A pan axis that is not square to the tilt axis adds a constant: the bias has it.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray

LEVEL_STD_RAD = 0.035  # a rig on a table stands upright to about 2 deg
# Of A's x column, which only the lean makes seen: an accelerometer's scale (ADXL345: +-10 %)
# and its cross-axis sensitivity, in parts of one gravity.
ACROSS_STD = (0.1, 0.02, 0.02)
DIE_TOLERANCE_RAD = 0.02  # cross-axis 2 % (MPU-6050, MPU-6500 data sheets)
FEWEST_TILTS = 3  # bias, scale and phase of an axis
LEAST_ARC_RAD = 0.35  # of tilt: below 20 deg bias and phase are all but one
LEAST_STEP_RAD = 0.02  # tilts nearer than that are one
ROUNDS = 20
UNKNOWNS = 14  # bias, A_y, A_z, lean, what A_x is off


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """The phase of gravity over tilt, and the pan axis' lean."""

    offset_rad: float  # phi = tilt zero - mount about x, against the pan axis
    offset_std_rad: float  # honest at one pan too: the lean's share is in it
    upright_rad: float  # the same against the vertical, over the pans of the rests
    upright_std_rad: float
    lean_rad: FloatArray  # (2,), vertical in the base frame: to the right (x), forward (y)
    lean_std_rad: FloatArray  # (2,), `LEVEL_STD_RAD` where the pans tell nothing
    bias_m_s2: FloatArray  # (3,), of the accelerometer
    reduced_chi2: float  # 1 where the readings' deviations explain what is left
    rests: int

    @property
    def pans_tell(self) -> bool:
        """True where the rests' pans separate lean and offset."""
        return bool(np.all(self.lean_std_rad < 0.5 * LEVEL_STD_RAD))


def tilt_zero_from_accelerometer(
    pan_rad: FloatArray,
    tilt_rad: FloatArray,
    reading_m_s2: FloatArray,
    std_m_s2: float,
    nominal: FloatArray | None = None,
) -> Level:
    """Return what the readings at rest say of tilt zero and lean.

    Args:
        pan_rad: told, shape (m,).
        tilt_rad: told, shape (m,).
        reading_m_s2: mean of each rest, counts times nominal scale, board frame, (m, 3).
        std_m_s2: of each mean, one axis.
        nominal: how the board is meant to be mounted, stage to board, (3, 3), where that is
            not the identity.

    Raises:
        InputError: too few tilts, or too near each other.
    """
    ordered = np.sort(tilt_rad)
    tilts = 1 + int(np.sum(np.diff(ordered) > LEAST_STEP_RAD)) if ordered.size else 0
    if tilts < FEWEST_TILTS or ordered[-1] - ordered[0] < LEAST_ARC_RAD:
        raise InputError(
            f"{tilts} tilts over {np.degrees(np.ptp(ordered)) if tilts else 0.0:.0f} deg do not "
            "separate an accelerometer's bias from a tilt zero",
            f"rest at {FEWEST_TILTS} tilts or more over {np.degrees(LEAST_ARC_RAD):.0f} deg",
        )
    reading = reading_m_s2 if nominal is None else reading_m_s2 @ nominal
    estimate, covariance, chi2 = _fit(pan_rad, tilt_rad, reading, std_m_s2)
    ahead, up = estimate[4], estimate[7]  # A_y and A_z of the forward (y) axis
    slope = np.zeros(UNKNOWNS)
    slope[4], slope[7] = np.array([-up, ahead]) / (ahead**2 + up**2)
    upright = slope.copy()
    upright[9:11] = [-np.mean(np.sin(pan_rad)), np.mean(np.cos(pan_rad))]
    offset = float(np.arctan2(up, ahead))
    return Level(
        offset_rad=offset,
        offset_std_rad=float(np.sqrt(slope @ covariance @ slope)),
        upright_rad=offset + float(upright[9:11] @ estimate[9:11]),
        upright_std_rad=float(np.sqrt(upright @ covariance @ upright)),
        lean_rad=estimate[9:11],
        lean_std_rad=np.sqrt(np.diag(covariance)[9:11]),
        bias_m_s2=estimate[:3] if nominal is None else nominal @ estimate[:3],
        reduced_chi2=chi2,
        rests=int(tilt_rad.size),
    )


def lean_by_gyro(
    level: Level,
    misalignment_x_rad: float,
    misalignment_std_rad: float,
    die_tolerance_rad: float = DIE_TOLERANCE_RAD,
) -> tuple[float, float]:
    """Return the pan axis' lean forward at the rests' pans, by gyro and gravity, and its std.

    Args:
        level: what gravity says.
        misalignment_x_rad: the gyro's, stage to sensor, by the same told tilts: m - z.
        misalignment_std_rad: its standard deviation.
        die_tolerance_rad: how far the axes of gyro and accelerometer may differ.
    """
    spread = np.hypot(np.hypot(level.upright_std_rad, misalignment_std_rad), die_tolerance_rad)
    return level.upright_rad + misalignment_x_rad, float(spread)


def _fit(
    pan_rad: FloatArray, tilt_rad: FloatArray, reading: FloatArray, std: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return the unknowns, their covariance, and chi2 per degree of freedom.

    Gauss-Newton; A_x is square to the other two but for what `ACROSS_STD` allows.
    """
    sine, cosine = np.sin(tilt_rad), np.cos(tilt_rad)
    flat = np.column_stack([np.ones_like(sine), sine, cosine])
    start = np.linalg.lstsq(flat, reading, rcond=None)[0]
    estimate = np.concatenate([start.ravel(), np.zeros(UNKNOWNS - 9)])
    prior = np.zeros(UNKNOWNS)
    prior[9:11] = LEVEL_STD_RAD**-2.0
    prior[11:] = np.array(ACROSS_STD) ** -2.0
    for _ in range(ROUNDS):
        model, jacobian = _model(pan_rad, sine, cosine, estimate)
        left = (reading - model).ravel()
        information = jacobian.T @ jacobian / std**2 + np.diag(prior)
        scale = 1.0 / np.sqrt(np.diag(information))
        inverse = scale[:, None] * np.linalg.pinv(information * np.outer(scale, scale)) * scale
        step = inverse @ (jacobian.T @ left / std**2 - prior * estimate)
        estimate = estimate + step
        if np.max(np.abs(step) * np.sqrt(np.diag(information))) < 1e-6:
            break
    left = (reading - _model(pan_rad, sine, cosine, estimate)[0]).ravel()
    freedom = max(1, left.size - UNKNOWNS)
    return estimate, inverse, float(left @ left / std**2 / freedom)


def _model(
    pan_rad: FloatArray, sine: FloatArray, cosine: FloatArray, estimate: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return readings (m, 3) and their derivatives (3 m, 14)."""
    bias, ahead, up = estimate[:3], estimate[3:6], estimate[6:9]
    length = np.sqrt(float(np.linalg.norm(ahead) * np.linalg.norm(up)))
    across = np.cross(ahead, up) / length + length * estimate[11:]
    c, s = np.cos(pan_rad), np.sin(pan_rad)
    # The lean's two components, turned into the carrier of the tilt axis.
    right = np.column_stack([c, s])
    forward = np.column_stack([-s, c])
    lean_right, lean_forward = right @ estimate[9:11], forward @ estimate[9:11]
    y, z = sine + cosine * lean_forward, cosine - sine * lean_forward
    model = bias + np.outer(lean_right, across) + np.outer(y, ahead) + np.outer(z, up)
    jacobian = np.zeros((pan_rad.size, 3, UNKNOWNS))
    for axis in range(3):
        jacobian[:, axis, axis] = 1.0
        jacobian[:, axis, 3 + axis] = y
        jacobian[:, axis, 6 + axis] = z
        ways = cosine * ahead[axis] - sine * up[axis]
        jacobian[:, axis, 9:11] = right * across[axis] + forward * ways[:, None]
        jacobian[:, axis, 11 + axis] = lean_right * length
    return model, jacobian.reshape(-1, UNKNOWNS)
