"""Schema of the posterior of a pan-tilt unit, `gyrorig/unit/1`, with its reader and writer.

What to use when: `unit_document` for a new version, `unit_as_yaml` to write it, `parse_unit` to
read one, `posterior_of` for its mean and covariance.
"""

import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from gyrorig_protocol.documents import dump_yaml, parse_result_document
from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.utc_time import parse_utc_text, utc_text, utc_text_now
from gyrorig_solver.uncertainty import UncertaintySettings, UnitPosterior
from gyrorig_solver.uncertainty.unit_values import (
    table_covariance,
    unit_value_limits,
    unit_value_names,
    unit_value_units,
)

SCHEMA = "gyrorig/unit/1"
UNIT_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
MAX_SIZES = 200
MAX_CORRELATION_EXCESS = 1e-6  # rounding of the written digits


class _DocumentPart(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the document's parts: unknown keys are errors."""


class UnitIdentity(_DocumentPart, frozen=True):
    """The unit: its serial number, or the id of its rig where the recordings have none."""

    id: str
    identified_by: Literal["serial", "rig"]


class CountedRecording(_DocumentPart, frozen=True):
    """A recording whose information the posterior contains."""

    name: str
    sha256: str
    board: str


class UnitPosteriorDocument(_DocumentPart, frozen=True, omit_defaults=True):
    """One version of a unit's posterior: immutable once written."""

    schema: Literal["gyrorig/unit/1"] = msgspec.field()
    unit: UnitIdentity
    version: Annotated[int, msgspec.Meta(ge=1)]
    created: str
    as_of: str  # UTC; the newest recording's start, from which drift counts
    names: Annotated[list[str], msgspec.Meta(min_length=1, max_length=MAX_SIZES)]
    units: list[str]
    mean: list[float]
    covariance: list[list[float]]
    recordings: list[CountedRecording]  # of this version and of all before
    based_on: int | None = None  # the version before; None: the table of prior sizes
    previous: str | None = None  # `sha256:` digest of the version before
    remark: str | None = None

    @property
    def digests(self) -> frozenset[str]:
        """The digests of all recordings that were counted."""
        return frozenset(recording.sha256 for recording in self.recordings)

    def days_until(self, start_ns: int) -> float:
        """Return the days between this posterior and a recording, before or after."""
        as_of = parse_utc_text(self.as_of)
        return abs(start_ns * 1e-9 - as_of.timestamp()) / 86_400.0


def unit_as_yaml(document: UnitPosteriorDocument) -> str:
    """Return the document as YAML. Every float reads back as the same number."""
    plain: dict[str, Any] = msgspec.to_builtins(document)
    return dump_yaml(plain)


def parse_unit(text: str | bytes, name: str) -> UnitPosteriorDocument:
    """Return the posterior of a YAML document.

    Raises:
        InputError: it is not YAML, has another schema, or is no distribution.
    """
    document = parse_result_document(text, name, UnitPosteriorDocument, SCHEMA)
    problem = _find_problem(document)
    if problem is not None:
        raise InputError(
            f"the file {name} with the stored posterior of a pan-tilt unit {problem}",
            "restore the file from a backup, or solve with `--unit-prior none`",
        )
    return document


def unit_document(
    unit: UnitIdentity,
    posterior: UnitPosterior,
    before: UnitPosteriorDocument | None,
    recordings: Sequence[CountedRecording],
    start_ns: int,
) -> UnitPosteriorDocument:
    """Return the next version of a unit's posterior, without `previous` and `remark`.

    Args:
        unit: the unit.
        posterior: with the new recordings.
        before: the newest version; None if there is none.
        recordings: the new ones.
        start_ns: start of the newest of them, since the epoch.
    """
    start, created = utc_text(start_ns), utc_text_now()
    newest = start if before is None else max(start, before.as_of)
    return UnitPosteriorDocument(
        schema="gyrorig/unit/1",
        unit=unit,
        version=1 if before is None else before.version + 1,
        created=created,
        # A recording from the future is from a rig with a wrong clock. Its date would age the
        # posterior for every later recording.
        as_of=min(newest, created),
        names=list(unit_value_names()),
        units=list(unit_value_units()),
        mean=[float(value) for value in posterior.mean],
        covariance=[[float(value) for value in row] for row in posterior.covariance],
        recordings=[*(before.recordings if before is not None else ()), *recordings],
        based_on=None if before is None else before.version,
    )


def posterior_of(document: UnitPosteriorDocument, settings: UncertaintySettings) -> UnitPosterior:
    """Return mean and covariance in the order of `unit_value_names`.

    A size that the document does not have gets the prior of the table.
    """
    position = {name: k for k, name in enumerate(document.names)}
    names = unit_value_names()
    shared = [k for k, name in enumerate(names) if name in position]
    stored = [position[names[k]] for k in shared]
    covariance, mean = table_covariance(settings), np.zeros(len(names))
    covariance[shared, shared] = 0.0
    covariance[np.ix_(shared, shared)] = np.array(document.covariance)[np.ix_(stored, stored)]
    mean[shared] = np.array(document.mean)[stored]
    return UnitPosterior(mean, covariance)


def _find_problem(document: UnitPosteriorDocument) -> str | None:
    """Return why a document is no distribution of sizes; None if it is one."""
    size = len(document.names)
    if len(set(document.names)) != size:
        return "has a name twice"
    if not len(document.units) == len(document.mean) == len(document.covariance) == size or any(
        len(row) != size for row in document.covariance
    ):
        return "has lists of different lengths"
    problem = _find_impossible_size(document)
    if problem is not None:
        return problem
    if not UNIT_ID.fullmatch(document.unit.id):
        return "has an invalid id of the unit"
    try:
        parse_utc_text(document.as_of)
    except ValueError:
        return "has an invalid time `as_of`"
    return None if _is_covariance(np.array(document.covariance)) else "has no valid covariance"


def _find_impossible_size(document: UnitPosteriorDocument) -> str | None:
    known_units = dict(zip(unit_value_names(), unit_value_units(), strict=True))
    limits = unit_value_limits()
    for name, unit, mean in zip(document.names, document.units, document.mean, strict=True):
        if known_units.get(name, unit) != unit:
            return f"states {name[:60]} in another unit than {known_units[name]}"
        if abs(mean) > limits.get(name, float("inf")):
            return f"states an impossible value of {name[:60]}"
    return None


def _is_covariance(matrix: FloatArray) -> bool:
    scale = np.sqrt(np.clip(np.diag(matrix), 0.0, None))
    scale = np.where(scale > 0.0, scale, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        correlation = matrix / scale / scale[:, None]
    if not np.isfinite(correlation).all() or not (np.diag(matrix) >= 0.0).all():
        return False
    is_symmetric = bool(np.abs(correlation - correlation.T).max() <= MAX_CORRELATION_EXCESS)
    return is_symmetric and bool(np.linalg.eigvalsh(correlation)[0] >= -MAX_CORRELATION_EXCESS)
