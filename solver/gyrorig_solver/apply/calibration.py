"""A calibration as a program uses it: arrays in, arrays out.

    from gyrorig_solver import Calibration

    calibration = Calibration.load("calibrations/GY80-1/v0001.yaml")
    rates = calibration.rates(counts)          # (n, 3) counts to (n, 3) rad/s
    times = calibration.times(stamps)          # when the motion was so

Needs numpy and nothing of the extra `solver`.
"""

import hashlib
from pathlib import Path
from typing import Literal, Self

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.apply.affine import Output, Readings
from gyrorig_solver.apply.correction import Correction, Frame, correction_of, correction_of_bias
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.calibration import document

Unit = Literal["counts", "rad/s", "deg/s"]
UNITS: tuple[Unit, ...] = ("counts", "rad/s", "deg/s")


class Calibration:
    """One board's calibration, ready to be applied.

    Rates come in rad/s, about the stage's axes (x tilt, y roll, z pan) or the sensor's own
    made orthogonal; see docs/conventions.md.

    Args:
        found: the document.
        frame: axes of the rates, `stage` or `sensor`.
        bias_only: take off the bias alone and believe the nominal scale.
        digest: `sha256:` and the digest of the file it came from.

    Raises:
        InputError: the calibration is refused, or leaves open what is needed.
    """

    def __init__(
        self,
        found: document.Calibration,
        frame: Frame = "stage",
        *,
        bias_only: bool = False,
        digest: str = "",
    ) -> None:
        self.document = found
        self.digest = digest
        self.correction: Correction = (
            correction_of_bias(found) if bias_only else correction_of(found, frame)
        )

    @classmethod
    def load(cls, path: str | Path, frame: Frame = "stage", *, bias_only: bool = False) -> Self:
        """Return the calibration in a file.

        Raises:
            InputError: there is no such file, it is no calibration, is refused, or leaves
                open what is needed.
        """
        text, digest = read_document(Path(path))
        return cls(
            document.parse_calibration(text, str(path)), frame, bias_only=bias_only, digest=digest
        )

    @property
    def board(self) -> str:
        """Whose calibration it is."""
        return self.document.board.id

    @property
    def frame(self) -> Frame:
        """Axes of the rates."""
        return self.correction.frame

    @property
    def nominal_scale_rad_s(self) -> float | None:
        """What a count is worth by the data sheet; None where the recording did not say."""
        return self.document.board.config.gyro_scale_rad_s

    @property
    def time_offset_s(self) -> float | None:
        """By how much samples come behind the motion; None where no motion showed it."""
        value = self.document.parameters["time_offset"].value
        return value if isinstance(value, float) else None

    @property
    def not_applied(self) -> tuple[str, ...]:
        """What the document knows and a later reading cannot use."""
        return self.correction.not_applied

    def rates(
        self,
        readings: npt.ArrayLike,
        unit: Unit = "counts",
        *,
        temperature_degc: npt.ArrayLike | None = None,
        specific_force_m_s2: npt.ArrayLike | None = None,
        out: Output | None = None,
    ) -> Output:
        """Return the true rates of readings, in rad/s, shape (n, 3).

        Args:
            readings: shape (n, 3), or (3,) for one; in the sensor's axes, as they come.
            unit: of the readings: counts, or rad/s or deg/s at the nominal scale.
            temperature_degc: of all readings or of each; where thermal causes were fitted.
            specific_force_m_s2: the accelerometer's reading in the sensor's axes, shape
                (n, 3); where g_sensitivity was fitted.
            out: where to write, shape (n, 3), float32 (twice as fast) or float64.

        Raises:
            UsageError: readings of another shape; counts and no nominal scale; a
                temperature or force is missing.
        """
        given: Readings = np.asarray(readings)
        if given.shape[-1:] != (3,) or given.ndim > 2 or given.dtype.kind not in "iuf":
            raise UsageError(
                f"readings are {given.dtype} of shape {given.shape}", "give numbers of shape (n, 3)"
            )
        rows = given.reshape(-1, 3)
        warmth = None if temperature_degc is None else np.asarray(temperature_degc, np.float64)
        force = None
        if specific_force_m_s2 is not None:
            force = np.asarray(specific_force_m_s2, np.float64).reshape(-1, 3)
        if warmth is not None and warmth.ndim and warmth.shape != rows.shape[:1]:
            raise UsageError(
                f"{warmth.size} temperatures for {len(rows)} readings", "give one, or one each"
            )
        found = self.correction.rates(rows, self.scale_of(unit), warmth, force, out)
        return found.reshape(given.shape)

    def scale_of(self, unit: Unit) -> float:
        """Return what one unit of a reading is worth nominally, in rad/s.

        Raises:
            UsageError: counts, and the document does not say the nominal scale.
        """
        if unit == "rad/s":
            return 1.0
        if unit == "deg/s":
            return float(np.pi / 180.0)
        if unit != "counts":
            raise UsageError(f"no unit {unit!r}", f"there are {', '.join(UNITS)}")
        if self.nominal_scale_rad_s is None:
            raise UsageError(
                "the calibration does not say what a count is worth",
                "give the readings in rad/s at the nominal scale",
            )
        return self.nominal_scale_rad_s

    def times(self, stamps_s: npt.ArrayLike) -> FloatArray:
        """Return when the motion was as a sample says, from the samples' times, in s.

        Unchanged where no motion showed the time offset.
        """
        return np.asarray(stamps_s, dtype=np.float64) - (self.time_offset_s or 0.0)


def read_document(path: Path) -> tuple[bytes, str]:
    """Return a file's text, and `sha256:` with its digest.

    Raises:
        InputError: it cannot be read.
    """
    try:
        text = path.read_bytes()
    except OSError as fault:
        raise InputError(
            f"cannot read {path}, {fault.strerror}", "name a calibration, such as GY80-1/v0001.yaml"
        ) from fault
    return text, "sha256:" + hashlib.sha256(text).hexdigest()
