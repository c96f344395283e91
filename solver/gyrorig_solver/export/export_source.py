"""The calibration as the input of an export, and the header lines of every export."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.apply import LAG_NOTE, Calibration, Correction, Frame
from gyrorig_solver.apply.calibration_correction import (
    BIAS_ONLY_NOTE,
    build_bias_correction,
    unobservable_text,
)
from gyrorig_solver.apply.calibration_file import (
    APPLIED_PARAMETERS,
    BASE_PARAMETERS,
    check_parameters,
)
from gyrorig_solver.calibration import calibration_document, cause_of_parameter
from gyrorig_solver.calibration.document_checks import check_document
from gyrorig_solver.data import FloatArray, TemperatureCurve

UNIT_AXES = (
    "the stage's axes during the calibration: x is the tilt axis, y points forward (roll), z is "
    "the pan axis"
)
REFERENCE_AXES = "the stage's axes during the calibration, which are those of its reference"
SENSOR_AXES = "the orthogonalised axes of the sensor: x is its x axis, y is in its x-y plane"

_BROKEN_PAIRS = re.compile(r"(\*(?=/)|/(?=\*)|\?(?=\?))")


@dataclass(frozen=True, slots=True, eq=False)
class ExportSource:
    """A calibration to be exported."""

    document: calibration_document.CalibrationDocument
    digest: str
    frame: Frame
    calibration: Calibration | None  # None if the gain is not fully known

    @classmethod
    def of(
        cls,
        source: calibration_document.CalibrationDocument,
        frame: Frame = "stage",
        digest: str = "",
    ) -> Self:
        """Return the source; `calibration` is None if the gain is not fully known.

        Raises:
            InputError: the verdict of the calibration is refused, or a name or value in it is not
                valid for a calibration.
        """
        name = f"of {source.board.id}"
        check_document(source, name)
        check_parameters(source, name)
        if source.trust.verdict == "refused":
            reasons = source.trust.reasons or ["read the report of the calibration for the reason"]
            raise InputError(
                f"the calibration of {source.board.id} is not exported, because the "
                "solver gave it the verdict `refused`",
                reasons[0],
            )
        try:
            calibration = Calibration(source, frame, digest=digest)
        except InputError:
            calibration = None
        return cls(source, digest, frame, calibration)

    @property
    def axes_text(self) -> str:
        """The axes of the corrected rates, in words."""
        if self.frame == "sensor":
            return SENSOR_AXES
        is_on_unit = (
            self.document.quality.rest_to_rest is not None
            or self.document.unit_prior is not None
            or self.document.solver.method == "paper"
        )
        return UNIT_AXES if is_on_unit else REFERENCE_AXES

    @property
    def correction(self) -> Correction:
        """The correction, for formats that need the gain.

        Raises:
            InputError: the gain is not fully known.
        """
        if self.calibration is None:
            raise InputError(
                f"the calibration of {self.document.board.id} has no value for "
                f"{unobservable_text(self.document)}",
                "record a motion that determines the parameter, or use the format px4, "
                "ardupilot or kalibr",
            )
        return self.calibration.correction

    @property
    def bias_curve(self) -> TemperatureCurve | None:
        """The bias over temperature, None if the document has none or an unknown zero."""
        if self.document.validity.temperature_degc is None and self.document.temperature is None:
            return None
        if self.calibration is not None:
            return self.calibration.correction.bias_curve
        return build_bias_correction(self.document).bias_curve

    @property
    def not_applied(self) -> tuple[str, ...]:
        """The parameters of the document that no export applies, with reasons.

        Raises:
            InputError: the bias is not known.
        """
        if self.calibration is not None:
            return self.calibration.not_applied
        notes = build_bias_correction(self.document).not_applied
        return tuple(note for note in notes if note != BIAS_ONLY_NOTE)

    @property
    def bias_rad_s(self) -> FloatArray:
        """The bias, shape (3,).

        Raises:
            InputError: the bias is not known.
        """
        value = self.document.parameters["bias"].value
        values = value if isinstance(value, list) else [value]
        if any(v is None for v in values):
            raise InputError(
                f"the calibration of {self.document.board.id} has no value for the bias",
                "record the board at rest, and solve again",
            )
        return np.array(values, dtype=np.float64)

    @property
    def time_offset_s(self) -> float | None:
        """Delay of the samples behind the motion; None if it was not observable."""
        value = self.document.parameters["time_offset"].value
        return value if isinstance(value, float) else None

    def noise(self, name: str) -> list[float | None]:
        """Return a noise coefficient per axis; empty if it was not estimated."""
        figure = self.document.noise.get(name)
        return [] if figure is None else list(figure.value)

    def worst_noise(self, name: str) -> float | None:
        """Return a noise coefficient of the noisiest axis; None if none is known."""
        known = [v for v in self.noise(name) if v is not None and v > 0.0]
        return max(known) if known else None

    def header_lines(self) -> list[str]:
        """Return the first lines of every export: board, version, verdict and validity."""
        calibration, rate_range = self.document, self.document.validity.rate_rad_s
        lines = [
            f"gyroscope of board {calibration.board.id} ({calibration.board.sensor}), calibration "
            f"version {calibration.version} of {calibration.created}",
            f"made by gyrorig {calibration.solver.version}; verdict: {calibration.trust.verdict}",
            *([f"from the document {self.digest}"] if self.digest else []),
            f"valid for rates from {rate_range[0]:.4g} to {rate_range[1]:.4g} rad/s"
            + self._temperature_range_text(),
        ]
        settings = self._settings_text()
        lines += [f"valid for these settings of the board: {settings}"] if settings else []
        lines += [f"note: {reason}" for reason in calibration.trust.reasons]
        return lines

    def omission_lines(self, carried: Sequence[str] = ()) -> list[str]:
        """Return lines that list what a format leaves out, and what no export applies.

        The format contains the causes in `carried`.

        Raises:
            InputError: the bias is not known, or without the omitted cause the exported numbers
                would be wrong.
        """
        contained = {*BASE_PARAMETERS, *carried}
        causes = dict.fromkeys(cause_of_parameter(name) for name in self.document.parameters)
        if "g_sensitivity" in causes and "g_sensitivity" not in carried:
            raise InputError(
                "the bias in the calibration depends on the acceleration, but the export format "
                "can only contain a constant bias",
                "solve the board again with `--extend none` for this export, or correct the "
                "measurements with `gyrorig apply`",
            )
        omitted = [c for c in causes if c not in contained and c in APPLIED_PARAMETERS]
        record = self.document.temperature
        if record is not None and record.bias is not None and "thermal_bias" not in carried:
            omitted.append(
                "the bias against the temperature (the bias here is that at "
                f"{record.reference_degc:.2f} degC)"
            )
        if record is not None and record.scale is not None and "temperature.scale" not in carried:
            omitted.append("the scale factor against the temperature")
        # The lag is that of the temperature, which a format with a constant bias does not use.
        notes = [n for n in self.not_applied if n != LAG_NOTE or "thermal_bias" in carried]
        return [
            *([f"not contained in this format: {', '.join(omitted)}"] if omitted else []),
            *(f"note: {note}" for note in notes),
        ]

    def _temperature_range_text(self) -> str:
        span = self.document.validity.temperature_degc
        return "" if span is None else f", {span[0]:.1f} to {span[1]:.1f} degC"

    def _settings_text(self) -> str:
        config = self.document.board.config
        parts = (
            (config.odr_hz, "output rate {:g} Hz"),
            (config.bandwidth_hz, "low-pass {:g} Hz"),
            (config.gyro_full_scale_dps, "full scale {:g} deg/s"),
        )
        return ", ".join(words.format(value) for value, words in parts if value is not None)


def comment_lines(mark: str, lines: Iterable[str]) -> list[str]:
    """Return comment lines, each with its mark; no text of a calibration can end the comment.

    Every export writes its comments with this function.
    """
    return [f"{mark}{_indentation(line)}{printable_line(line)}".rstrip() for line in lines]


def _indentation(line: str) -> str:
    return " " * (len(line) - len(line.lstrip(" ")))


def printable_line(text: str) -> str:
    """Return a text that cannot end a comment or a line, in any language of an export.

    The result has neither a backslash nor `*/`, `/*` or a trigraph of C. Texts come from devices.
    """
    plain = "".join(c if c.isprintable() and c.isascii() else "?" for c in " ".join(text.split()))
    # Replace the backslash first: its replacement can complete the end of a comment.
    return _BROKEN_PAIRS.sub(r"\1 ", plain.replace("\\", "/"))


def quoted(text: str) -> str:
    """Return a quoted text with the same meaning in C, YAML and JSON."""
    return '"' + printable_line(text).replace('"', "'") + '"'
