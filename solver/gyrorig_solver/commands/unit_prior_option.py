"""The option `--unit-prior` of the commands that solve."""

from pathlib import Path

import click

from gyrorig_solver.calibration.unit_store import UnitStore
from gyrorig_solver.pipeline import UnitKnowledge, read_unit_file
from gyrorig_solver.storage import Storage

FROM_STORE, NO_PRIOR = "stored", "none"

unit_prior_option = click.option(
    "--unit-prior",
    default=FROM_STORE,
    show_default=True,
    metavar="stored|none|FILE",
    help=(
        "The unit posterior, which earlier recordings determined. stored: use the newest "
        "version in the folder rigs/<unit> of the results, and add a version. none: use no "
        "version, and add none. FILE: use this version (YAML), and add none."
    ),
)


def read_unit_knowledge(text: str, storage: Storage) -> UnitKnowledge:
    """Return what `--unit-prior` names.

    Raises:
        UsageError: the file cannot be read.
        InputError: the file is no posterior of a unit.
    """
    if text == NO_PRIOR:
        return UnitKnowledge()
    if text == FROM_STORE:
        return UnitKnowledge(store=UnitStore(storage))
    return UnitKnowledge(document=read_unit_file(Path(text)))
