"""All looks at one board's raw stream, in the order in which they are told."""

from gyrorig_solver.raw import damage, flat, losses, repeats
from gyrorig_solver.raw.result import Look, RawFinding, Stream
from gyrorig_solver.samples import GyroSamples


def look_at(samples: GyroSamples) -> tuple[Look, ...]:
    """Look at one recording of a board without any model."""
    stream = Stream(samples)
    stuck, tops = flat.look(stream)
    return (losses.look(stream), repeats.look(stream), damage.look(stream), stuck, tops)


def findings_of(looks: tuple[Look, ...]) -> tuple[RawFinding, ...]:
    """Return what the looks found."""
    return tuple(one for look in looks for one in look.findings)
