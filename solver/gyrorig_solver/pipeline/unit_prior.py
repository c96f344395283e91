"""The posterior of a unit as the prior of a solve, and the information that the solve adds.

What to use when: `UnitKnowledge` for a store or for a file that a user names; `unit_identity` for
the unit of recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import UnitPriorRecord
from gyrorig_solver.calibration.unit_document import (
    UNIT_ID,
    CountedRecording,
    UnitIdentity,
    UnitPosteriorDocument,
    parse_unit,
    posterior_of,
    unit_document,
)
from gyrorig_solver.calibration.unit_store import StoredPosterior, UnitStore
from gyrorig_solver.numerics import chi2_upper_tail
from gyrorig_solver.pipeline.board_data import UNIT_TOPIC
from gyrorig_solver.uncertainty import UncertaintySettings, UnitPosterior
from gyrorig_solver.uncertainty.unit_values import UnitInformation

MIN_ENTROPY_GAIN = 0.05  # nats; a recording that adds less is not counted
CONFLICT_P_VALUE = 1e-6  # below this p-value, the unit has changed
# relative to the prior; smaller in directions that a recording does not show
MIN_RELATIVE_INFORMATION = 1e-6
CONFLICT_REMARK = (
    "the recording contradicts the stored posterior of the unit, so the solver did not use that "
    "posterior. The unit has changed, or another unit has the same name"
)


@dataclass(frozen=True, slots=True)
class UnitPrior:
    """The posterior of the unit before a solve, and its record."""

    posterior: UnitPosterior
    record: UnitPriorRecord


def unit_identity(recordings: Sequence[Recording]) -> UnitIdentity | None:
    """Return the unit of all recordings: by its serial number, or else by the id of its rig.

    The result is None if a recording has neither, or if the recordings are of different units.
    Recordings without a unit's motion do not count.
    """
    identities = {
        _identity_of(recording) for recording in recordings if UNIT_TOPIC in recording.topics
    }
    return identities.pop() if len(identities) == 1 else None


def read_unit_file(path: Path) -> UnitPosteriorDocument:
    """Return the posterior of a file that a user names.

    Raises:
        UsageError: it cannot be read.
        InputError: it is not a posterior of a unit.
    """
    try:
        return parse_unit(path.read_bytes(), str(path))
    except OSError as fault:
        reason = fault.strerror or "it is not readable"
        raise UsageError(
            f"the posterior of a unit {path} cannot be read ({reason})",
            "give a version in the folder rigs/<unit> of the results",
        ) from fault


@dataclass(frozen=True, slots=True)
class UnitKnowledge:
    """Source of the unit's posterior for a solve.

    With a store, the newest version is the prior and the solve writes a new version. With only a
    document, it is the prior of every unit and the solve writes nothing.
    """

    store: UnitStore | None = None
    document: UnitPosteriorDocument | None = None

    def prior_of(
        self, recordings: Sequence[Recording], settings: UncertaintySettings
    ) -> UnitPrior | None:
        """Return the prior of a solve of recordings; None if there is none for their unit.

        Raises:
            InputError: a stored version is damaged.
        """
        start_ns = max(recording.start_ns for recording in recordings)
        if self.document is not None:
            return _prior_from(StoredPosterior(self.document, ""), start_ns, settings)
        unit = unit_identity(recordings)
        if self.store is None or unit is None:
            return None
        stored = self.store.prior_for(unit, [recording.sha256 for recording in recordings])
        return None if stored is None else _prior_from(stored, start_ns, settings)

    def add(
        self,
        recordings: Sequence[Recording],
        board: str,
        information: UnitInformation,
        settings: UncertaintySettings,
    ) -> UnitPosteriorDocument | None:
        """Write the next version of the unit, if the recordings add information to it.

        Returns:
            The version that was written, if any.
        """
        unit = unit_identity(recordings)
        if self.store is None or self.document is not None or unit is None:
            return None
        start_ns = max(recording.start_ns for recording in recordings)
        counted = [
            CountedRecording(recording.path.name, recording.sha256, str(board))
            for recording in recordings
        ]

        def next_document(newest: StoredPosterior | None) -> UnitPosteriorDocument | None:
            before = None if newest is None else newest.document
            table = UnitPosterior.from_table(settings)
            prior = table if newest is None else _aged(newest, start_ns, settings)
            has_changed = before is not None and contradicts(prior, information)
            if has_changed:
                prior = table
            if prior.entropy_gain(information) < MIN_ENTROPY_GAIN:
                return None
            document = unit_document(unit, prior.updated(information), before, counted, start_ns)
            if has_changed:
                document = msgspec.structs.replace(document, based_on=None, remark=CONFLICT_REMARK)
            return document

        return self.store.add(unit, [row.sha256 for row in counted], next_document)


def contradicts(prior: UnitPosterior, information: UnitInformation) -> bool:
    """Return whether a recording contradicts the posterior of the unit.

    The score at the prior's mean has covariance M + M P M. Its square in these units is chi-square
    distributed if the prior is right.
    """
    values, vectors = np.linalg.eigh(prior.covariance)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    ratios, directions = np.linalg.eigh(root.T @ information.matrix @ root)
    score = directions.T @ root.T @ (information.vector - information.matrix @ prior.mean)
    shown = ratios > MIN_RELATIVE_INFORMATION
    statistic = float(np.sum(score[shown] ** 2 / (ratios[shown] * (1.0 + ratios[shown]))))
    return bool(shown.any()) and chi2_upper_tail(statistic, int(shown.sum())) < CONFLICT_P_VALUE


def _identity_of(recording: Recording) -> UnitIdentity | None:
    serial = recording.metadata.get("gyrorig.ptu", {}).get("serial", "")
    if UNIT_ID.fullmatch(serial):
        return UnitIdentity(serial, "serial")
    rig = recording.metadata.get("gyrorig", {}).get("rig", "")
    return UnitIdentity(rig, "rig") if UNIT_ID.fullmatch(rig) else None


def _aged(stored: StoredPosterior, start_ns: int, settings: UncertaintySettings) -> UnitPosterior:
    days = stored.document.days_until(start_ns)
    return posterior_of(stored.document, settings).after(days, settings)


def _prior_from(stored: StoredPosterior, start_ns: int, settings: UncertaintySettings) -> UnitPrior:
    document = stored.document
    record = UnitPriorRecord(
        id=document.unit.id,
        version=document.version,
        sha256=stored.sha256 or None,
        recordings=len(document.recordings),
        days=round(document.days_until(start_ns), 3),
    )
    return UnitPrior(_aged(stored, start_ns, settings), record)
