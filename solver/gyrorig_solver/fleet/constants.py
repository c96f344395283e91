"""The same on every unit, or different on each: what is off, asked of a kind and of a rig.

What to use when: `constancies` for every answer that the newest calibrations give, `in_words`
for the answers as lines, `common_constant` for one parameter.

A number that is wrong in a program, a truncation of counts, a wrong tick rate and the host's
clock are off by the same on every unit; parts, mounts and a sensor's own clock are off each by
its own (reference: peers.md section 2, last row, and its list of injections, items 4, 6 and 7).
A fleet of one kind tells the first from the second by its mean and its spread. A truncation
takes half a count off each axis; beside biases that differ by more it is not to be seen, and
that is said. Clocks are asked by kind of sensor, where its boards are on several rigs, and by
rig: all boards of a rig share its host.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.chance import normal_tail
from gyrorig_solver.fleet.newest import PARAMETERS, Newest
from gyrorig_solver.fleet.population import LEAST_BOARDS, Population, population

# What a perfect board on a perfect rig has; a lag is nobody's constant.
NOMINAL = {
    name: 1.0 if name.startswith("scale") else 0.0
    for name in PARAMETERS
    if not name.startswith("time")
}
SURE_P = 1e-6  # of a constant, or of a spread, before a word is said of either
COMMON_SHARE = 0.9  # of the mean square deviation: three times what the parts differ by
CLOCK = "clock_skew"
# What a map of 20 us, the usual one of a serial link, says of a clock in 40 s; see docs/clocks.md.
SKEW_STD_PPM = 0.5
_RIGS_NAMED = 4

Answer = Literal["same", "different", "open"]


@dataclass(frozen=True, slots=True)
class CommonConstant:
    """How much of what is off the nominal value is the same on every unit."""

    parameter: str
    offset: float  # of the fleet's mean from nominal
    z: float
    p_value: float
    share: float  # of the mean square deviation from nominal that is common to all
    boards: int
    spread: float  # how much boards truly differ
    equal_p: float  # how likely boards that do not differ at all would scatter so

    @property
    def is_common(self) -> bool:
        """One number explains it better than the parts' own spread: look at constants."""
        return self.answer == "same"

    @property
    def answer(self) -> Answer:
        """Which it is.

        same: off by one number on all of them. different: boards truly differ, and no one number
        explains what is off. open: neither can be told: they are alike, and off by nothing.
        """
        if self.p_value < SURE_P and self.share > COMMON_SHARE:
            return "same"
        return "different" if self.equal_p < SURE_P else "open"


@dataclass(frozen=True, slots=True)
class Constancy:
    """Whether one parameter is off by the same on all boards of a kind, or of a rig."""

    kind: Literal["sensor", "rig"]
    name: str  # the sensor's or the rig's
    told: CommonConstant
    count_rad_s: float | None = None  # of a bias: what a count is worth, where all have one

    @property
    def hides_truncation(self) -> bool:
        """True where half a count on every unit could not be told beside biases that differ."""
        if self.count_rad_s is None or self.told.is_common:
            return False
        return not _share(0.5 * self.count_rad_s, self.told.spread) > COMMON_SHARE


def common_constant(found: Population, nominal: float) -> CommonConstant:
    """Ask whether a deviation from nominal is the same on every unit."""
    offset = found.mean - nominal
    z = offset / found.mean_std
    return CommonConstant(
        parameter=found.parameter,
        offset=offset,
        z=float(z),
        p_value=2.0 * normal_tail(abs(z)),
        share=_share(offset, found.spread),
        boards=found.boards,
        spread=found.spread,
        equal_p=found.equal_p,
    )


def constancies(boards: Newest, populations: dict[tuple[str, str], Population]) -> list[Constancy]:
    """Ask every parameter of every kind of sensor, then the clocks of kinds and of rigs."""
    sensors = np.array(boards.sensor)
    asked: list[Constancy] = []
    for (sensor, name), found in populations.items():
        if name not in NOMINAL:
            continue
        bias = name.startswith("bias")
        count = _one_count(boards.count_rad_s[sensors == sensor]) if bias else None
        asked.append(Constancy("sensor", sensor, common_constant(found, NOMINAL[name]), count))
    return [*asked, *_clocks(boards)]


def in_words(asked: Sequence[Constancy]) -> list[str]:
    """Return the answers as lines: what is the same on every unit, and what is different."""
    lines: list[str] = []
    for sensor in dict.fromkeys(one.name for one in asked if one.kind == "sensor"):
        here = [one for one in asked if (one.kind, one.name) == ("sensor", sensor)]
        most = max(one.told.boards for one in here)
        for answer, (head, tail) in _ANSWERS.items():
            named = [_words(one) for one in here if one.told.answer == answer]
            if named:
                lines.append(f"{head} on {most} {sensor}: {', '.join(named)}; {tail}")
        hidden = [one for one in here if one.hides_truncation]
        if hidden:
            half = 0.5 * (hidden[0].count_rad_s or 0.0)
            lines.append(
                f"a truncation, {half:.2g} rad/s on every axis, could not be told on {sensor}: "
                f"biases differ by {min(one.told.spread for one in hidden):.2g} rad/s"
            )
    for answer, (head, _) in _ANSWERS.items():
        rigs = [one for one in asked if one.kind == "rig" and one.told.answer == answer]
        if rigs:
            lines.append(f"{head} on {_rigs(rigs)}; {_CLOCKS[answer]}")
    return lines


_ANSWERS: dict[Answer, tuple[str, str]] = {
    "same": ("the same on every unit", "a program's number, no part's"),
    "different": ("different per unit", "the parts' own, no constant"),
    "open": ("neither off nor different", "as far as these calibrations tell"),
}
_CLOCKS: dict[Answer, str] = {
    "same": "the host's, no board's",
    "different": "the boards' own, no host's",
    "open": "boards and host agree",
}


def _rigs(told: Sequence[Constancy]) -> str:
    """Return rigs with what their boards' clocks are off by, a few by name."""
    names = ", ".join(f"{one.name} ({_clock_words(one)})" for one in told[:_RIGS_NAMED])
    more = len(told) - _RIGS_NAMED
    return f"the boards of {names}{f' and {more} rigs more' if more > 0 else ''}: clocks"


def _words(one: Constancy) -> str:
    if one.told.parameter == CLOCK:
        return f"clocks ({_clock_words(one)})"
    return parameter_words(one.told.parameter)


def _clock_words(one: Constancy) -> str:
    return f"{one.told.offset:+.3g} ppm, spread {one.told.spread:.2g}"


def parameter_words(parameter: str) -> str:
    """Return a parameter's column as words."""
    name, _, entry = parameter.rpartition("_")
    return f"{name} {entry}" if name and name != "time" else parameter.replace("_", " ")


def _clocks(boards: Newest) -> Iterator[Constancy]:
    """Ask kinds on several rigs, then rigs, what all of a kind share taken off."""
    skew_ppm = boards.skew_ppm.copy()
    known = np.isfinite(skew_ppm)
    sensors, rigs = np.array(boards.sensor), np.array(boards.rig)
    for sensor in sorted(set(sensors[known])):
        here = known & (sensors == sensor)
        if here.sum() >= LEAST_BOARDS and len(set(rigs[here])) > 1:
            told = _clock(skew_ppm[here])
            yield Constancy("sensor", str(sensor), told)
            if told.is_common:
                skew_ppm[here] -= told.offset
    for rig in sorted(set(rigs[known]) - {""}):
        here = known & (rigs == rig)
        if here.sum() >= LEAST_BOARDS:
            yield Constancy("rig", str(rig), _clock(skew_ppm[here]))


def _clock(skew_ppm: FloatArray) -> CommonConstant:
    found = population(CLOCK, skew_ppm, np.full(skew_ppm.shape, SKEW_STD_PPM))
    return common_constant(found, 0.0)


def _one_count(count_rad_s: FloatArray) -> float | None:
    """Return what a count is worth, None where boards are set to several ranges."""
    known = count_rad_s[np.isfinite(count_rad_s)]
    if not known.size or float(np.ptp(known)) > 1e-6 * float(known.max()):
        return None
    return float(known[0])


def _share(offset: float, spread: float) -> float:
    return offset**2 / (offset**2 + spread**2) if offset else 0.0
