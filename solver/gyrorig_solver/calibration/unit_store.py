"""Store of the posteriors of pan-tilt units: one immutable file per version.

    STORE/rigs/<unit>/v0001.yaml  v0002.yaml ...

A version contains the digests of all recordings that it counts. A recording is counted once. The
prior of its solve is the newest version that does not contain it, so that solving it again gives
the same result.

What to use when: `UnitStore.prior_for` before a solve, `UnitStore.add` after it.
"""

import hashlib
from bisect import bisect_left
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import PurePosixPath

import msgspec

from gyrorig_protocol.errors import BusyError, InputError, MachineError
from gyrorig_solver.calibration.calibration_store import MAX_ATTEMPTS, VERSION_FILE
from gyrorig_solver.calibration.unit_document import (
    UnitIdentity,
    UnitPosteriorDocument,
    parse_unit,
    unit_as_yaml,
)
from gyrorig_solver.storage import Storage

UNITS_FOLDER = "rigs"


@dataclass(frozen=True, slots=True)
class StoredPosterior:
    """One version as it was read."""

    document: UnitPosteriorDocument
    sha256: str


@dataclass(frozen=True, slots=True)
class UnitStore:
    """The posteriors of all units in one store."""

    storage: Storage

    def latest(self, unit: UnitIdentity) -> StoredPosterior | None:
        """Return the newest version of a unit; None if there is none.

        Raises:
            InputError: it is damaged, or of another unit.
        """
        names = self._version_names(unit)
        return self._read(names[-1], unit) if names else None

    def prior_for(self, unit: UnitIdentity, digests: Collection[str]) -> StoredPosterior | None:
        """Return the newest version that contains none of the recordings; None if there is none.

        Raises:
            InputError: a version is damaged, or of another unit.
        """
        names = self._version_names(unit)
        # A version contains the recordings of all versions before.
        index = bisect_left(
            names,
            True,
            key=lambda name: not self._read(name, unit).document.digests.isdisjoint(digests),
        )
        return self._read(names[index - 1], unit) if index else None

    def add(
        self,
        unit: UnitIdentity,
        digests: Collection[str],
        make_document: Callable[[StoredPosterior | None], UnitPosteriorDocument | None],
    ) -> UnitPosteriorDocument | None:
        """Write the next version of a unit, unless a recording is counted already.

        Args:
            unit: of the recordings.
            digests: of the recordings.
            make_document: returns the document after a version, None if there is nothing to add;
                called again when another solver took the number.

        Returns:
            The version that was written; None if there was nothing to add.

        Raises:
            InputError: the newest version is damaged, or of another unit.
            MachineError: the storage refuses.
            BusyError: other solvers took a hundred numbers in succession.
        """
        for _ in range(MAX_ATTEMPTS):
            newest = self.latest(unit)
            if newest is not None and not newest.document.digests.isdisjoint(digests):
                return None
            document = make_document(newest)
            if document is None:
                return None
            if newest is not None:
                document = msgspec.structs.replace(document, previous=newest.sha256)
            name = f"{_folder_of(unit)}v{document.version:04d}.yaml"
            if self.storage.write_new(name, unit_as_yaml(document).encode()):
                return document
        raise BusyError(
            f"the solver cannot add a file to {self.storage.location}/{_folder_of(unit)}, because "
            "another solver added one at each attempt",
            "run the command again later",
        )

    def _version_names(self, unit: UnitIdentity) -> list[str]:
        names = [
            (int(match[1]), entry.name)
            for entry in self.storage.list_files(_folder_of(unit))
            if (match := VERSION_FILE.fullmatch(PurePosixPath(entry.name).name))
        ]
        return [name for _, name in sorted(names)]

    def _read(self, name: str, unit: UnitIdentity) -> StoredPosterior:
        location = f"{self.storage.location}/{name}"
        data = self.storage.read(name)
        if data is None:
            raise MachineError(
                f"the file {location} with the stored posterior of a pan-tilt unit was removed "
                "while the program ran",
                "run the command again",
            )
        document = parse_unit(data, location)
        if document.unit != unit:
            raise InputError(
                f"the file {location} is the stored posterior of the pan-tilt unit "
                f"{document.unit.id} (identified by {document.unit.identified_by}), but it is in "
                f"the folder of the unit {unit.id} (identified by {unit.identified_by})",
                f"move the file to the folder {UNITS_FOLDER}/{document.unit.id}, or solve with "
                "`--unit-prior none`",
            )
        return StoredPosterior(document, "sha256:" + hashlib.sha256(data).hexdigest())


def _folder_of(unit: UnitIdentity) -> str:
    return f"{UNITS_FOLDER}/{unit.id}/"
