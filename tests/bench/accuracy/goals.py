"""What is measured and what must be reached: the one table of goals, set before any run."""

from tests.bench.accuracy.trial import Case

SHORT_PROGRAM, LONG_PROGRAM = "quick.yaml", "full.yaml"

KNOWN_EFFICIENCY, ANSWERS_EFFICIENCY = 0.95, 0.90
COVER_68, COVER_95 = (0.64, 0.72), (0.93, 0.97)
OFFSET_RATIO, OFFSET_COVER = 1.15, (0.92, 0.98)
OUTLIER_LOSS = 0.05
CHI2_P = 0.01

CASES = (
    Case("75 s, known", SHORT_PROGRAM, number=1),
    Case("75 s, 115200 baud", SHORT_PROGRAM, baud=115_200.0, number=1),
    Case("75 s, 9600 baud", SHORT_PROGRAM, baud=9600.0, number=1),
    Case("75 s, counter, 115200 baud", SHORT_PROGRAM, baud=115_200.0, counter=True, number=1),
    Case("75 s, counter, 9600 baud", SHORT_PROGRAM, baud=9600.0, counter=True, number=1),
    Case("75 s, known, spikes", SHORT_PROGRAM, spikes=0.01, number=1),
    Case("75 s, 800 Hz, known", SHORT_PROGRAM, 800.0, 110.0, number=2),
    Case("75 s, 800 Hz, 115200 baud", SHORT_PROGRAM, 800.0, 110.0, baud=115_200.0, number=2),
    Case("75 s, 800 Hz, known, spikes", SHORT_PROGRAM, 800.0, 110.0, spikes=0.01, number=2),
    Case("300 s, known", LONG_PROGRAM, number=3),
    Case("300 s, 115200 baud", LONG_PROGRAM, baud=115_200.0, number=3),
    Case("300 s, 9600 baud", LONG_PROGRAM, baud=9600.0, number=3),
)
