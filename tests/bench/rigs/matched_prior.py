"""The uncertainty settings that fit how `draw_rig` draws causes: each is in few of the rigs.

The sizes stay those that ship with the solver. Only the probability of each cause changes.
"""

from importlib.resources import files
from pathlib import Path

import yaml
from tests.bench.rigs.prior_sizes import PRIOR_SIZES
from tests.bench.rigs.rig import MOST_CAUSES


def presence_probability() -> float:
    """Return the probability of one cause in a rig with 0 to `MOST_CAUSES` different causes."""
    return MOST_CAUSES / 2 / len(PRIOR_SIZES)


def write_matched_prior(path: Path) -> None:
    """Write the shipped prior sizes with the probability of these rigs."""
    shipped = files("gyrorig_solver.uncertainty").joinpath("default_settings.yaml")
    document = yaml.safe_load(shipped.read_text(encoding="utf-8"))
    matched = {"schema": document["schema"]}
    for profile in ("unit", "board"):
        matched[profile] = {
            cause: {**entry, "probability": round(presence_probability(), 4)}
            for cause, entry in document[profile].items()
        }
    path.write_text(yaml.safe_dump(matched, sort_keys=False), encoding="utf-8")
