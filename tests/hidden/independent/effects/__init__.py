"""Effects of real rigs that are not in the catalogue and not in `tests.hidden.truth.outside`.

`EFFECTS` has one entry for each effect.
"""

from tests.hidden.independent.effects.mechanics import MECHANICS
from tests.hidden.independent.effects.motor import MOTOR
from tests.hidden.independent.effects.sensing import SENSING

EFFECTS = {entry.name: entry for entry in (*MECHANICS, *MOTOR, *SENSING)}
