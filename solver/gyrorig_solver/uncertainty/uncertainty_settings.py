"""Settings of the total uncertainty: prior sizes of the causes, and limits of the verdict.

The shipped table, `default_settings.yaml`, names a source for every value. A user's document
replaces single entries of it.

What to use when: `default_settings`; `parse_settings` for a user's document.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import UsageError
from gyrorig_solver.model import PARAMETER_GROUPS, Term, display_unit, find_term

SCHEMA = "gyrorig/uncertainty/1"
NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Probability = Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]


class _DocumentPart(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the document's parts: unknown keys are errors."""


class PriorSizeEntry(_DocumentPart, frozen=True):
    """The prior size of one cause as written; a size of zero leaves the cause out."""

    size: NonNegative
    unit: str
    source: str
    probability: Probability = 1.0


class LimitEntry(_DocumentPart, frozen=True):
    """The largest total standard uncertainty of a kind of parameter that is `good`."""

    std: Positive
    unit: str
    reason: str


class DriftEntry(_DocumentPart, frozen=True):
    """Change of each size of a persistent cause within a day, one standard deviation.

    The change over n days is this value times the square root of n.
    """

    std: NonNegative
    unit: str
    reason: str


class SettingsDocument(_DocumentPart, frozen=True):
    """The document `gyrorig/uncertainty/1`."""

    schema: Literal["gyrorig/uncertainty/1"]
    unit: dict[str, PriorSizeEntry] = {}
    board: dict[str, PriorSizeEntry] = {}
    limits: dict[str, LimitEntry] = {}
    drift_per_day: dict[str, DriftEntry] = {}


@dataclass(frozen=True, slots=True)
class PriorSize:
    """The prior of one cause: each of its sizes has mean zero and this standard deviation."""

    size: float  # SI, standard deviation if the cause is present
    probability: float  # that it is present

    @property
    def std(self) -> float:
        """Root of the second moment of a size that is zero if the cause is absent, SI."""
        return float(self.size * self.probability**0.5)


@dataclass(frozen=True, slots=True)
class UncertaintySettings:
    """Prior sizes by cause, and the limits by kind of parameter; SI."""

    prior_sizes: Mapping[str, PriorSize]
    limits: Mapping[str, float]
    drifts: Mapping[str, float] = field(default_factory=dict)  # of persistent causes, per day

    @property
    def sha256(self) -> str:
        """Digest of the prior sizes and the limits, and of the drifts if they are not the shipped.

        Calibrations with the shipped drifts keep the digest that they had before it contained them.
        """
        values = {
            "prior_sizes": {c: [p.size, p.probability] for c, p in self.prior_sizes.items()},
            "limits": dict(self.limits),
        }
        if self.drifts != default_settings().drifts:
            values["drifts"] = dict(self.drifts)
        return hashlib.sha256(msgspec.json.encode(values, order="deterministic")).hexdigest()


@cache
def default_settings() -> UncertaintySettings:
    """Return the shipped settings."""
    name = "default_settings.yaml"
    text = files("gyrorig_solver.uncertainty").joinpath(name).read_text(encoding="utf-8")
    empty = UncertaintySettings(MappingProxyType({}), MappingProxyType({}))
    return _with_document(empty, text, name)


def parse_settings(text: str | bytes, name: str) -> UncertaintySettings:
    """Return the shipped settings; entries of a user's document replace theirs.

    Args:
        text: the YAML document.
        name: the document's name in an error, usually its file name.

    Raises:
        UsageError: it is not such a document, or names an unknown cause, parameter or unit.
    """
    return _with_document(default_settings(), text, name)


def read_settings(path: Path) -> UncertaintySettings:
    """Return the settings of a user's file; see `parse_settings`.

    Raises:
        UsageError: the file cannot be read, or it is not such a document.
    """
    try:
        return parse_settings(path.read_bytes(), str(path))
    except OSError as fault:
        reason = fault.strerror or "it is not readable"
        raise UsageError(
            f"the uncertainty settings {path} cannot be read ({reason})",
            "give a file with schema " + SCHEMA,
        ) from fault


def _with_document(
    before: UncertaintySettings, text: str | bytes, name: str
) -> UncertaintySettings:
    document = convert_document(parse_yaml(text, name, schema=SCHEMA), SettingsDocument, name)
    sizes, limits = dict(before.prior_sizes), dict(before.limits)
    for profile, entries in (("unit", document.unit), ("board", document.board)):
        for cause, entry in entries.items():
            term = find_term(cause)
            if (term.scope == "unit" or term.part == "ptu") != (profile == "unit"):
                other = "board" if profile == "unit" else "unit"
                raise UsageError(
                    f"the file {name} lists the cause {cause} under `{profile}`, but it is a cause "
                    f"of the {other}",
                    f"move the cause {cause} to the section `{other}`",
                )
            factor = _factor(name, f"{profile}: {cause}", entry.unit, _size_unit(term))
            sizes[cause] = PriorSize(entry.size * factor, entry.probability)
    units = {group.name: group for group in PARAMETER_GROUPS}
    for parameter, limit in document.limits.items():
        if parameter not in units:
            raise UsageError(
                f"the file {name} has an unknown parameter {parameter[:40]!r} under `limits`",
                f"use one of {', '.join(units)}",
            )
        group = units[parameter]
        if limit.unit != group.unit:
            raise UsageError(
                f"the limit of {parameter} in {name} has the wrong unit of measure, "
                f"{limit.unit[:20]!r}",
                f"write the limit in {group.unit}",
            )
        limits[parameter] = limit.std / group.factor
    return UncertaintySettings(
        MappingProxyType(sizes),
        MappingProxyType(limits),
        MappingProxyType({**before.drifts, **_read_drifts(document, name)}),
    )


def _read_drifts(document: SettingsDocument, name: str) -> dict[str, float]:
    drifts = {}
    for cause, entry in document.drift_per_day.items():
        term = find_term(cause)
        if not term.is_persistent:
            raise UsageError(
                f"{name} gives a drift of {cause} under `drift_per_day`, but this error does not "
                "last from one recording to the next",
                f"remove {cause} from `drift_per_day`",
            )
        factor = _factor(name, f"drift_per_day: {cause}", entry.unit, _size_unit(term))
        drifts[cause] = entry.std * factor
    return drifts


def _size_unit(term: Term) -> str:
    """Return the SI unit of a cause's sizes; all sizes of a cause have the same unit."""
    return next(parameter.unit for parameter in term.parameters if parameter.role == "size")


def _factor(name: str, place: str, unit: str, si_unit: str) -> float:
    """Return the factor from a written unit, either the SI unit or the displayed one, to SI."""
    shown_factor, shown_unit = display_unit(si_unit)
    if unit == si_unit:
        return 1.0
    if unit == shown_unit:
        return 1.0 / shown_factor
    raise UsageError(
        f"the entry {place} in {name} has the wrong unit of measure, {unit[:20]!r}",
        f"write the size in {si_unit} or {shown_unit}",
    )
