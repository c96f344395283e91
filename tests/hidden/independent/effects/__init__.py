"""Effects of real rigs that neither the catalogue nor `tests.hidden.truth.outside` has.

`EFFECTS` has one entry for each.
"""

from tests.hidden.independent.effects.mechanics import MECHANICS
from tests.hidden.independent.effects.motor import MOTOR
from tests.hidden.independent.effects.sensing import SENSING

EFFECTS = {entry.name: entry for entry in (*MECHANICS, *MOTOR, *SENSING)}
