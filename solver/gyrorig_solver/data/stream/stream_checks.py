"""All checks of the raw stream of one board, in the order of the report."""

from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.data.stream import counter_gaps, damaged_words, exact_repeats, stuck_axes
from gyrorig_solver.data.stream.count_stream import CheckResult, CountStream


def check_stream(samples: GyroSamples) -> tuple[CheckResult, ...]:
    """Check the stream of one board in one recording."""
    stream = CountStream(samples)
    stuck, clipped = stuck_axes.check_stuck_axes(stream)
    return (
        counter_gaps.check_counter_gaps(stream),
        exact_repeats.check_repeats(stream),
        damaged_words.check_damaged_words(stream),
        stuck,
        clipped,
    )
