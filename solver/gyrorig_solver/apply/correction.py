"""What of a calibration can be applied to a reading, and what cannot.

What to use when: `correction_of` for a document; `Correction.rates` for readings. The model
is the document's, with u = G omega, t the temperature above its reference, f the force:

    y = u (1 + s t + q u + c u^2) + a |u| + b + k1 t + k2 t^2 + k3 t^3 + K f

solved for u, and then omega = G^-1 u in the stage's axes, or (S T)^-1 u in the sensor's own
axes made orthogonal.

What belongs to the unit that turned the board, or to one recording's moment, says nothing of
a later reading: it is left out, and named.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.apply.affine import Output, Readings, transformed
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.calibration.document import Calibration, Parameter

Frame = Literal["stage", "sensor"]
FRAMES: tuple[Frame, ...] = ("stage", "sensor")

# Causes of the catalogue that act on every later reading too.
BENDING = ("scale_quadratic", "scale_cubic", "scale_asymmetry")
ORDERS = ("slope", "square", "cube")
LAG = "thermal_bias.lag: the die is taken to be as warm as its thermometer says"
REFERENCE = "reference"  # thermal_bias.reference: what temperatures count from
_NEWTON_STEPS = 4  # bends are below a tenth: three steps reach the last digit
_BLOCK = 65536  # readings at a time where the arithmetic needs several copies
_LARGEST_CONDITION = 1e6  # beyond it a gain undoes nothing


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Everything that turns a reading into a rate, in SI units.

    `not_applied` names what the document knows and no later reading can use, with the
    reason.
    """

    frame: Frame
    inverse: FloatArray  # (3, 3): from the sensor's axes, bias off, to rates in the frame
    bias_rad_s: FloatArray  # (3,)
    thermal_bias: FloatArray  # (orders, 3), rad/s/K^p; no rows without
    thermal_scale: FloatArray  # (3,), 1/K
    reference_degc: float  # what temperatures count from; nan where nothing does
    quadratic: FloatArray  # (3,)
    cubic: FloatArray  # (3,)
    asymmetry: FloatArray  # (3,)
    force: FloatArray  # (3, 3), rad/s/(m/s^2), against the sensor's axes
    lag_s: float = 0.0  # of the die's temperature, see model/terms/temperature
    not_applied: tuple[str, ...] = ()

    @property
    def needs_temperature(self) -> bool:
        """Whether rates depend on the temperature."""
        return bool(self.thermal_bias.any() or self.thermal_scale.any())

    @property
    def needs_force(self) -> bool:
        """Whether rates depend on the specific force."""
        return bool(self.force.any())

    @property
    def bends(self) -> bool:
        """Whether the reading is no straight line of the rate."""
        some = (self.quadratic, self.cubic, self.asymmetry, self.thermal_scale)
        return any(bool(values.any()) for values in some)

    @property
    def straight(self) -> bool:
        """Whether a matrix and an offset are all of it."""
        return not (self.bends or self.needs_temperature or self.needs_force)

    def offset(self) -> FloatArray:
        """Return what is added behind the matrix, shape (3,)."""
        return np.asarray(-self.inverse @ self.bias_rad_s, dtype=np.float64)

    def rates(
        self,
        readings: Readings,
        scale_rad_s: float = 1.0,
        temperature_degc: FloatArray | float | None = None,
        specific_force_m_s2: FloatArray | None = None,
        out: Output | None = None,
    ) -> Output:
        """Return the true rates of readings, shape (n, 3), rad/s.

        Args:
            readings: shape (n, 3); counts, or rad/s at the nominal scale.
            scale_rad_s: what one unit of a reading is worth nominally; 1 for rad/s.
            temperature_degc: of every reading, shape (n,), or of all of them.
            specific_force_m_s2: as the board's accelerometer reads it, shape (n, 3).
            out: as in `affine.transformed`.

        Raises:
            UsageError: the calibration asks for a temperature or a force, and none is given.
        """
        if self.needs_temperature and temperature_degc is None:
            raise UsageError(
                "this calibration depends on the temperature",
                "give the board's temperature too, or solve without thermal_bias and thermal_scale",
            )
        if self.needs_force and specific_force_m_s2 is None:
            raise UsageError(
                "this calibration depends on the specific force",
                "give the accelerometer's readings too, or solve without g_sensitivity",
            )
        if self.straight:
            return transformed(readings, scale_rad_s * self.inverse, self.offset(), out)
        count = readings.shape[0]
        rates = np.empty((count, 3)) if out is None else out
        for start in range(0, count, _BLOCK):
            rows = slice(start, min(start + _BLOCK, count))
            warmth = self._warmth(temperature_degc, rows)
            reading = readings[rows] * scale_rad_s - self.bias_rad_s
            for power, coefficient in enumerate(self.thermal_bias, start=1):
                reading -= warmth**power * coefficient
            if specific_force_m_s2 is not None:
                reading -= specific_force_m_s2[rows] @ self.force.T
            rates[rows] = self._unbent(reading, warmth) @ self.inverse.T
        return rates

    def _warmth(self, temperature_degc: FloatArray | float | None, rows: slice) -> FloatArray:
        """Return the temperatures above the reference, shape (n, 1) or (1, 1)."""
        if temperature_degc is None or not self.needs_temperature:
            return np.zeros((1, 1))
        given = np.asarray(temperature_degc, dtype=np.float64)
        return np.atleast_1d(given if given.ndim == 0 else given[rows])[:, None] - (
            self.reference_degc
        )

    def _unbent(self, reading: FloatArray, warmth: FloatArray) -> FloatArray:
        """Solve reading = u (1 + s dT + q u + c u^2) + a |u| for u, by Newton's method."""
        if not self.bends:
            return reading
        first = 1.0 + self.thermal_scale * warmth
        u = reading / first
        for _ in range(_NEWTON_STEPS):
            told = u * (first + self.quadratic * u + self.cubic * u * u)
            told += self.asymmetry * np.abs(u)
            slope = first + 2.0 * self.quadratic * u + 3.0 * self.cubic * u * u
            u = u - (told - reading) / (slope + self.asymmetry * np.sign(u))
        return u


def correction_of(calibration: Calibration, frame: Frame = "stage") -> Correction:
    """Return what a calibration does to readings.

    Args:
        calibration: the document.
        frame: axes of the rates: the stage's, or the sensor's own made orthogonal.

    Raises:
        InputError: the calibration is refused, or leaves open what is needed.
    """
    name = f"{calibration.board.id} version {calibration.version}"
    if calibration.trust.verdict == "refused":
        why = calibration.trust.reasons[0] if calibration.trust.reasons else "its report says why"
        raise InputError(f"the calibration of {name} is refused and not to be applied", why)
    bias = _known(calibration, "bias", name)
    inverse = _inverse(calibration, frame, name)
    left: list[str] = []
    thermal = _thermal(calibration, left)
    lag_s = float(_optional(calibration, "thermal_bias.lag")[0]) if thermal[0].size else 0.0
    left += [LAG] if lag_s else []
    force, partly = _force(calibration)
    left += partly
    for parameter in calibration.parameters:
        cause = parameter.partition(".")[0].partition("@")[0]
        if cause not in (*_BASE, *BENDING, "thermal_bias", "thermal_scale", "g_sensitivity"):
            left.append(f"{parameter}: of the rig or of one recording, not of every reading")
    return Correction(
        frame=frame,
        inverse=inverse,
        bias_rad_s=bias,
        thermal_bias=thermal[0],
        thermal_scale=thermal[1],
        reference_degc=thermal[2],
        quadratic=_optional(calibration, "scale_quadratic"),
        cubic=_optional(calibration, "scale_cubic"),
        asymmetry=_optional(calibration, "scale_asymmetry"),
        force=force,
        lag_s=lag_s,
        not_applied=tuple(dict.fromkeys(left)),
    )


_BASE = ("bias", "scale", "nonorthogonality", "misalignment", "time_offset")


def _inverse(calibration: Calibration, frame: Frame, name: str) -> FloatArray:
    """Return the inverse of G, or of S T for the sensor's axes."""
    matrices = calibration.matrices
    rows = [matrices.STM] if frame == "stage" else [matrices.S, matrices.T]
    if any(value is None for matrix in rows for row in matrix for value in row):
        hidden = open_parameters(calibration)
        raise InputError(
            f"the calibration of {name} leaves open {hidden}",
            "record a motion that shows it, or take off the bias alone (--bias-only)",
        )
    gain = np.linalg.multi_dot([*(np.array(m, dtype=np.float64) for m in rows), np.eye(3)])
    if np.linalg.cond(gain) > _LARGEST_CONDITION:
        raise InputError(
            f"the gain of {name} cannot be undone, for its axes cannot be told apart",
            "record a motion about all three axes and solve again",
        )
    return np.asarray(np.linalg.inv(gain), dtype=np.float64)


def open_parameters(calibration: Calibration) -> str:
    """Return what the motion did not show, whole parameters by their name, as words."""
    groups = (name.partition(".")[0] for name in calibration.observability.unobservable)
    return ", ".join(dict.fromkeys(groups)) or "the gain"


def correction_of_bias(calibration: Calibration) -> Correction:
    """Return a correction that takes the bias off and believes the nominal scale.

    Raises:
        InputError: the calibration is refused, or leaves the bias open.
    """
    name = f"{calibration.board.id} version {calibration.version}"
    if calibration.trust.verdict == "refused" and calibration.observability.rank == 0:
        raise InputError(
            f"the calibration of {name} shows nothing, so there is nothing to apply",
            "its report says why; record a motion about all three axes and solve again",
        )
    nothing = np.zeros(3)
    return Correction(
        frame="sensor",
        inverse=np.eye(3),
        bias_rad_s=_known(calibration, "bias", name),
        thermal_bias=np.zeros((0, 3)),
        thermal_scale=nothing,
        reference_degc=float("nan"),
        quadratic=nothing,
        cubic=nothing,
        asymmetry=nothing,
        force=np.zeros((3, 3)),
        not_applied=("the gain: --bias-only leaves the nominal scale as it is",),
    )


def _thermal(calibration: Calibration, left: list[str]) -> tuple[FloatArray, FloatArray, float]:
    """Return the bias' polynomial, the scale's slope and what temperatures count from."""
    orders: list[FloatArray] = []
    for order in ORDERS:
        found = calibration.parameters.get(f"thermal_bias.{order}")
        if order == ORDERS[0] and found is None:  # a cause with one size has its name alone
            found = calibration.parameters.get("thermal_bias")
        if found is None:
            break
        orders.append(_filled(found))
    scale = _optional(calibration, "thermal_scale")
    reference = next(
        (
            found.value
            for cause in ("thermal_bias", "thermal_scale")
            if (found := calibration.parameters.get(f"{cause}.{REFERENCE}")) is not None
        ),
        None,
    )
    polynomial = np.array(orders).reshape(-1, 3)
    start = reference[0] if isinstance(reference, list) and reference else reference
    if start is None or isinstance(start, list):
        if orders or scale.any():
            left.append(
                "thermal causes: the document does not say what its temperatures count from; "
                "solve again with this version"
            )
        return np.zeros((0, 3)), np.zeros(3), float("nan")
    return polynomial, scale, start


def _force(calibration: Calibration) -> tuple[FloatArray, list[str]]:
    """Return K against the sensor's axes, K M^T, and what of it is not known."""
    found = calibration.parameters.get("g_sensitivity")
    turn = np.array(calibration.matrices.M, dtype=np.float64)
    if found is None or not np.all(np.isfinite(turn)):
        return np.zeros((3, 3)), []
    stage = _filled(found).reshape(3, 3)
    hidden = isinstance(found.value, list) and None in found.value
    words = "g_sensitivity along the stage's x: a pan-tilt unit cannot show it, taken as 0"
    return stage @ turn.T, [words] if hidden else []


def _known(calibration: Calibration, parameter: str, name: str) -> FloatArray:
    """Return a base parameter's three values.

    Raises:
        InputError: one of them is null.
    """
    value = calibration.parameters[parameter].value
    values = value if isinstance(value, list) else [value]
    if any(v is None for v in values):
        raise InputError(
            f"the calibration of {name} leaves open its {parameter}",
            "its report says what motion shows it: record that, and solve again",
        )
    return np.array(values, dtype=np.float64)


def _optional(calibration: Calibration, cause: str) -> FloatArray:
    """Return a cause's three values, zeros where it was not fitted."""
    found = calibration.parameters.get(cause)
    return np.zeros(3) if found is None else _filled(found)


def _filled(parameter: Parameter) -> FloatArray:
    """Return a parameter's values, zero where one is null."""
    value = parameter.value if isinstance(parameter.value, list) else [parameter.value]
    return np.array([0.0 if v is None else v for v in value], dtype=np.float64)
