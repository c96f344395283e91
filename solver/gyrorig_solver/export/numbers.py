"""What every export needs of a calibration, and the words that stand at its head.

What to use when: `Source.of` once; the modules of the formats take it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.apply.calibration import Calibration
from gyrorig_solver.apply.correction import Correction, Frame, open_parameters
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.calibration import document

AXES = {
    "stage": "the stage's axes: x the tilt axis, y forward (roll), z the pan axis, when it was "
    "calibrated",
    "sensor": "the sensor's own axes made orthogonal: x is its x, y lies in its x-y plane",
}


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A calibration on its way into another format."""

    found: document.Calibration
    digest: str
    frame: Frame
    gain: Calibration | None  # None where the motion did not show all of it

    @classmethod
    def of(cls, found: document.Calibration, frame: Frame = "stage", digest: str = "") -> Self:
        """Return what formats take; `gain` is None where only the bias is known.

        Raises:
            InputError: the calibration is refused.
        """
        if found.trust.verdict == "refused":
            why = found.trust.reasons[0] if found.trust.reasons else "its report says why"
            raise InputError(f"the calibration of {found.board.id} is refused: no export", why)
        try:
            gain = Calibration(found, frame, digest=digest)
        except InputError:
            gain = None
        return cls(found, digest, frame, gain)

    @property
    def whole(self) -> Correction:
        """The correction, for formats that are nothing without a gain.

        Raises:
            InputError: the motion did not show the gain.
        """
        if self.gain is None:
            raise InputError(
                f"the calibration of {self.found.board.id} leaves open "
                f"{open_parameters(self.found)}",
                "record a motion that shows it; px4, ardupilot and kalibr take what is known",
            )
        return self.gain.correction

    @property
    def bias_rad_s(self) -> FloatArray:
        """The bias, shape (3,).

        Raises:
            InputError: it is not known.
        """
        value = self.found.parameters["bias"].value
        values = value if isinstance(value, list) else [value]
        if any(v is None for v in values):
            raise InputError(
                f"the calibration of {self.found.board.id} leaves its bias open",
                "record the board at rest",
            )
        return np.array(values, dtype=np.float64)

    @property
    def time_offset_s(self) -> float | None:
        """By how much samples come behind the motion, None where nothing showed it."""
        value = self.found.parameters["time_offset"].value
        return value if isinstance(value, float) else None

    def noise(self, name: str) -> list[float | None]:
        """Return a noise coefficient of each axis, empty where it was not estimated."""
        figure = self.found.noise.get(name)
        return [] if figure is None else list(figure.value)

    def worst_noise(self, name: str) -> float | None:
        """Return a noise coefficient of the noisiest axis; None where none is known."""
        known = [v for v in self.noise(name) if v is not None and v > 0.0]
        return max(known) if known else None

    def head(self) -> list[str]:
        """Return the lines that every export begins with: whose, which, how good."""
        found, low_high = self.found, self.found.validity.rate_rad_s
        lines = [
            f"gyroscope of board {found.board.id} ({found.board.sensor}), calibration version "
            f"{found.version} of {found.created}",
            f"made by gyrorig {found.solver.version}; verdict: {found.trust.verdict}",
            *([f"from the document {self.digest}"] if self.digest else []),
            f"covers rates from {low_high[0]:.4g} to {low_high[1]:.4g} rad/s" + self._warmth(),
        ]
        settings = self._settings()
        lines += [f"holds for the board's settings: {settings}"] if settings else []
        lines += [f"mind: {reason}" for reason in found.trust.reasons]
        return [printable_line(line) for line in lines]

    def left_out(self, carried: Sequence[str] = ()) -> list[str]:
        """Return lines on what the document has and a format does not.

        Args:
            carried: causes that it does have a place for.

        Raises:
            InputError: what is left out would spoil what is not.
        """
        base = {"bias", "scale", "nonorthogonality", "misalignment", "time_offset", *carried}
        causes = dict.fromkeys(
            name.partition(".")[0].partition("@")[0] for name in self.found.parameters
        )
        if "g_sensitivity" in causes and "g_sensitivity" not in carried:
            raise InputError(
                "this format has no place for g_sensitivity, and without it the bias is wrong",
                "solve without it for this export; gyrorig apply takes it",
            )
        left = [cause for cause in causes if cause not in base]
        return [f"not carried by this format: {', '.join(left)}"] if left else []

    def _warmth(self) -> str:
        span = self.found.validity.temperature_degc
        return "" if span is None else f", {span[0]:.1f} to {span[1]:.1f} degC"

    def _settings(self) -> str:
        config = self.found.board.config
        parts = (
            (config.odr_hz, "output rate {:g} Hz"),
            (config.bandwidth_hz, "low-pass {:g} Hz"),
            (config.gyro_full_scale_dps, "full scale {:g} deg/s"),
        )
        return ", ".join(words.format(value) for value, words in parts if value is not None)


def printable_line(text: str) -> str:
    """Return a text that ends no comment and no line: names come from devices."""
    plain = "".join(c if c.isprintable() and c.isascii() else "?" for c in " ".join(text.split()))
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")


def quoted(text: str) -> str:
    """Return a text as a quoted word that C, YAML and JSON read alike."""
    return '"' + printable_line(text).replace('"', "'") + '"'
