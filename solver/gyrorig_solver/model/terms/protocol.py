"""What every cause of the catalogue offers, and what its parameters are.

What to use when: a fit asks `missing`, `effect` and `columns`; a search over causes asks
`bank` and `directions` too; a report asks `sentence`, `excitation`, `confused_with`, `harm`.
"""

from dataclasses import dataclass
from typing import Literal, Protocol, get_args

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.model.terms.scene import Scene

Part = Literal["clock", "link", "sensor", "ptu", "mount", "environment"]
# effect: changes the measured rate. known: so too, by an amount that is known beforehand.
# gauge: the base parameters absorb it whole, so it is never seen in a residual.
# stochastic: changes the noise, not the mean. raw: seen in the raw stream, not in a model.
Kind = Literal["effect", "known", "gauge", "stochastic", "raw"]
# Whose it is: what is the unit's is common to all boards on it, what is a recording's is not
# there in the next one.
Scope = Literal["board", "unit", "recording"]
# size: how much of it, zero means none. shape, event: a nuisance that means nothing at size
# zero (a period, a lag, a time constant; a time), scanned before it is refined.
Role = Literal["size", "shape", "event"]
# Where on the way from what the motor is told to a stamped sample a cause acts. What comes
# later sees what comes earlier: a gap swallows the motion that rounded ramps have.
Link = Literal[
    "profile",  # which moves the controller lays
    "motor",  # how the motor carries them out
    "rotor",  # what it loses on the way
    "drive",  # steps to the worm's turn
    "play",  # from worm to wheel
    "wheel",  # the wheel's own turn
    "stage",  # what the wheel carries, and what carries the unit
    "axes",  # from the axes' turn to the stage's rate
    "mount",  # from stage to sensor
    "sensor",  # what the element makes of a rate
    "threshold",  # and of a small one
    "bias",  # what it shows without any
    "low_pass",
    "limit",  # of what it can show
    "clock",  # when that is read
    "readout",  # what is written instead; nothing comes after it
]
CHAIN: tuple[Link, ...] = get_args(Link)
# These take a signal as it is, filtered or later: their effect on what others add is exact
# when it is taken with them at work.
OPERATORS: tuple[Link, ...] = ("low_pass", "clock")


@dataclass(frozen=True, slots=True)
class TermParameter:
    """One quantity of a cause, one value to each of its parts."""

    name: str
    unit: str
    typical: float  # size that an ordinary rig has, the width of what is expected
    lower: float  # no physical cause of this name lies outside [lower, upper]
    upper: float
    prior_std: float  # how wide a fit may hold it loosely, a few times what is possible
    parts: tuple[str, ...] = ()  # x, y, z or pan, tilt; () is one value
    role: Role = "size"
    start: float = 0.0  # where a fit begins; of a size: no effect
    whole: bool = False  # counts things: 0.23 of a sample was never lost

    @property
    def count(self) -> int:
        """How many values it has."""
        return max(1, len(self.parts))

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each value, as a covariance lists them."""
        return tuple(f"{self.name}.{part}" for part in self.parts) or (self.name,)


class Term(Protocol):
    """One physical cause. k values: those of its parameters, one after the other."""

    @property
    def cause(self) -> str:
        """Its id in the catalogue (contract: results)."""
        ...

    @property
    def part(self) -> Part:
        """The part of the rig that it belongs to."""
        ...

    @property
    def kind(self) -> Kind:
        """How it shows."""
        ...

    @property
    def link(self) -> Link:
        """Where in the chain from motor to stamp it acts."""
        ...

    @property
    def reshapes(self) -> bool:
        """Whether what it does hangs strongly on small changes further up the chain."""
        ...

    @property
    def as_if_shown(self) -> bool:
        """Whether its derivatives are wanted as if nothing cut rates off."""
        ...

    @property
    def scope(self) -> Scope:
        """Whose it is."""
        ...

    @property
    def parameters(self) -> tuple[TermParameter, ...]:
        """Its quantities."""
        ...

    @property
    def confused_with(self) -> tuple[str, ...]:
        """Causes that look alike under some programs, the likest first."""
        ...

    @property
    def excitation(self) -> str:
        """What a recording needs so that it shows, and shows as itself."""
        ...

    @property
    def harm(self) -> str:
        """What it does to a calibration that does not know of it."""
        ...

    def missing(self, scene: Scene) -> str | None:
        """Return why it cannot be looked at here, with the remedy, None where it can."""
        ...

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the exact change of the measured rate, (blocks, 3), at values (k,)."""
        ...

    def passed(self, scene: Scene, values: FloatArray) -> Scene:
        """Return the scene as the causes further down the chain see it."""
        ...

    def tilt_zero_std_rad(self, values: FloatArray) -> float:
        """Return how far it leaves open where the stage stands at the told tilt's zero."""
        ...

    def bandwidth_share(self, values: FloatArray) -> float:
        """Return the low-pass that the noise passes over the configured one, of cut-offs."""
        ...

    def unheld(self, scene: Scene, values: FloatArray) -> FloatArray | None:
        """Return what of its effect no grid holds, (blocks, 3), None where there is no such.

        What filters or delays does not find it in the scene that is passed on.
        """
        ...

    def unsure(self, scene: Scene, values: FloatArray) -> BoolArray | None:
        """Return which blocks show something else if an instant is hardly off, (blocks,).

        None where none do. They are left out beside it.
        """
        ...

    def columns(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return its derivative by the values, (k, blocks, 3)."""
        ...

    def slopes(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the same at these very values, without what a step of them would bring."""
        ...

    def passes(self, scene: Scene, values: FloatArray) -> FloatArray | None:
        """Return what of a small change of the rate it lets pass, (n, 3), None: all of it."""
        ...

    def bank(self, scene: Scene) -> FloatArray:
        """Return values (b, k) to look from: shapes, events and finite sizes to scan."""
        ...

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return what to look for at one row of the bank, (d, blocks, 3), one to a size.

        Source: a column taken at size zero, or at a far one, catches little of an effect
        that is not linear (16 % of a backlash at a quarter of the size that it was made at).
        """
        ...

    def sentence(self, values: FloatArray) -> str:
        """Say to a person at the rig what these values mean."""
        ...


def value_names(term: Term) -> tuple[str, ...]:
    """Return the name of each of a term's values, shape (k,)."""
    return tuple(name for parameter in term.parameters for name in parameter.names)


def value_parameters(term: Term) -> tuple[TermParameter, ...]:
    """Return the parameter that each of a term's values belongs to."""
    return tuple(p for p in term.parameters for _ in range(p.count))


def places(term: Term) -> tuple[str, ...]:
    """Return where a cause can act on its own: its parts x, y, z or pan, tilt; else ()."""
    found: dict[str, None] = {}
    for parameter in term.parameters:
        if parameter.role == "size":
            found.update(dict.fromkeys(parameter.parts))
    return tuple(found)


def indices(term: Term, place: str | None = None, role: Role | None = None) -> list[int]:
    """Return which of a term's values act at a place and have a role; all by default.

    A value without a part acts at every place.
    """
    found, at = [], 0
    for parameter in term.parameters:
        for part in parameter.parts or ("",):
            here = place is None or part in ("", place)
            if here and (role is None or parameter.role == role):
                found.append(at)
            at += 1
    return found
