"""What boards of each kind are like, and whether rigs, lots and sites differ.

What to use when: `compared` for all kinds, parameters and groups of the newest calibrations.
"""

from collections.abc import Iterator

import numpy as np

from gyrorig_solver.arrays import BoolArray
from gyrorig_solver.fleet.constants import Constancy, constancies
from gyrorig_solver.fleet.newest import KINDS, PARAMETERS, Kind, Newest
from gyrorig_solver.fleet.population import (
    LEAST_BOARDS,
    Between,
    Population,
    between,
    population,
)

BETWEEN_ALPHA = (
    1e-3  # one false alarm in a thousand nights, over all parameters, sensors and kinds of groups
)


def compared(
    boards: Newest,
) -> tuple[
    dict[tuple[str, str], Population],
    list[Constancy],
    list[tuple[str, Kind, Between]],
]:
    """Ask each kind of sensor what its boards are like, and whether groups of them differ.

    Returns:
        Populations by sensor and parameter; what is the same on every unit and what is not; and
        which groups differ, as (sensor, kind of group, what differs).
    """
    populations: dict[tuple[str, str], Population] = {}
    asked: list[tuple[str, Kind, Between]] = []
    sensors = np.array(boards.sensor)
    for sensor in sorted(set(boards.sensor)):
        for name in PARAMETERS:
            here = boards.known(name) & (sensors == sensor)
            if here.sum() < LEAST_BOARDS:
                continue
            value, std = boards.value[name][here], boards.std[name][here]
            found = populations[sensor, name] = population(name, value, std)
            asked += [(sensor, kind, told) for kind, told in _differences(boards, found, here)]
    limit = BETWEEN_ALPHA / max(len(asked), 1)
    differing = [one for one in asked if one[2].p_value < limit]
    return populations, constancies(boards, populations), differing


def _differences(
    boards: Newest, found: Population, here: BoolArray
) -> Iterator[tuple[Kind, Between]]:
    """Yield how groups differ in one parameter, the kind that tells most first.

    Lots and rigs may go together; what the first has told is taken off before the next is
    asked, or the bad lot's rigs would be called bad as well.
    """
    value, std = boards.value[found.parameter][here].copy(), boards.std[found.parameter][here]
    groups = {
        kind: [g for g, yes in zip(boards.group(kind), here, strict=True) if yes] for kind in KINDS
    }
    while groups:
        told = {kind: between(found, value, std, group) for kind, group in groups.items()}
        known = {kind: one for kind, one in told.items() if one is not None}
        if not known:
            return
        kind = min(known, key=lambda kind: known[kind].p_value)
        yield kind, known[kind]
        at = np.array([name == known[kind].most for name in groups.pop(kind)])
        value[at] -= known[kind].most_by
